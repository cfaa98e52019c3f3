"""The reader finds exactly those that a look at everybody finds, in a town much larger than its reach."""

from pathlib import Path
from types import SimpleNamespace

import libsumo
import numpy as np
import pytest

from tests.bridge.sumo.grid_town import make_grid_town
from wcsim.bridge.sumo.actors import ActorReader
from wcsim.core import frames
from wcsim.types import F64

RADIUS_M = 40.0


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_grid_town(tmp_path_factory.mktemp("reader") / "big", blocks=3, vehicles=120, people=160)


@pytest.fixture
def running(town):
    libsumo.start(["sumo", "-c", str(town / "big.sumocfg"), "--no-warnings", "true", "--no-step-log", "true"])
    yield ActorReader(libsumo, (0.0, 0.0, 0.0), 0.1)
    libsumo.close()


def step(reader: ActorReader, unsure: bool = False) -> None:
    libsumo.simulationStep()
    simulation = libsumo.simulation
    jumped = bool(simulation.getStartingTeleportIDList() or simulation.getEndingTeleportIDList())
    reader.stepped(simulation.getDepartedIDList(), simulation.getDepartedPersonIDList(), unsure or jumped)


def everybody_near(points_m: F64) -> list[str]:
    found = []
    for kind, domain in (("p:", libsumo.person), ("v:", libsumo.vehicle)):
        for name in domain.getIDList():
            x, y, _ = domain.getPosition3D(name)
            if min(np.hypot(*(points_m - (x, y)).T)) <= RADIUS_M:
                found.append(kind + name)
    return sorted(found)


def names(reader: ActorReader, points_m: F64) -> list[str]:
    return [actor.id for actor in reader.near(points_m, RADIUS_M)]


def test_it_finds_everybody_near_chairs_that_drive_and_jump(running):
    rng = np.random.default_rng(4)
    points_m = rng.uniform(0.0, 600.0, (2, 2))
    seen = set()
    for tick in range(300):
        step(running)
        points_m = points_m + rng.uniform(-0.2, 0.2, (2, 2))
        if tick % 12 == 11:
            points_m = points_m.copy()
            points_m[tick % 2] = rng.uniform(0.0, 600.0, 2)  # a chair begins its next episode elsewhere
        found = names(running, points_m)
        assert found == everybody_near(points_m), tick
        seen.update(found)
    assert len(seen) > 60


def test_a_question_about_another_place_changes_nothing(running):
    here, there = np.array([[200.0, 200.0]]), np.array([[400.0, 410.0]])
    for tick in range(60):
        step(running)
        assert names(running, here) == everybody_near(here)
        assert [actor.id for actor in running.at(there, RADIUS_M)] == everybody_near(there), tick
        assert names(running, here) == everybody_near(here)


def test_who_jumps_into_reach_is_seen_at_once_when_the_session_says_so(running):
    for _ in range(30):
        step(running)
    name, lane, target = max((_far_ahead(name) for name in libsumo.vehicle.getIDList()), key=_way_there_m)
    step(running)
    assert f"v:{name}" not in names(running, target)
    libsumo.vehicle.moveTo(name, lane, 6.0)
    step(running, unsure=True)
    assert f"v:{name}" in names(running, target)
    assert names(running, target) == everybody_near(target)


@pytest.mark.parametrize("length_m", [7.0, 12.0, 18.0, 26.0])
def test_who_drives_away_is_there_until_the_rear_is_out_of_reach(running, length_m):
    libsumo.simulationStep()
    (name, *_) = libsumo.simulation.getDepartedIDList()
    libsumo.vehicle.setLength(name, length_m)
    running.stepped(libsumo.simulation.getDepartedIDList(), libsumo.simulation.getDepartedPersonIDList(), unsure=False)
    front, yaw_rad = np.array(libsumo.vehicle.getPosition(name)), frames.yaw_from_sumo(libsumo.vehicle.getAngle(name))
    rear = front - length_m * np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    behind = rear - (RADIUS_M - 1.0) * np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    assert f"v:{name}" in names(running, behind[None])
    assert f"v:{name}" in [actor.id for actor in running.at(behind[None], RADIUS_M)]


def _far_ahead(name: str) -> tuple[str, str, F64]:
    """A vehicle, the first metres of the last street on its way, and where that is."""
    lane = libsumo.vehicle.getRoute(name)[-1] + "_1"
    return name, lane, np.array([libsumo.lane.getShape(lane)[0][:2]])


def _way_there_m(found: tuple[str, str, F64]) -> float:
    return float(np.hypot(*(found[2][0] - libsumo.vehicle.getPosition(found[0]))))


def test_who_is_taken_out_between_two_looks_is_gone(running):
    everywhere = np.array([[300.0, 300.0]])
    for _ in range(10):
        step(running)
    before = running.at(everywhere, 1e9)
    gone = next(actor.id for actor in before if actor.id.startswith("v:"))
    libsumo.vehicle.remove(gone[2:])
    running.forget_actor(gone)
    assert gone not in [actor.id for actor in running.at(everywhere, 1e9)]


def test_poses_are_those_of_frames(running):
    for _ in range(20):
        step(running)
    for actor in running.at(np.array([[300.0, 300.0]]), 1e9):
        domain = libsumo.person if actor.id.startswith("p:") else libsumo.vehicle
        front = np.array(domain.getPosition3D(actor.id[2:]))
        yaw = frames.yaw_from_sumo(domain.getAngle(actor.id[2:]))
        centre = frames.front_from_centre(front, yaw, actor.pitch_rad, -actor.size_lwh_m[0])
        assert actor.p_W_m == pytest.approx(centre, abs=1e-9)


def test_who_has_no_place_for_a_while_is_not_there_and_comes_back():
    places = {"a": (1.0, 2.0, 0.0), "b": (-(2.0**30), -(2.0**30))}  # as SUMO says of who is nowhere
    people = SimpleNamespace(getIDList=lambda: list(places), getPosition3D=places.get, getVehicle=lambda name: "")
    for method in ("getAngle", "getSpeed", "getLength", "getWidth", "getHeight", "getVehicleClass"):
        known = "pedestrian" if method == "getVehicleClass" else 0.5
        setattr(people, method, lambda name, known=known: known)
    nobody = SimpleNamespace(getIDList=list, getPosition3D=None)
    reader = ActorReader(SimpleNamespace(person=people, vehicle=nobody, TraCIException=RuntimeError), (0, 0, 0), 0.1)
    seen = []
    for here in (places["b"], places["b"], (3.0, 2.0, 0.0)):
        places["b"] = here
        reader.stepped((), (), unsure=False)
        seen.append((names(reader, np.zeros((1, 2))), [actor.id for actor in reader.at(np.zeros((1, 2)), np.inf)]))
    assert seen == [(["p:a"], ["p:a"])] * 2 + [(["p:a", "p:b"], ["p:a", "p:b"])]
