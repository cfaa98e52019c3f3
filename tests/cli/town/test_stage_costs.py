"""What an import says of its CPU time: each stage once, tools beside wcsim's own, and sums that are right."""

from __future__ import annotations

import io
import subprocess
import sys

import pytest
from rich.console import Console

from wcsim.cli.town.town_check import (
    StageClock,
    StageCost,
    _cpu_time,
    costs_json,
    costs_table,
    netconvert_s,
)

COSTS = (
    StageCost(stage="starting", own_s=0.25, tools_s=0.0),
    StageCost(stage="reading a.osm", own_s=1.0, tools_s=0.5),
    StageCost(stage="building the net of 0.6 x 0.6 km", own_s=1.5, tools_s=4.0),
    StageCost(stage="checking the town", own_s=2.0, tools_s=0.75),
)


def shown(costs: tuple[StageCost, ...]) -> list[list[str]]:
    """The cells of the printed table."""
    out = io.StringIO()
    Console(file=out, width=80).print(costs_table(costs))
    lines = (line.rsplit(maxsplit=2) for line in out.getvalue().splitlines())
    return [words for words in lines if len(words) == 3 and words[1].replace(".", "").isdigit()]


def test_each_stage_costs_what_passed_between_its_begin_and_the_next() -> None:
    times = iter([(1.0, 10.0), (1.25, 10.0), (2.25, 10.5), (3.75, 14.5), (5.75, 15.25)])
    heard: list[str] = []
    clock = StageClock(heard.append, lambda: next(times))
    for cost in COSTS[1:]:
        clock.begin(cost.stage)
    assert heard == [cost.stage for cost in COSTS[1:]]
    assert clock.costs() == COSTS


def test_the_table_has_every_stage_and_sums_up() -> None:
    rows = shown(COSTS)
    assert [words[0].strip() for words in rows] == [*(cost.stage for cost in COSTS), "all"]
    for column in (1, 2):
        *parts, whole = (float(words[column]) for words in rows)
        assert sum(parts) == pytest.approx(whole) != 0.0


def test_netconvert_is_the_building_of_the_net() -> None:
    taken = tuple(cost for cost in COSTS if not cost.stage.startswith("building"))
    assert (netconvert_s(COSTS), netconvert_s(taken)) == (4.0, 0.0)


def test_the_result_file_says_the_same() -> None:
    told = costs_json(COSTS)
    assert (told["own_s"], told["tools_s"], told["netconvert_s"]) == (4.75, 5.25, 4.0)
    assert told["stages"][1] == {"stage": "reading a.osm", "own_s": 1.0, "tools_s": 0.5}


def test_children_are_tools_and_the_rest_is_ours() -> None:
    def burn(seconds: float) -> str:
        return f"import time\nwhile time.process_time() < {seconds}: pass"

    clock = StageClock(lambda stage: None)
    clock.begin("a child works")
    subprocess.run([sys.executable, "-c", burn(0.2)], check=True)
    clock.begin("we work")
    exec_until = _cpu_time()[0] + 0.1
    while _cpu_time()[0] < exec_until:
        pass
    _, child, ours = clock.costs()
    assert child.tools_s > child.own_s
    assert ours.own_s > ours.tools_s == 0.0
