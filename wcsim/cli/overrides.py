"""The table of what a run overrides of a town's own SUMO scenario."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from wcsim.reading import shown
from wcsim.towns.scenario_overrides import Override

_MOST = 2000  # letters in a cell


def print_overrides(console: Console, town: str, overrides: Sequence[Override], notes: Sequence[str] = ()) -> None:
    """What differs from a scenario's own options, as one table."""
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
        table.add_row(*(Text(shown(cell, _MOST)) for cell in cells))  # a scenario's own words are no markup
    console.print(table)
    for note in notes:
        console.print(f"note: {note}", markup=False, highlight=False)
