"""What the command line writes: results to stdout; notes, warnings and bars with the time that is left to stderr."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Self

from rich import box
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.table import Column, Table

from wcsim.core.closing import Closing
from wcsim.core.reading import escaped

if TYPE_CHECKING:
    from wcsim.towns.scenario.overrides import Override

_BAR_WIDTH = 16  # with what is said beside it a row has 80 characters
_TOLD = ("description", "fields[says]", "fields[left]")
_ALMOST_S = 90.0  # from here on minutes are told
_MOST = 2000  # letters in a cell
_CALIBRATED = (
    "step-length"  # what drivers were calibrated with: to run otherwise is more than housekeeping
)


def stdout_console() -> Console:
    """The console of results: names are printed as they are, `[/x]` and `:car:` too, with no colours for numbers."""
    return Console(highlight=False, emoji=False, markup=False)


def stderr_console() -> Console:
    """The console of notes, bars and errors, so that a pipe receives results alone."""
    return Console(stderr=True, highlight=False, emoji=False, markup=False)


def show_table(
    headings: Sequence[str | Column], rows: Iterable[Iterable[RenderableType]], **style: Any
) -> None:
    """A result as a table, with what `rich.table.Table` knows of style."""
    table = Table(*headings, **style)
    for row in rows:
        table.add_row(*row)
    stdout_console().print(table)


def say(told: str) -> None:
    """A note on what goes on meanwhile."""
    stderr_console().print(told, style="dim", soft_wrap=True)


def warn(told: str) -> None:
    """What went otherwise than it was meant to, and ends nothing."""
    print(f"wcsim: {told}", file=sys.stderr, flush=True)


def _told_left(spent_s: float, share: float) -> str:
    """How long the rest takes, if it goes on as it did; "" when that is not known, or nothing is left.

    >>> _told_left(30.0, 0.25), _told_left(30.0, 0.75), _told_left(30.0, 0.0)
    ('about 2 min left', 'about 10 s left', '')
    """
    if not 0.0 < share < 1.0:
        return ""
    left_s = spent_s * (1.0 - share) / share
    return (
        f"about {math.ceil(left_s / 5) * 5} s left"
        if left_s < _ALMOST_S
        else f"about {round(left_s / 60)} min left"
    )


class StageBar(Closing):
    """A stage of a command and how far it has come; a context manager. Where less is done than before, another begins.

    Args:
        name: Of the stage.
        clock: Seconds.
    """

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.console = stderr_console()
        names, *text = (
            TextColumn(f"{{task.{what}}}", markup=False) for what in _TOLD
        )  # names are no markup
        columns = (names, BarColumn(_BAR_WIDTH), *text)
        self._bar = Progress(*columns, console=self.console, disable=not self.console.is_terminal)
        self._task = self._bar.add_task(name, total=1.0, says="", left="")
        self._rows: dict[str, TaskID] = {}
        self._clock, self._began_s = clock, clock()
        self._first: float | None = None  # share that was done before, as by a run that goes on
        self._share = 0.0

    @property
    def is_terminal(self) -> bool:
        """Whether the bar is drawn; a log gets lines alone."""
        return self.console.is_terminal

    @property
    def left(self) -> str:
        """As `_told_left`, from the first `show` on."""
        first = self._first or 0.0
        return _told_left(
            self._clock() - self._began_s,
            (self._share - first) / (1.0 - first) if first < 1.0 else 1.0,
        )

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
        self.console.print(f"{line}, {more}" if more else line, soft_wrap=True)

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


def beside(live: Console) -> Console:
    """Where to print results while something is drawn anew on a terminal: above it, or to an output that is a file."""
    out = stdout_console()
    return live if live.is_terminal and out.is_terminal else out


def print_overrides(
    console: Console,
    town: str,
    overrides: Sequence[Override],
    notes: Sequence[str] = (),
    *,
    verbose: bool = False,
    kept: bool = False,
) -> None:
    """What differs from a scenario's own options.

    Args:
        console: Where to say it.
        town: The town's name.
        overrides: The options.
        notes: What else there is to know; printed in any case.
        verbose: A table with values and reasons, instead of a line with the names.
        kept: Whether the run's manifest holds them.
    """
    if verbose:
        console.print(_table(town, overrides))
    elif overrides:
        names = ", ".join(escaped(row.option, 80) for row in overrides)
        where = "--verbose says why, as does the run's manifest" if kept else "--verbose says why"
        told = [
            f"{len(overrides)} of SUMO's options are not as in {town}'s scenario ({names}); {where}"
        ]
        told += [
            f"{row.option} is {row.wcsim}: {row.why}"
            for row in overrides
            if row.author and row.option == _CALIBRATED
        ]
        for line in told:
            console.print(escaped(line, _MOST), highlight=False)
    for note in notes:
        console.print(f"note: {note}", highlight=False)


def _table(town: str, overrides: Sequence[Override]) -> Table:
    table = Table(
        "option",
        Column("author", overflow="fold"),
        Column("here", overflow="fold"),
        Column("why", overflow="fold"),
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        title=f"what this run overrides of {town}'s scenario",
        title_justify="left",
    )
    for row in overrides:
        table.add_row(
            *(escaped(cell, _MOST) for cell in (row.option, row.author or "-", row.wcsim, row.why))
        )
    return table
