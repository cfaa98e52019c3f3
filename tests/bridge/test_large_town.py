"""A town of 25 square kilometres: only what is near a wheelchair is in memory."""

import subprocess
import sys
import time

import numpy as np
import pytest

from tests.bridge.sumo.grid_town import make_grid_town
from tests.support.worlds import follow, open_world
from wcsim.physics.engine import Engine
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.towns.ground.tiles import TILE_M
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street
from wcsim.types import WayKind

LIMIT_S, LIMIT_MB = 10.0, 1000.0


@pytest.fixture
def town(tmp_path):
    return make_grid_town(tmp_path / "big", blocks=4, vehicles=20, people=20)


def test_only_the_street_near_a_wheelchair_is_loaded(town):
    with open_world(town) as world:
        follow(world)
        near, everything = set(world._open.street.keys), set(world.street.tiles.keys)
        assert 0 < len(near) < 0.6 * len(everything)
        here = world.snapshot.clients[0].plant.p_WB_m[:2]
        starts = [edge.points_W_m[0] for edge in world.street.walk.edges if edge.kind is WayKind.SIDEWALK]
        place = max(starts, key=lambda p_m: float(np.hypot(*(p_m - here))))
        far = _tile(place)
        assert far in everything - near
        world.put_chair(0, place, 0.0)
        follow(world)
        assert far in world._open.street.keys
        assert abs(world.snapshot.clients[0].plant.p_WB_m[2] - 0.12) < 0.03  # it stands on the new tile's pavement


def test_a_chair_is_placed_once_and_on_a_street_that_is_there(town, monkeypatch):
    happened = []
    place, add_street = Wheelchair.place, Engine.add_street
    monkeypatch.setattr(Wheelchair, "place", lambda self, *at: happened.append(self.seat) or place(self, *at))
    monkeypatch.setattr(Engine, "add_street", lambda self, *mesh: happened.append("tile") or add_street(self, *mesh))
    with open_world(town, seats=2) as world:
        assert happened[0] == "tile" and happened[-2:] == [0, 1] and happened.count(0) == happened.count(1) == 1
        for begin in (lambda: world.respawn(1), lambda: world.put_chair(1, np.array((-250.0, -250.0)), 0.0)):
            happened.clear()
            begin()
            assert happened[-1] == 1 and set(happened[:-1]) <= {"tile"}
        happened.clear()
        follow(world)
        assert happened == []  # what a tick could need was there


def test_a_tile_that_nobody_is_near_leaves_the_engine_and_comes_back(town, monkeypatch):
    monkeypatch.setattr("wcsim.bridge.world.MOST_TILES", 1)
    monkeypatch.setattr("wcsim.bridge.world.ENGINE_STAY_M", 40.0)
    seen = []
    for _ in range(2):
        with open_world(town) as world:
            ways = [edge.points_W_m for edge in world.street.walk.edges if edge.kind is WayKind.SIDEWALK]
            middles = [0.5 * (way[0] + way[1]) for way in ways]
            here = min(middles, key=lambda p_m: p_m.sum())
            there = max(middles, key=lambda p_m: p_m.sum())
            laid, visits = world._open.street, []
            for place in (here, there, here, there, here):
                world.put_chair(0, place, 0.0)
                visits.append((_tile(here) in laid.keys, _tile(there) in laid.keys, len(laid.keys)))
                for _ in range(3):
                    snapshot = follow(world)
                assert abs(snapshot.clients[0].plant.p_WB_m[2] - 0.12) < 0.03
            assert [(a, b) for a, b, _ in visits[1:]] == [(False, True), (True, False)] * 2
            assert visits[2] == visits[4] and visits[1] == visits[3]
            seen.append((visits, snapshot.digest()))
    assert seen[0] == seen[1]


def _tile(p_W_m):
    return int(p_W_m[0] // TILE_M), int(p_W_m[1] // TILE_M)


FIRST_TICKS = """
import resource, sys, time
start = time.perf_counter()
import psutil
from wcsim.bridge.world_rollout import rollout
from wcsim.bridge.world import World
from wcsim.config import resolve
from wcsim.towns.scenario.town import find_town
from wcsim.types import SeatSpec
with World(find_town(sys.argv[1]), resolve("quick"), (SeatSpec(),), 0) as world:
    next(rollout(world))
    first_tick_s = time.perf_counter() - start
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu_s = sum(use.ru_utime + use.ru_stime for use in spent)
    for _ in range(20):
        next(rollout(world))
    print(first_tick_s, cpu_s, psutil.Process().memory_info().rss / 1e6)
"""


@pytest.mark.proof
@pytest.mark.timeout(1200)
def test_first_tick_of_25_square_kilometres_with_5000_actors(tmp_path):
    town = make_grid_town(tmp_path / "big", blocks=26, vehicles=2600, people=2600)
    load_street(find_town(str(town)))  # built once, by whoever comes first
    measured = []
    for _ in range(2):  # the first one also tries the scenario out in a child
        started_s = time.monotonic()
        told = subprocess.run(
            [sys.executable, "-c", FIRST_TICKS, str(town)], cwd=tmp_path, check=True, timeout=300, capture_output=True
        )
        first_tick_s, cpu_s, memory_mb = map(float, told.stdout.split()[-3:])
        measured.append((first_tick_s, cpu_s, memory_mb, time.monotonic() - started_s))
    first_tick_s, cpu_s, memory_mb, _ = measured[-1]
    # On an idle machine the clock says the same as the processor's time; beside other proofs it says what they take.
    assert min(first_tick_s, cpu_s) < LIMIT_S, measured
    assert memory_mb < LIMIT_MB, measured
