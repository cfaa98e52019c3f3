"""What each stage of an import costs in CPU time: wcsim's own work, and beside it SUMO's tools and other children."""

from __future__ import annotations

import resource
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich import box
from rich.table import Column, Table

from wcsim.core.reading import escaped

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
