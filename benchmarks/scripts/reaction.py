"""`python -m benchmarks reaction`: chairs that stand in the way of the traffic, and chairs that roll out before it."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich import box
from rich.table import Table

from wcsim.cli.shared.common import Bounds, OutFile, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from benchmarks.reaction.battery import Battery


@dataclass
class ReactionOptions:
    """Test whether traffic brakes for wheelchairs and passes them: contacts, waiting times, people who step aside."""

    town: str = "helsinki"
    """Real streets besides generated ones: a town's name, its folder, or a .sumocfg file; "" for none."""
    minutes: float = 10.0
    """Simulated minutes for which a chair stands at each place."""
    trials: int = 40
    """Trials in which a chair rolls into traffic, for each share of attentive drivers."""
    streets: int = 3
    """Number of generated streets to use, 1 to 3."""
    places: int = 1
    """Places of each kind in the town."""
    seed: int = 0
    """Seed of traffic, places and trials."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: ReactionOptions) -> int:
    """Run the bench."""
    Bounds(0.1, 120).check("--minutes", options.minutes)
    Bounds(1, 1000).check("--trials", options.trials)
    Bounds(1, 3).check("--streets", options.streets)
    Bounds(1, 20).check("--places", options.places)
    if options.town:
        find_town(options.town)

    from benchmarks.reaction.battery import BatteryOrder, run_battery

    console = stdout_console()
    order = BatteryOrder(
        town=options.town,
        seed=options.seed,
        standing_s=60.0 * options.minutes,
        trials=options.trials,
        streets=options.streets,
        places=options.places,
    )
    with tempfile.TemporaryDirectory(prefix="wcsim-bench-") as work:
        battery = run_battery(
            order, Path(work), lambda text: console.print(text, style="dim", highlight=False, markup=False)
        )
    console.print(_table(battery))
    if options.json is not None:
        write_json(options.json, asdict(battery))
    return 0


def _table(battery: Battery) -> Table:
    table = Table("what", "result", box=box.SIMPLE_HEAD)
    for kind, contacts in battery.standing.items():
        table.add_row(f"contacts with a standing chair: {kind}", str(contacts))
    rolled, trials = battery.roll_out, battery.roll_out["trials"]
    table.add_row("rolling out, all drivers attentive: trials with contact", f"{rolled['attention_1']} of {trials}")
    table.add_row("rolling out, no driver attentive: trials with contact", f"{rolled['attention_0']} of {trials}")
    table.add_row("passed the chair, of those with room", f"{battery.passed_share:.1%}")
    table.add_row("people who stepped aside into an obstacle", str(battery.deflect_overlaps))
    table.add_row("longest wait with room to pass", f"{battery.blocked_s_max:.1f} s")
    return table
