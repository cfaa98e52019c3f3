"""`wcsim town check`, also of every new town: does it work, and does SUMO run all of it?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from wcsim.cli.shared.common import OutFile, TownWord, write_json
from wcsim.cli.shared.consoles import show_table, stdout_console
from wcsim.config import resolve
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import join_names, pluralize
from wcsim.errors import SumoError, TownError
from wcsim.towns.checks.cures import Cures
from wcsim.towns.scenario.options import read_configuration
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scenario.stage import stage_scenario
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.warning_log import WarningLog
from wcsim.towns.sumo.xml_io import read_root

if TYPE_CHECKING:  # loads what builds streets, which --help must not
    from wcsim.towns.checks.check import TownReport

COLLIDING_S: Final = 300.0
_LIMITS: Final = Limits(wall_s=60.0, cpu_s=60, memory_bytes=16 << 30)
_MOST_NAMED: Final = 3


@dataclass
class TownCheckOptions:
    """Check a town: connected pavements, routes, and whether SUMO runs it.

    Ends with 0 when the town has no faults (notes are none), 1 when it has, 2 when none was read.
    """

    town: TownWord
    """A town's name, its folder, or a .sumocfg file."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: TownCheckOptions) -> int:
    """Check, and print the result; 0 when the town has no faults, else 1."""
    started_s = time.monotonic()
    return print_town_report(check_town_with_sumo(find_town(options.town)), started_s, options.json)


def check_town_with_sumo(
    town: Town, share: float | None = None, show: Callable[[str], None] = lambda stage: None
) -> TownReport:
    """Check a town, then let SUMO run it: a refusal is a fault, and collisions are a note.

    Args:
        town: The town.
        share: See `check_town`.
        show: Called with each stage.

    Raises:
        TownError: As `check_town` does.
    """
    from wcsim.towns.checks.check import check_town  # loads what builds streets

    show("checking the town")
    report = check_town(town, share)
    show("testing the first steps in SUMO")
    try:
        try_town_in_sumo(town)
    except TownError as refused:
        return replace(report, faults=(*report.faults, str(refused)))
    show(f"testing {COLLIDING_S:g} s of traffic in SUMO")
    return replace(report, notes=(*report.notes, *_traffic_notes(town)))


def _traffic_notes(town: Town) -> Iterator[str]:
    """SUMO's warnings and collisions in the first COLLIDING_S of the traffic, or its timeout."""
    with create_temporary_folder() as work:
        staged = stage_scenario(town, Settings(world=resolve("quick").world, seed=1), work)
        seed = read_configuration(town.sumocfg).value("seed")
        found = work / "collisions.xml"
        words = ["-c", str(staged.sumocfg), "--end", f"{staged.begin_s + COLLIDING_S:.12g}"]
        words += ["--collision-output", str(found), *(("--seed", seed) if seed else ())]
        try:
            run_tool("sumo", words, work, _LIMITS)
            log = WarningLog(staged.warnings)
            log.read()
            # Two vehicles collide once, however many steps that takes.
            hits = {
                frozenset((hit.get("collider"), hit.get("victim"))): (
                    f"{hit.get('collider')} with {hit.get('victim')} on {hit.get('lane')}"
                )
                for hit in read_root(found)
            }
        except (SumoError, TownError):
            yield (
                f"SUMO did not finish the first {COLLIDING_S:g} s of this traffic within "
                f"{_LIMITS.wall_s:g} s"
            )
            return
    if log.count:
        yield (
            f"SUMO warns {pluralize(log.count, 'time')} in the first {COLLIDING_S:g} s of this "
            f"traffic: {join_names(log.first.values(), _MOST_NAMED)}; to write all into a file: "
            f"{Cures(town).traffic_alone()}"
        )
    if hits:
        vehicles = join_names(hits.values(), _MOST_NAMED)
        yield (
            f"SUMO itself reports {pluralize(len(hits), 'collision')} in the first "
            f"{COLLIDING_S:g} s of this traffic: {vehicles}; its junction rules permit that, "
            "mostly for bicycles, and the vehicles pass through each other; half the traffic "
            "collides about half as often: "
            f"{Cures(town).traffic_alone()} --set world.demand_scale=0.5"
        )


def try_town_in_sumo(town: Town) -> None:
    """Let SUMO run a world's first steps in a temporary folder, once for each state of its files.

    Raises:
        TownError: It cannot, with SUMO's own message.
    """
    # These load libsumo, which --help must not.
    from wcsim.bridge.sumo.open_scenario import open_scenario
    from wcsim.types.episode import RunPlace

    with ExitStack() as held:
        open_scenario(town, Settings(world=resolve("quick").world, seed=1), RunPlace(), held)


def print_town_report(report: TownReport, started_s: float, json: Path | None, **more: Any) -> int:
    """Print a report and write the result; returns 1 when the town has faults, else 0.

    Args:
        report: Of a town.
        started_s: Of the command, by the monotonic clock.
        json: The result file, None for none.
        more: What else the result file holds.
    """
    rows = {
        "crossings": str(report.crossings),
        "walking areas": str(report.walkingareas),
        "walkable area in the largest connected part": f"{report.walkable_largest_share:.3f}",
        "classes in the demand": ", ".join(report.classes),
        "trips without a route": str(report.unroutable),
        "traffic drives on the": "left" if report.lefthand else "right",
    }
    show_table((f"town {report.town}", ""), rows.items())
    lines = [f"note: {note}" for note in report.notes]
    lines += [f"fault: {fault}" for fault in report.faults]
    for line in lines:
        stdout_console().print(line, soft_wrap=True)
    result = asdict(report)
    # Notes and faults have them as text.
    del result["overlaps"], result["cut_off"]
    write_json(json, {**result, "seconds": round(time.monotonic() - started_s, 3), **more})
    return 1 if report.faults else 0
