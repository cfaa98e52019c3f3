"""The tables of a result, safety and service, for each part and for all, with a legend, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

Column = tuple[str, str, str]
_SAFE: tuple[Column, ...] = (
    ("episodes", "\nepisodes", "{:d}"),
    ("km", "\nkm", "{:.2f}"),
    ("crashes_own", "own\ncrash", "{:d}"),
    ("crashes_per_km", "own\nper km", "{:.2f}"),
    ("crashes_per_km_ci", "\n95 %", "{0:.1f}-{1:.1f}"),
    ("crashes_other", "other\ncrash", "{:d}"),
    ("drops", "\ndrops", "{:d}"),
    ("red_entries", "at\nred", "{:d}"),
    ("saved", "\nsaved", "{:d}"),
    ("lost", "\nlost", "{:d}"),
)
_THERE: tuple[Column, ...] = (
    ("kpi1_free_within", "close\nto user", "{:.1%}"),
    ("blocked_share", "\nblocked", "{:.1%}"),
    ("freezes", "times\nfrozen", "{:d}"),
    ("speed_mps", "\nm/s", "{:.2f}"),
    ("arrivals", "\narrivals", "{:d}"),
    ("road_s", "seconds\non road", "{:.0f}"),
    ("score", "\nscore", "{:.3f}"),
    ("score_ci", "\n95 %", "{0:.2f}-{1:.2f}"),
)
_JUDGED: tuple[Column, ...] = (
    ("interventions", "\n\ninterventions", "{:d}"),
    ("missed", "\nmissed\ncrashes", "{:d}"),
    ("judged_episodes", "\njudged\nepisodes", "{:d}"),
    ("needed", "\n\nneeded", "{:d}"),
    ("needless", "\n\nunneeded", "{:d}"),
    ("warned_share", "\nwarned\nin time", "{:.0%}"),
    ("false_warnings_per_km", "false\nwarnings\nper km", "{:.0f}"),
    ("helps", "\n\nhelp", "{:d}"),
)
LEGEND = """\
own crash: the chair's fault; at red: entered a crossing at red
saved: only the user alone has an own crash there; lost: only the policy has one
close to user: share of moving steps without danger within 0.177 of the command
blocked: share of steps without danger that give less than half of a push ahead
frozen: stood 3 s or more against the stick; on road: stood on a carriageway
needed: else the user crashes within 5 s; missed: own crash, no intervention
warned in time: share of dangers with a warning at least 1 s ahead
help: times that the user asked for it"""


def show_result(
    console: Console, result: Mapping[str, Any], changed: Sequence[str], undriven: Sequence[str] = (), verdict: str = ""
) -> None:
    """Print a result of `wcsim test --suite`: three tables for each part, and three for all where there are several.

    The verdict stands last: the tables of a long list leave the screen.

    Args:
        console: Where.
        result: As `result.json` has it.
        changed: Settings over those of the list.
        undriven: Lines on policies that failed or were refused.
        verdict: What the test says in a few sentences.
    """
    version = f"{result['suite']} {result['set']}{' CHANGED by ' + ' '.join(changed) if changed else ''}"
    parts = list(dict.fromkeys(row["part"] for row in result["rows"]))
    for part in parts if len(parts) == 1 else [*parts, ""]:
        rows = [row for row in (result["rows"] if part else result["pooled"]) if row["part"] == part]
        title = f"{version}: {part or 'all parts'}"
        for what, columns in (("safety", _SAFE), ("service", _THERE), ("interventions and warnings", _JUDGED)):
            console.print(_table(f"{title}, {what}", columns, rows))
    console.print(LEGEND, style="dim", highlight=False)
    for line in undriven:
        console.print(line, style="bold", markup=False, soft_wrap=True)
    console.print("SIMULATION ONLY: these figures say nothing about a real street.", style="dim")
    if verdict:
        console.print(verdict, style="bold", markup=False, highlight=False)


_MOVED: tuple[Column, ...] = (
    ("crashes_own", "own\ncrash", "{:d}"),
    ("crashes_other", "other\ncrash", "{:d}"),
    ("kpi1_free_within", "close\nto user", "{:.1%}"),
    ("speed_mps", "\nm/s", "{:.2f}"),
    ("score", "\nscore", "{:.3f}"),
    ("score_change", "change\nof score", "{:+.3f}"),
    ("score_change_ci", "\n95 %", "{0:+.2f} to {1:+.2f}"),
)


def show_sensitivity(console: Console, title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the rows of `wcsim test --suite --sensitivity`, a table for each policy."""
    for policy in dict.fromkeys(row["policy"] for row in rows):
        own = [{**row, "policy": row["disturbance"]} for row in rows if row["policy"] == policy]
        console.print(_table(f"{title}: {policy}, with each disturbance alone", _MOVED, own, "disturbance"))
    console.print("change of score: against the same episodes without noise and delay", style="dim")


def _table(title: str, columns: Sequence[Column], rows: Sequence[Mapping[str, Any]], first: str = "policy") -> Table:
    table = Table(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 0), pad_edge=False)
    deep = max(heading.count("\n") for _, heading, _ in columns)
    table.add_column("\n" * deep + first, no_wrap=True)
    for _, heading, _ in columns:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(Text(str(row["policy"])), *(_cell(row.get(key), text) for key, _, text in columns))
    return table


def _cell(value: Any, text: str) -> str:
    if value is None:
        return "-"
    return text.format(*value) if isinstance(value, list) else text.format(value)
