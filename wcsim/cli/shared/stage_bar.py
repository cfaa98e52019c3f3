"""A bar with the time that is left, for a stage that takes minutes; where the output is no terminal, lines instead."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Self

from rich.progress import BarColumn, Progress, TaskID, TextColumn

from wcsim.cli.shared.consoles import stderr_console
from wcsim.core.closing import Closing

_BAR_WIDTH = 16  # with what is said beside it a row has 80 characters
_TOLD = ("description", "fields[says]", "fields[left]")
_ALMOST_S = 90.0  # from here on minutes are told


def _told_left(spent_s: float, share: float) -> str:
    """How long the rest takes, if it goes on as it did; "" when that is not known, or nothing is left.

    >>> _told_left(30.0, 0.25), _told_left(30.0, 0.75), _told_left(30.0, 0.0)
    ('about 2 min left', 'about 10 s left', '')
    """
    if not 0.0 < share < 1.0:
        return ""
    left_s = spent_s * (1.0 - share) / share
    return f"about {math.ceil(left_s / 5) * 5} s left" if left_s < _ALMOST_S else f"about {round(left_s / 60)} min left"


class StageBar(Closing):
    """A stage of a command and how far it has come; a context manager. Where less is done than before, another begins.

    Args:
        name: Of the stage.
        clock: Seconds.
    """

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.console = stderr_console()
        names, *text = (TextColumn(f"{{task.{what}}}", markup=False) for what in _TOLD)  # names are no markup
        columns = (names, BarColumn(_BAR_WIDTH), *text)
        self._bar = Progress(*columns, console=self.console, disable=not self.console.is_terminal)
        self._task = self._bar.add_task(name, total=1.0, says="", left="")
        self._rows: dict[str, TaskID] = {}
        self._clock, self._began_s = clock, clock()
        self._first: float | None = None  # share that was done before, as by a run that goes on
        self._share = 0.0

    @property
    def left(self) -> str:
        """As `_told_left`, from the first `show` on."""
        first = self._first or 0.0
        return _told_left(self._clock() - self._began_s, (self._share - first) / (1.0 - first) if first < 1.0 else 1.0)

    def show(self, share: float, says: str, name: str | None = None) -> None:
        """A share of the work (0 to 1) is done; `says` is what goes on, in 30 characters or so."""
        if self._first is None:
            self._first = share
        elif share < self._share:
            self._first, self._began_s = share, self._clock()
        self._share = share
        self._bar.update(self._task, completed=share, says=says, left=self.left, description=name)

    def say(self, line: str, *, left: bool = True) -> None:
        """A line of its own, above the bar; without a bar the time that is left stands in it, unless it shall not."""
        more = self.left if left and not self.console.is_terminal else ""
        self.console.print(f"{line}, {more}" if more else line, markup=False, soft_wrap=True)

    def rows(self, told: dict[str, str]) -> None:
        """A row below the bar for each of those who work."""
        for gone in self._rows.keys() - told.keys():
            self._bar.remove_task(self._rows.pop(gone))
        for name, says in told.items():
            if name not in self._rows:
                self._rows[name] = self._bar.add_task(f"  {name}", total=None, says=says, left="")
            self._bar.update(self._rows[name], says=says)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def close(self) -> None:
        """The stage is over."""
        self._bar.stop()
