"""The report of `wcsim town import` and `wcsim town check`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table

from wcsim.cli.shared.consoles import stdout_console

if TYPE_CHECKING:  # loads what builds streets, which --help must not
    from wcsim.towns.checks.check import TownReport


def print_report(report: TownReport) -> int:
    """Print a report; returns 1 when the town has faults, else 0."""
    table = Table(f"town {report.town}", "")
    table.add_row("crossings", str(report.crossings))
    table.add_row("walking areas", str(report.walkingareas))
    table.add_row("walkable area in the largest connected part", f"{report.walkable_largest_share:.3f}")
    table.add_row("classes in the demand", ", ".join(report.classes))
    table.add_row("trips without a route", str(report.unroutable))
    table.add_row("ground errors (missing, or wrong height)", str(report.mesh_faults))
    table.add_row("traffic drives on the", "left" if report.lefthand else "right")
    console = stdout_console()
    console.print(table)
    for line in (*(f"note: {note}" for note in report.notes), *(f"fault: {fault}" for fault in report.faults)):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    return 1 if report.faults else 0


def report_json(report: TownReport, seconds: float) -> dict[str, Any]:
    """A report as a result file holds it."""
    return {
        "town": report.town,
        "seconds": round(seconds, 3),
        "crossings": report.crossings,
        "walkingareas": report.walkingareas,
        "walkable_largest_share": report.walkable_largest_share,
        "walk_km": report.walk_km,
        "classes": list(report.classes),
        "unroutable": report.unroutable,
        "mesh_faults": report.mesh_faults,
        "lefthand": report.lefthand,
        "notes": list(report.notes),
        "faults": list(report.faults),
    }
