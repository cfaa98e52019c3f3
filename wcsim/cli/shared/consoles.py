"""What the command line prints: results to stdout; notes, warnings and progress bars to stderr."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final, Self

from rich import box
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.table import Column, Table

from wcsim.core.closing import ClosingContextBase
from wcsim.core.reading import escape

if TYPE_CHECKING:
    from wcsim.towns.scenario.overrides import Override

# With the text beside it a row has 80 characters.
_BAR_WIDTH: Final = 16
_FIELDS: Final = ("description", "fields[text]", "fields[left]")
# A longer time is printed in minutes.
_MOST_SECONDS_S: Final = 90.0
# Characters in a cell.
_MOST_CHARACTERS: Final = 2000
# Drivers were calibrated with it: another value changes results.
_CALIBRATED: Final = "step-length"


def stdout_console() -> Console:
    """The console of results: it prints names such as `[/x]` and `:car:` as they are."""
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


def print_note(text: str) -> None:
    """Print a note on the progress."""
    stderr_console().print(text, style="dim", soft_wrap=True)


def warn(text: str) -> None:
    """Print what went wrong without ending the command."""
    print(f"wcsim: {text}", file=sys.stderr, flush=True)


def _time_left(spent_s: float, share: float) -> str:
    """How long the rest takes at the same speed; "" when that is not known, or nothing is left.

    >>> _time_left(30.0, 0.25), _time_left(30.0, 0.75), _time_left(30.0, 0.0)
    ('about 2 min left', 'about 10 s left', '')
    """
    if not 0.0 < share < 1.0:
        return ""
    left_s = spent_s * (1.0 - share) / share
    return (
        f"about {math.ceil(left_s / 5) * 5} s left"
        if left_s < _MOST_SECONDS_S
        else f"about {round(left_s / 60)} min left"
    )


class StageBar(ClosingContextBase):
    """A stage of a command and its progress; a context manager.

    A smaller share than before starts another stage.

    Args:
        name: Of the stage.
        clock: Seconds.
    """

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.console = stderr_console()
        # Without markup, as a name may look like a tag.
        name_column, *texts = (TextColumn(f"{{task.{field}}}", markup=False) for field in _FIELDS)
        columns = (name_column, BarColumn(_BAR_WIDTH), *texts)
        self._bar = Progress(*columns, console=self.console, disable=not self.console.is_terminal)
        self._task = self._bar.add_task(name, total=1.0, text="", left="")
        self._rows: dict[str, TaskID] = {}
        self._clock = clock
        self._started_s = clock()
        self._first: float | None = None  # share that was done before, as in a resumed run
        self._share = 0.0

    @property
    def is_terminal(self) -> bool:
        """Whether the bar is drawn; a log gets lines alone."""
        return self.console.is_terminal

    @property
    def left(self) -> str:
        """As `_time_left`, from the first `show` on."""
        first = self._first or 0.0
        return _time_left(
            self._clock() - self._started_s,
            (self._share - first) / (1.0 - first) if first < 1.0 else 1.0,
        )

    def show(self, share: float, text: str, name: str | None = None) -> None:
        """Show the share of the work that is done (0 to 1), what goes on, and the stage's name.

        The text has about 30 characters.
        """
        if self._first is None:
            self._first = share
        elif share < self._share:
            self._first, self._started_s = share, self._clock()
        self._share = share
        self._bar.update(self._task, completed=share, text=text, left=self.left, description=name)

    def print_line(self, line: str, *, left: bool = True) -> None:
        """Print a line above the bar; in a log `left` adds the time that is left."""
        more = self.left if left and not self.console.is_terminal else ""
        self.console.print(f"{line}, {more}" if more else line, soft_wrap=True)

    def rows(self, texts: dict[str, str]) -> None:
        """Show a row below the bar for each worker."""
        for name in self._rows.keys() - texts.keys():
            self._bar.remove_task(self._rows.pop(name))
        for name, text in texts.items():
            if name not in self._rows:
                self._rows[name] = self._bar.add_task(f"  {name}", total=None, text=text, left="")
            self._bar.update(self._rows[name], text=text)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def close(self) -> None:
        """The stage is over."""
        self._bar.stop()


def choose_result_console(live: Console) -> Console:
    """The console for results beside a live display: above it, or an output that is a file."""
    out = stdout_console()
    return live if live.is_terminal and out.is_terminal else out


def print_sumo_overrides(
    console: Console,
    town: str,
    overrides: Sequence[Override],
    notes: Sequence[str] = (),
    *,
    verbose: bool = False,
    in_manifest: bool = False,
) -> None:
    """Print which options of SUMO differ from a scenario's own.

    Args:
        console: Where to print.
        town: The town's name.
        overrides: The options.
        notes: Further notes; printed in any case.
        verbose: A table with values and reasons, instead of a line with the names.
        in_manifest: Whether the run's manifest holds them.
    """
    if verbose:
        console.print(_table(town, overrides))
    elif overrides:
        names = ", ".join(escape(row.option, 80) for row in overrides)
        where = "--verbose says why"
        if in_manifest:
            where += ", as does the run's manifest"
        lines = [
            f"{len(overrides)} of SUMO's options are not as in {town}'s scenario ({names}); {where}"
        ]
        lines += [
            f"{row.option} is {row.wcsim}: {row.why}"
            for row in overrides
            if row.author and row.option == _CALIBRATED
        ]
        for line in lines:
            console.print(escape(line, _MOST_CHARACTERS), highlight=False)
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
            *(
                escape(cell, _MOST_CHARACTERS)
                for cell in (row.option, row.author or "-", row.wcsim, row.why)
            )
        )
    return table
