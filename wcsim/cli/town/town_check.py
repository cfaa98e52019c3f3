"""`wcsim town check`, which every new town goes through too: whether it works, and whether SUMO runs all of it."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Column, Table

from wcsim.cli.shared.common import OutFile, TownWord, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.config import resolve
from wcsim.core.reading import counted, escaped, listed
from wcsim.errors import SumoError, TownError
from wcsim.towns.checks.cures import Cures
from wcsim.towns.scenario.options import read_configuration
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scenario.stage import stage_scenario
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import read_root

if TYPE_CHECKING:  # loads what builds streets, which --help must not
    from wcsim.towns.checks.check import TownReport


NET_STAGE = "building the net"  # of an import: netconvert is the one child of it
_FIRST = "starting"
_SHOWN = 60  # letters of a stage

CpuTime = tuple[float, float]  # s, of this process with its threads, and of its children that have ended


@dataclass(frozen=True, slots=True, kw_only=True)
class StageCost:
    """CPU time of one stage."""

    stage: str
    own_s: float
    tools_s: float  # of children: netconvert, polyconvert, duarouter, sumo, and what reads an extract


def _cpu_time() -> CpuTime:
    """User and system time of this process, and of its children that have ended."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime, children.ru_utime + children.ru_stime


class StageClock:
    """Hears which stage begins, says it on, and keeps what the one before has cost."""

    def __init__(self, told: Callable[[str], None], now: Callable[[], CpuTime] = _cpu_time) -> None:
        self._told = told
        self._now = now
        self._stage = _FIRST
        self._since = now()
        self._costs: list[StageCost] = []

    def begin(self, stage: str) -> None:
        """A stage begins, and the one before ends."""
        self._lap()
        self._stage = stage
        self._told(stage)

    def costs(self) -> tuple[StageCost, ...]:
        """What all stages have cost so far, the present one last."""
        self._lap()
        return tuple(self._costs)

    def _lap(self) -> None:
        own_s, tools_s = self._now()
        cost = StageCost(stage=self._stage, own_s=own_s - self._since[0], tools_s=tools_s - self._since[1])
        self._costs.append(cost)
        self._since = (own_s, tools_s)


def netconvert_s(costs: Sequence[StageCost]) -> float:
    """CPU time of netconvert, all of its runs together; 0 where a net was taken as it is."""
    return sum(cost.tools_s for cost in costs if cost.stage.startswith(NET_STAGE))


def costs_table(costs: Sequence[StageCost]) -> Table:
    """The stages with their costs, and the sum."""
    table = Table(
        Column("CPU time in s", overflow="fold"),
        Column("wcsim", justify="right"),
        Column("tools", justify="right"),
        box=box.SIMPLE_HEAD,
        show_footer=False,
    )
    for cost in costs:
        table.add_row(escaped(cost.stage, _SHOWN), f"{cost.own_s:.2f}", f"{cost.tools_s:.2f}")
    table.add_section()
    table.add_row("all", f"{_sum(costs).own_s:.2f}", f"{_sum(costs).tools_s:.2f}")
    return table


def costs_json(costs: Sequence[StageCost]) -> dict[str, Any]:
    """The same for a result file."""
    whole = _sum(costs)
    stages = [asdict(cost) for cost in costs]
    return {"stages": stages, "own_s": whole.own_s, "tools_s": whole.tools_s, "netconvert_s": netconvert_s(costs)}


def _sum(costs: Sequence[StageCost]) -> StageCost:
    return StageCost(stage="all", own_s=sum(c.own_s for c in costs), tools_s=sum(c.tools_s for c in costs))


COLLIDING_S = 300.0
_LIMITS = Limits(wall_s=60.0, cpu_s=60, memory_bytes=16 << 30)
_TOLD = 3


@dataclass
class CheckOptions:
    """Check a town: connected pavements, routes, ground, and whether SUMO runs it."""

    town: TownWord
    """A town's name, its folder, or a .sumocfg file."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: CheckOptions) -> int:
    """Check, and print the result; 0 when the town has no faults, else 1."""
    started_s = time.monotonic()
    return told_report(checked(find_town(options.town)), started_s, options.json)


def checked(town: Town, share: float | None = None, told: Callable[[str], None] = lambda stage: None) -> TownReport:
    """`check_town`, SUMO's refusal among the faults, and collisions among the notes; `told` hears the stage.

    Raises TownError as `check_town` does.
    """
    from wcsim.towns.checks.check import check_town  # loads what builds streets, which --help must not

    told("checking the town")
    report = check_town(town, share)
    told("testing the first steps in SUMO")
    try:
        try_town(town)
    except TownError as refused:
        return replace(report, faults=(*report.faults, str(refused)))
    told(f"testing {COLLIDING_S:g} s of traffic in SUMO")
    return replace(report, notes=(*report.notes, *_collisions_note(town)))


def _collisions_note(town: Town) -> tuple[str, ...]:
    """Who collides in the first COLLIDING_S of a town's traffic, by SUMO itself, or that this takes too long."""
    with tempfile.TemporaryDirectory(prefix="wcsim-trial-", ignore_cleanup_errors=True) as work:
        staged = stage_scenario(town, Settings(world=resolve("quick").world, seed=1), Path(work))
        seed = read_configuration(town.sumocfg).value("seed")
        found = Path(work) / "collisions.xml"
        words = ["-c", str(staged.sumocfg), "--end", f"{staged.begin_s + COLLIDING_S:.12g}"]
        words += ["--collision-output", str(found), *(("--seed", seed) if seed else ())]
        try:
            run_tool("sumo", words, Path(work), _LIMITS)
            told = [(hit.get("collider", ""), hit.get("victim", ""), hit.get("lane", "")) for hit in read_root(found)]
        except (SumoError, TownError):
            return (f"SUMO did not finish the first {COLLIDING_S:g} s of this traffic within {_LIMITS.wall_s:g} s",)
    hits = {frozenset((one, other)): f"{one} with {other} on {lane}" for one, other, lane in told}
    if not hits:
        return ()
    who = listed(hits.values(), _TOLD)
    return (
        f"SUMO itself reports {counted(len(hits), 'collision')} in the first {COLLIDING_S:g} s of this traffic: {who}; "
        f"its junction rules permit that, mostly for bicycles, and the vehicles pass through each other; half the "
        f"traffic collides about half as often: {Cures(town).traffic_alone()} --set world.demand_scale=0.5",
    )


def try_town(town: Town) -> None:
    """Let SUMO run the first steps of what a world would run, in a folder that goes; once for each state of its files.

    Raises TownError with SUMO's own words when it cannot.
    """
    from wcsim.bridge.sumo.open_scenario import open_scenario  # loads libsumo, which --help must not
    from wcsim.bridge.sumo.run_place import RunPlace

    with ExitStack() as held:
        open_scenario(town, Settings(world=resolve("quick").world, seed=1), RunPlace(), held)


def told_report(
    report: TownReport, began_s: float, json: Path | None, clock: StageClock | None = None, **more: Any
) -> int:
    """Print a report and what its stages cost, and write the result; returns 1 when the town has faults, else 0.

    Args:
        report: Of a town.
        began_s: When the command began, of the monotonic clock.
        json: The result file, None for none.
        clock: Of the stages, where they are told.
        more: What else the result file says.
    """
    costs = () if clock is None else clock.costs()
    table = Table(f"town {report.town}", "")
    table.add_row("crossings", str(report.crossings))
    table.add_row("walking areas", str(report.walkingareas))
    table.add_row("walkable area in the largest connected part", f"{report.walkable_largest_share:.3f}")
    table.add_row("classes in the demand", ", ".join(report.classes))
    table.add_row("trips without a route", str(report.unroutable))
    table.add_row("traffic drives on the", "left" if report.lefthand else "right")
    console = stdout_console()
    console.print(table)
    for line in (*(f"note: {note}" for note in report.notes), *(f"fault: {fault}" for fault in report.faults)):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if costs:
        console.print(costs_table(costs))
        more["cpu"] = costs_json(costs)
    told = asdict(report)
    del told["overlaps"], told["cut_off"]  # the notes and faults say them
    write_json(json, {**told, "seconds": round(time.monotonic() - began_s, 3), **more})
    return 1 if report.faults else 0
