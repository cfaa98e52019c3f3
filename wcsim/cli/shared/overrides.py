"""What a run overrides of a town's own SUMO scenario, in a line or as a table."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from wcsim.cli.shared.consoles import stdout_console
from wcsim.core.reading import escaped
from wcsim.towns.scenario.overrides import Override

_MOST = 2000  # letters in a cell
_CALIBRATED = "step-length"  # what drivers were calibrated with: to run otherwise is more than housekeeping


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
        told = [f"{len(overrides)} of SUMO's options are not as in {town}'s scenario ({names}); {where}"]
        told += [
            f"{row.option} is {row.wcsim}: {row.why}" for row in overrides if row.author and row.option == _CALIBRATED
        ]
        for line in told:
            console.print(escaped(line, _MOST), markup=False, highlight=False)
    for note in notes:
        console.print(f"note: {note}", markup=False, highlight=False)


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
        cells = (row.option, row.author or "-", row.wcsim, row.why)
        table.add_row(*(Text(escaped(cell, _MOST)) for cell in cells))  # a scenario's own words are no markup
    return table
