"""Copies of a world take nothing of it: not its place in a file, and not its logs."""

import shutil
from pathlib import Path

import pytest

from wcsim.bridge.world import World
from wcsim.bridge.world_copy import in_copy
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig, resolve
from wcsim.towns.scenario.town import Town, find_town
from wcsim.types import SeatSpec

TICKS = 300


@pytest.fixture
def busy(corner: Path, tmp_path: Path) -> Town:
    """The corner with a file of routes that SUMO reads bit by bit: it takes 1 MiB at a time."""
    folder = tmp_path / "busy"
    shutil.copytree(corner, folder)
    (routes,) = folder.glob("*.rou.xml")
    car = '<vehicle id="more.{0}" type="car" depart="{1}"><route edges="WC CE"/></vehicle><!-- {2} -->'
    rows = [car.format(number, 8 + 2 * number, "." * 200000) for number in range(30)]
    routes.write_text(routes.read_text("utf-8").replace("</routes>", "\n".join([*rows, "</routes>"])), "utf-8")
    (scenario,) = folder.glob("*.sumocfg")
    text = scenario.read_text("utf-8")
    scenario.write_text(text.replace("</input>", '<route-steps value="5"/></input>'), "utf-8")
    return find_town(str(folder))


def driven(town: Town, every: int) -> str:
    """The hash of a world's last tick, after copies of it have driven on."""
    config = resolve(RunConfig(), ("world.draw_threads=1", "world.warmup_s=0"))

    def far(copy: World) -> bytes:
        for _, step in zip(range(TICKS), rollout(copy), strict=False):
            last = step.after.state_hash
        return last.encode()

    with World(town, config, (SeatSpec(),), 3) as world:
        for tick, _ in zip(range(TICKS), rollout(world), strict=False):
            if every and tick % every == 0:
                in_copy(world, far)
        return world.snapshot.state_hash


def test_what_a_copy_reads_of_the_routes_is_not_missing_in_the_world(busy):
    assert driven(busy, 100) == driven(busy, 0)
