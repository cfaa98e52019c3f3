"""`python -m benchmarks reaction`: chairs in the way of the traffic, and the street held against published figures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from rich import box
from rich.table import Table

from wcsim.cli.shared.common import Bounds, OutFile, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.core.own_folder import create_temporary_folder

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from benchmarks.reaction.battery import Battery


@dataclass
class ReactionOptions:
    """Test whether traffic brakes for wheelchairs and passes them: contacts, waiting times, people who step aside."""

    town: str = "helsinki"
    """Real streets besides generated ones: a town's name, its folder, or a .sumocfg file; "" for none."""
    minutes: float = 10.0
    """Simulated minutes for which a chair stands at each place."""
    seed: int = 0
    """Seed of traffic and places."""
    page: OutFile = None
    """Instead, hold towns and seeds of its own against published figures, and write the page to this file."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: ReactionOptions) -> int:
    """Run the bench."""
    Bounds(0.1, 120).check("--minutes", options.minutes)

    from benchmarks.reaction.battery import run_battery
    from benchmarks.reaction.validation import page

    console = stdout_console()

    def told(text: str) -> None:
        console.print(text, style="dim", highlight=False, markup=False)

    with create_temporary_folder() as work:
        if options.page is not None:
            options.page.write_text(page(5, 300.0, work, told), "utf-8")
            return 0
        battery = run_battery(options.town, options.seed, 60.0 * options.minutes, work, told)
    console.print(_table(battery))
    if options.json is not None:
        write_json(options.json, asdict(battery))
    return 0


def _table(battery: Battery) -> Table:
    table = Table("what", "result", box=box.SIMPLE_HEAD)
    for kind, contacts in battery.standing.items():
        table.add_row(f"contacts with a standing chair: {kind}", str(contacts))
    table.add_row("passed the chair, of those with room", f"{battery.passed_share:.1%}")
    table.add_row("people who stepped aside into an obstacle", str(battery.deflect_overlaps))
    table.add_row("longest wait with room to pass", f"{battery.blocked_s_max:.1f} s")
    return table
