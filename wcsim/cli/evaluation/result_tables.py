"""The tables of a result on a console, for each part and for all, with a legend, and the verdict."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import repeat
from textwrap import wrap
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from wcsim.agents.evaluation.suite.rows import LOOK, Column, ResultRow
from wcsim.cli.shared.common import first_few

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.evaluation.suite.result_files import TestResult
    from wcsim.agents.evaluation.suite.sensitivity import Disturbed

_NUMBERS_WIDTH = 68  # characters of the longest numbers
_SHORTEST_NAME, _LEGEND_WIDTH, _HEADING_WIDTH = 14, 76, 13
_BOUNDS = {
    "oracle": "oracle knows the true state: an upper bound",
    "oracle-visible": "oracle-visible: the true state, but only road users in its cameras",
}


def show_result(
    console: Console, result: TestResult, undriven: Sequence[str] = (), verdict: str = ""
) -> None:
    """Print a result: what a first look needs of each part, and of all where there are several; then the crashes.

    The verdict stands last: the tables of a long list leave the screen.

    Args:
        console: Where.
        result: Of `wcsim test`.
        undriven: Lines on policies that failed or were refused.
        verdict: What the test says in a few sentences.
    """
    changed = f" CHANGED by {' '.join(result.changed)}" if result.changed else ""
    labels = _labels(list(result.episodes), console.width - _NUMBERS_WIDTH)
    for part, rows in _parts(result):
        lines = [[labels[row.policy], *map(_cell, LOOK, repeat(row))] for row in rows]
        title = f"{result.suite} {result.set}{changed}: {part}"
        console.print(_table(title, ["policy", *(column.heading for column in LOOK)], lines))
    for name, label in labels.items():
        if label != name:
            console.print(_broken(f"{label}: {name}"))
    for column in LOOK:
        console.print(
            "\n".join(wrap(f"{column.heading}: {column.says}", _LEGEND_WIDTH)), style="dim"
        )
    console.print(
        "below a figure: its 95 % range; `wcsim report` and result.json have all others",
        style="dim",
    )
    for note in (_BOUNDS[name] for name in result.episodes if name in _BOUNDS):
        console.print(note, style="dim")
    for line in first_few(_crashed(result), "crashes; episodes.json has all"):
        console.print(line, soft_wrap=True)
    for line in undriven:
        console.print(line, style="bold", soft_wrap=True)
    console.print("SIMULATION ONLY: these figures say nothing about a real street.", style="dim")
    if verdict:
        console.print(verdict, style="bold")


def _parts(result: TestResult) -> list[tuple[str, list[ResultRow]]]:
    """Each part's rows, and those of all where there are several parts."""
    found = [(part, [row for row in result.rows if row.part == part]) for part in result.parts]
    return found if len(found) == 1 else [*found, ("all parts", list(result.pooled))]


def _crashed(result: TestResult) -> list[str]:
    """Every crash, with its policy, episode, reason, fault, with whom and where."""
    from wcsim.agents.evaluation.suite.records import CRASHED
    from wcsim.supervisor.rewards import blamed

    return [
        f"{policy}, episode {record.block}.{record.seat}: {blamed(record.reason, record.fault, record.crash)}"
        for policy, records in result.episodes.items()
        for record in records
        if record.status == CRASHED
    ]


def show_sensitivity(console: Console, title: str, moved: Sequence[Disturbed]) -> None:
    """Print what `wcsim test --suite --sensitivity` found, a table for each policy."""
    for policy in dict.fromkeys(each.row.policy for each in moved):
        own = [each for each in moved if each.row.policy == policy]
        lines = [
            [each.disturbance, *map(_cell, LOOK, repeat(each.row)), _change(each)] for each in own
        ]
        headings = ["disturbance", *(column.heading for column in LOOK), "change of score"]
        console.print(_table(f"{title}: {policy}, with each disturbance alone", headings, lines))
    console.print("change of score: against the same drives without noise and delay", style="dim")


def _change(moved: Disturbed) -> str:
    low_high = moved.score_change_ci
    return f"{moved.score_change:+.3f}" + (
        "" if low_high is None else f"\n{low_high[0]:+.2f} to {low_high[1]:+.2f}"
    )


def _cell(column: Column, row: ResultRow) -> str:
    """A figure, and below it its range."""
    figure, bounds = column.texts(row)
    return f"{figure or '-'}\n{bounds}".strip()


def _table(title: str, headings: Sequence[str], lines: Sequence[Sequence[str]]) -> Table:
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 0), pad_edge=False
    )
    broken = [wrap(heading, _HEADING_WIDTH) for heading in headings]
    deep = max(map(len, broken))
    for number, heading in enumerate(broken):
        lower = "\n" * (deep - len(heading)) + "\n".join(heading)
        table.add_column(lower, justify="right" if number else "left", no_wrap=True)
    for line in lines:
        table.add_row(*map(Text, line))
    return table


def _labels(names: Sequence[str], longest: int) -> dict[str, str]:
    """What each policy is called in a row: its name, the end of its path, or its number."""
    longest = max(longest, _SHORTEST_NAME)
    ends = [name.rstrip("/").rpartition("/")[2] for name in names]
    found = {}
    for number, (name, end) in enumerate(zip(names, ends, strict=True), 1):
        alone = end not in names and ends.count(end) == 1 and len(end) <= longest
        found[name] = name if len(name) <= longest else end if alone else f"policy {number}"
    return found


def _broken(line: str) -> str:
    """A line that is broken behind a / where it is too long for a table."""
    lines = [""]
    for part in re.findall(r"[^/]*/|[^/]+", line):
        if lines[-1] and len(lines[-1] + part) > _LEGEND_WIDTH:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)
