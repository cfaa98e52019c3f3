"""The bench of a world's memory: chairs come around, and what grows is seen."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.memory import roam as bench
from benchmarks.memory.roam import MemoryRow, RoamingWorld, growth_mb, roam
from tests.support.worlds import quick_config
from wcsim.towns.scenario.town import find_town
from wcsim.types import SeatSpec

# A leak so large that what a process of many tests gives back meanwhile (10 MB were seen) cannot hide it.
LEAK_MB = 16


@pytest.fixture
def world(corner, monkeypatch):
    monkeypatch.setattr(bench, "STAY_TICKS", 4)
    with RoamingWorld(find_town(str(corner)), quick_config(), (SeatSpec(),) * 2, 1) as world:
        yield world


def test_every_chair_jumps_from_pavement_to_pavement(world):
    places = []
    put = world.put_chair
    world.put_chair = lambda seat, xy_m, yaw_rad: places.append((seat, *np.round(xy_m, 3))) or put(seat, xy_m, yaw_rad)
    told: list[MemoryRow] = []
    rows = roam(world, 12, 5, 0, told.append)
    assert [row.tick for row in rows] == [0, 5, 10] and list(rows) == told
    assert sorted(seat for seat, *_ in places) == [0] * 3 + [1] * 3
    assert len({place[1:] for place in places}) == 6
    assert rows[-1].tiles == rows[-1].tiles_seen == len(world.street.tiles.near(np.zeros((1, 2)), 1e4))


@pytest.mark.proof
def test_what_grows_is_seen(world, monkeypatch):
    held = []
    monkeypatch.setattr(bench, "_jump", lambda *_: held.append(b"\1" * (LEAK_MB << 20)))
    rows = roam(world, 20, 5, 0, lambda row: None)
    assert growth_mb(rows) > 0.8 * 10 * LEAK_MB


@pytest.mark.proof
def test_what_does_not_grow_is_not_said_to(world):
    roam(world, 40, 40, 0, lambda row: None)  # what a world holds from its first ticks on is there now: 6 MB were seen
    rows = roam(world, 40, 5, 0, lambda row: None)
    assert growth_mb(rows) < 0.25 * LEAK_MB, "a quarter of one leak; there would be twenty"
