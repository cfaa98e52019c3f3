"""The tables of a result: safety and service, for each part and for all."""

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
    ("episodes", "epi-\nsodes", "{:d}"),
    ("km", "\nkm", "{:.2f}"),
    ("crashes_own", "own\ncrash", "{:d}"),
    ("crashes_per_km", "own\n/km", "{:.2f}"),
    ("crashes_per_km_ci", "\n95 %", "{0:.1f}-{1:.1f}"),
    ("crashes_other", "other\ncrash", "{:d}"),
    ("drops", "\ndrops", "{:d}"),
    ("red_entries", "at\nred", "{:d}"),
    ("saved", "\nsaved", "{:d}"),
    ("lost", "\nlost", "{:d}"),
)
_THERE: tuple[Column, ...] = (
    ("kpi1_free_within", "\nwithin", "{:.1%}"),
    ("blocked_share", "\nblocked", "{:.1%}"),
    ("freezes", "\nfroze", "{:d}"),
    ("speed_mps", "\nm/s", "{:.2f}"),
    ("arrivals", "arri-\nvals", "{:d}"),
    ("road_s", "s on\nroad", "{:.0f}"),
    ("score", "\nscore", "{:.3f}"),
    ("score_ci", "\n95 %", "{0:.2f}-{1:.2f}"),
)
_JUDGED: tuple[Column, ...] = (
    ("interventions", "inter-\nventions", "{:d}"),
    ("missed", "\nmissed", "{:d}"),
    ("judged_episodes", "episodes\njudged", "{:d}"),
    ("needed", "\nneeded", "{:d}"),
    ("needless", "\nneedless", "{:d}"),
    ("warned_share", "\nwarned", "{:.0%}"),
    ("false_warnings_per_km", "false\n/km", "{:.0f}"),
)


def show_result(
    console: Console, result: Mapping[str, Any], changed: Sequence[str], undriven: Sequence[str] = ()
) -> None:
    """Print a result of `wcsim test --suite`: three tables for each part, and three for all where there are several.

    Args:
        console: Where.
        result: As `result.json` has it.
        changed: Settings over those of the list.
        undriven: Lines on policies that failed or were refused.
    """
    version = f"{result['suite']} {result['set']}{' CHANGED by ' + ' '.join(changed) if changed else ''}"
    parts = list(dict.fromkeys(row["part"] for row in result["rows"]))
    for part in parts if len(parts) == 1 else [*parts, ""]:
        rows = [row for row in (result["rows"] if part else result["pooled"]) if row["part"] == part]
        title = f"{version}: {part or 'all parts'}"
        for what, columns in (("safety", _SAFE), ("service", _THERE), ("interventions and warnings", _JUDGED)):
            console.print(_table(f"{title}, {what}", columns, rows))
    console.print("saved, lost: own crashes that the user alone has and the policy has not, and the other way round")
    for line in undriven:
        console.print(line, style="bold", markup=False, soft_wrap=True)
    console.print("SIMULATION ONLY: these figures say nothing about a real street.", style="dim")


_MOVED: tuple[Column, ...] = (
    ("crashes_own", "own\ncrash", "{:d}"),
    ("crashes_other", "other\ncrash", "{:d}"),
    ("kpi1_free_within", "\nwithin", "{:.1%}"),
    ("speed_mps", "\nm/s", "{:.2f}"),
    ("score", "\nscore", "{:.3f}"),
    ("score_change", "change\nof it", "{:+.3f}"),
    ("score_change_ci", "\n95 %", "{0:+.2f} to {1:+.2f}"),
)


def show_sensitivity(console: Console, title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the rows of `wcsim test --suite --sensitivity`, a table for each policy."""
    for policy in dict.fromkeys(row["policy"] for row in rows):
        own = [{**row, "policy": row["disturbance"]} for row in rows if row["policy"] == policy]
        console.print(_table(f"{title}: {policy}, each disturbance alone", _MOVED, own))
    console.print("change of it: mean over the same episodes driven clean", style="dim")


def _table(title: str, columns: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 0), pad_edge=False)
    table.add_column("\npolicy", no_wrap=True)
    for _, heading, _ in columns:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(Text(str(row["policy"])), *(_cell(row.get(key), text) for key, _, text in columns))
    return table


def _cell(value: Any, text: str) -> str:
    if value is None:
        return "-"
    return text.format(*value) if isinstance(value, list) else text.format(value)
