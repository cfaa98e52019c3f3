"""The tables of a result on a console, for each part and for all, legend and verdict."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import repeat
from textwrap import wrap
from typing import TYPE_CHECKING, Final

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from wcsim.agents.evaluation.suite.rows import LOOK, Column, ResultRow, filled_columns
from wcsim.cli.shared.common import shorten_lines

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.evaluation.suite.result_files import TestResult
    from wcsim.agents.evaluation.suite.shifts import ShiftRow

# Widths in characters; the first is that of the longest numbers of a row.
_NUMBERS_WIDTH: Final = 68
_SHORTEST_NAME: Final = 14
_LEGEND_WIDTH: Final = 76
_HEADING_WIDTH: Final = 13
_BOUNDS: Final = {
    "oracle": "oracle knows the true state: an upper bound",
    "oracle-visible": "oracle-visible: the true state, but only road users in its cameras",
}


def print_test_result(
    console: Console, result: TestResult, undriven: Sequence[str] = (), verdict: str = ""
) -> None:
    """Print a result: a table of each part, and of all where there are several; then the crashes.

    The verdict is last, as the tables of a long list leave the screen.

    Args:
        console: Where.
        result: Of `wcsim test`.
        undriven: Lines on policies that failed or were refused.
        verdict: The result in a few sentences.
    """
    changed = f" CHANGED by {' '.join(result.changed)}" if result.changed else ""
    labels = _row_labels(list(result.episodes), console.width - _NUMBERS_WIDTH)
    look = filled_columns(LOOK, result.pooled)
    for part, rows in _rows_by_part(result):
        lines = [[labels[row.policy], *map(_cell, look, repeat(row))] for row in rows]
        console.print(f"{result.suite} {result.set}{changed}: {part}", soft_wrap=True)
        console.print(_table(["policy", *(column.heading for column in look)], lines))
    for name, label in labels.items():
        if label != name:
            console.print(_wrap_path(f"{label}: {name}"))
    for column in look:
        console.print(
            "\n".join(wrap(f"{column.heading}: {column.description}", _LEGEND_WIDTH)), style="dim"
        )
    console.print(
        "below a figure: its 95 % range; `wcsim report` and result.json have all others",
        style="dim",
    )
    for name in result.episodes:
        if name in _BOUNDS:
            console.print(_BOUNDS[name], style="dim")
    for line in shorten_lines(_crash_lines(result), "crashes; episodes.json has all"):
        console.print(line, soft_wrap=True)
    for line in undriven:
        console.print(line, style="bold", soft_wrap=True)
    console.print("SIMULATION ONLY: these figures say nothing about a real street.", style="dim")
    if verdict:
        console.print(verdict, style="bold")


def _rows_by_part(result: TestResult) -> list[tuple[str, list[ResultRow]]]:
    """Each part's rows, and those of all parts where there are several."""
    found = [(part, [row for row in result.rows if row.part == part]) for part in result.parts]
    if len(found) > 1:
        found.append(("all parts", list(result.pooled)))
    return found


def _crash_lines(result: TestResult) -> list[str]:
    """Every crash, with its policy, episode, reason, fault and partner."""
    from wcsim.agents.evaluation.suite.records import CRASHED
    from wcsim.supervisor.rewards import format_crash_summary

    return [
        f"{policy}, episode {record.block}.{record.seat}: "
        f"{format_crash_summary(record.reason, record.fault, record.crash)}"
        for policy, records in result.episodes.items()
        for record in records
        if record.status == CRASHED
    ]


def print_shifts(console: Console, title: str, rows: Sequence[ShiftRow]) -> None:
    """Print what `wcsim test --suite --sensitivity` found, a table for each policy."""
    look = filled_columns(LOOK, [each.row for each in rows])
    headings = ["shift", *(column.heading for column in look), "loss of score", "tau", "left out"]
    for policy in dict.fromkeys(each.row.policy for each in rows):
        lines = []
        for each in rows:
            if each.row.policy == policy:
                loss = "-" if each.loss is None else f"{each.loss:+.2f}"
                if each.loss_ci is not None:
                    loss = f"{loss}\n{each.loss_ci[0]:+.2f} to {each.loss_ci[1]:+.2f}"
                tau = "-" if each.tau is None else f"{each.tau:.2f}"
                cells = map(_cell, look, repeat(each.row))
                lines.append([each.shift, *cells, loss, tau, str(each.left_out)])
        console.print(f"{title} and its shifts: {policy}")
        console.print(_table(headings, lines))
    for line in (
        "loss of score: against the same drives as listed",
        "tau: Kendall's, of the order of all policies here; 1 is the order as listed",
        "left out: drives in which no copy of the world survived the user's crash",
    ):
        console.print(line, style="dim")


def _cell(column: Column, row: ResultRow) -> str:
    """A figure, and below it its range."""
    figure, bounds = column.texts(row)
    return f"{figure or '-'}\n{bounds}".strip()


def _table(headings: Sequence[str], lines: Sequence[Sequence[str]]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 0), pad_edge=False)
    wrapped = [wrap(heading, _HEADING_WIDTH) for heading in headings]
    height = max(map(len, wrapped))
    for number, heading in enumerate(wrapped):
        # At the bottom of the head.
        text = "\n" * (height - len(heading)) + "\n".join(heading)
        table.add_column(text, justify="right" if number else "left", no_wrap=True)
    for line in lines:
        table.add_row(*map(Text, line))
    return table


def _row_labels(names: Sequence[str], longest: int) -> dict[str, str]:
    """The label of each policy in a row: its name, the end of its path, or its number."""
    longest = max(longest, _SHORTEST_NAME)
    ends = [name.rstrip("/").rpartition("/")[2] for name in names]
    found = {}
    for number, (name, end) in enumerate(zip(names, ends, strict=True), 1):
        if len(name) <= longest:
            found[name] = name
        elif len(end) <= longest and end not in names and ends.count(end) == 1:
            found[name] = end
        else:
            found[name] = f"policy {number}"
    return found


def _wrap_path(line: str) -> str:
    """A line that is wrapped behind a / where it is too long for a table."""
    lines = [""]
    for part in re.findall(r"[^/]*/|[^/]+", line):
        if lines[-1] and len(lines[-1] + part) > _LEGEND_WIDTH:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)
