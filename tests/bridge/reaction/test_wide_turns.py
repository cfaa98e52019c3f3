"""Long vehicles take bends wide: off the pavement where there is room, at SUMO's own places everywhere else."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.bridge.reaction.corners import LONGEST, TOUCH_M2, corners_of, sweep
from tests.bridge.reaction.roads import actor
from wcsim.bridge.mirror import _check_mirror
from wcsim.bridge.reaction.swept_path import LaneShape, OnLane
from wcsim.bridge.reaction.wide_turns import (
    ASIDE_SHARE,
    MOST_M,
    SIDE_STEP_M,
    STEP_M,
    SwingOut,
    _covered_m2,
    _normals,
    _offsets_m,
)
from wcsim.core import frames
from wcsim.errors import PhysicsError
from wcsim.physics.engine import Engine
from wcsim.physics.kinematic_bodies import BodyPool
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import build_scene, list_scenes
from wcsim.towns.street import load_street
from wcsim.towns.sumo.net import read_net
from wcsim.types import ActorKind, ClassId, StreetGrid

BUS_M = (12.0, 2.55)
TICK_S = 0.1
RADIUS_M = 9.0
NONE_M = np.zeros(0)


def bend(at_m: np.ndarray) -> np.ndarray:
    """Where the middle of a lane is: 60 m east along y = 0, a right turn of 9 m radius, then south."""
    angle = np.clip((at_m - 60.0) / RADIUS_M, 0.0, 0.5 * math.pi)
    beyond = np.maximum(at_m - 60.0 - 0.5 * math.pi * RADIUS_M, 0.0)
    x = np.minimum(at_m, 60.0) + RADIUS_M * np.sin(angle)
    return np.stack([x, -RADIUS_M * (1.0 - np.cos(angle)) - beyond], axis=1)


LINE_M = bend(np.arange(0.0, 130.0, STEP_M))


def corner_ground(free_m: float) -> StreetGrid:
    """Pavement but for a street round the bend, from 1.6 m right of the line to `free_m` left of it."""
    x, y = np.meshgrid(np.arange(-20.0, 120.0, 0.1), np.arange(-100.0, 20.0, 0.1))
    east, south = (
        (y > -1.6) & (y < free_m) & (x < 60.0 + RADIUS_M + free_m),
        (x > 60.0 + RADIUS_M - 1.6) & (x < 60.0 + RADIUS_M + free_m) & (y < free_m),
    )
    around = (x > 60.0) & (y > -RADIUS_M) & (np.hypot(x - 60.0, y + RADIUS_M) > RADIUS_M - 1.6)
    around &= (x < 60.0 + RADIUS_M + free_m) & (y < free_m)
    classes = np.where(east | south | around, int(ClassId.ROAD), int(ClassId.SIDEWALK)).astype(np.uint8)
    nothing = np.zeros_like(classes)
    return StreetGrid(
        origin_W_m=(-20.0, -100.0), cell_m=0.1, height_cm=nothing, ground_class=classes, clearance_dm=nothing + 255
    )


class Bend:
    """Roads of one lane round the bend, with one vehicle on it."""

    def __init__(self) -> None:
        self.front_m: float | None = 0.0

    def on_lane(self, actor_id):
        return None if self.front_m is None else OnLane(lane_id="E_0", along_m=self.front_m, left_m=0.0)

    def lanes_ahead(self, actor_id, ahead_m):
        return ("E_0",)

    def lane(self, lane_id):
        return LaneShape(id="E_0", edge_id="E", index=0, points_W_m=LINE_M, length_m=129.5, width_m=3.2, internal=False)

    def bus(self, front_m: float, speed_mps: float = 5.0, kind=ActorKind.BUS):
        """As SUMO shows it: front and rear on the line."""
        self.front_m = front_m
        front, rear = bend(np.array([front_m, front_m - BUS_M[0]]))
        yaw = math.atan2(front[1] - rear[1], front[0] - rear[0])
        bus = actor(kind, yaw=yaw, speed=speed_mps, size=(*BUS_M, 3.2), name="v:bus")
        return replace(bus, p_W_m=frames.front_from_centre(np.array([*front, 0.0]), yaw, 0.0, -BUS_M[0]))


def test_a_bus_that_has_room_keeps_off_the_pavement():
    ground = corner_ground(free_m=8.0)
    before = _covered_m2(LINE_M, BUS_M, ground)
    found = _offsets_m(LINE_M, BUS_M, ground, NONE_M)
    after = _covered_m2(LINE_M + found[:, None] * _normals(LINE_M), BUS_M, ground)
    assert before.max() > 3.0, "as SUMO leads it, it cuts the corner"
    assert after.max() < TOUCH_M2
    assert found.max() > 0.5 and found.min() > -0.5, "outwards"
    assert np.abs(np.diff(found)).max() <= SIDE_STEP_M + 1e-9 and np.abs(found).max() <= MOST_M


def test_where_it_is_too_narrow_it_covers_less_and_on_a_wide_road_nothing_moves():
    narrow = corner_ground(free_m=1.6)
    found = _offsets_m(LINE_M, BUS_M, narrow, NONE_M)
    before = _covered_m2(LINE_M, BUS_M, narrow).sum()
    after = _covered_m2(LINE_M + found[:, None] * _normals(LINE_M), BUS_M, narrow).sum()
    assert 0.0 < after < 0.9 * before
    straight = np.stack([np.arange(0.0, 60.0, STEP_M), np.zeros(120)], axis=1)
    assert not _offsets_m(straight, BUS_M, narrow, NONE_M).any()


def test_what_was_driven_is_not_laid_out_anew():
    ground = corner_ground(free_m=8.0)
    held = _offsets_m(LINE_M, BUS_M, ground, NONE_M)[:125] + 0.013
    found = _offsets_m(LINE_M, BUS_M, ground, held)
    assert np.array_equal(found[:125], held)
    assert np.abs(np.diff(found[124:])).max() < 2.0 * SIDE_STEP_M


def test_its_body_drives_as_its_velocity_says_and_never_jumps():
    roads, shown = Bend(), SwingOut(corner_ground(free_m=8.0), TICK_S)
    before, aside = None, []
    for front_m in np.arange(20.0, 110.0, 0.5):
        bare = roads.bus(front_m)
        (now,) = shown.shown((bare,), roads)
        if before is not None and now.deflect_m:
            assert now.p_W_m == pytest.approx(before.p_W_m + TICK_S * now.v_W_mps, abs=0.03)
            assert math.dist(now.p_W_m, before.p_W_m) < 2.0 * 0.5
            assert abs(frames.wrap_angle(now.yaw_rad - before.yaw_rad)) < 0.25
        assert abs(now.deflect_m) <= MOST_M
        assert now is bare or now.deflect_m
        before, aside = now, [*aside, now.deflect_m]
    assert max(aside) > 0.5 and aside[0] == aside[-1] == 0.0


def swung_out():
    """A bus in the middle of its bend."""
    roads, shown = Bend(), SwingOut(corner_ground(free_m=8.0), TICK_S)
    for front_m in np.arange(40.0, 66.0, 0.5):
        (now,) = shown.shown((roads.bus(front_m),), roads)
    return roads, shown, now


def test_it_stands_where_it_stopped_and_a_teleported_one_begins_anew():
    roads, shown, now = swung_out()
    stands = roads.bus(65.5, speed_mps=0.0)
    roads.front_m = None  # SUMO: stopped by its plan
    for _ in range(3):
        (still,) = shown.shown((stands,), roads)
        assert still.p_W_m == pytest.approx(now.p_W_m) and not still.v_W_mps.any() and still.deflect_m
    (far,) = shown.shown((roads.bus(20.0),), roads)
    assert far.deflect_m == 0.0
    assert math.hypot(*far.v_W_mps[:2]) == pytest.approx(5.0)


def test_one_that_changes_lanes_is_led_over_by_degrees():
    roads, shown, now = swung_out()
    shown._ground = corner_ground(free_m=30.0)
    roads.lane = lambda lane_id: replace(Bend().lane("E_0"), id="F_0", edge_id="F")
    roads.lanes_ahead = lambda actor_id, ahead_m: ("F_0",)
    bus = roads.bus(66.0)
    roads.on_lane = lambda actor_id: OnLane(lane_id="F_0", along_m=66.0, left_m=0.0)
    (after,) = shown.shown((bus,), roads)
    assert abs(after.deflect_m - now.deflect_m) < ASIDE_SHARE * 0.5 + 0.2


def test_rails_and_short_ones_stay_where_sumo_has_them():
    roads, shown = Bend(), SwingOut(corner_ground(free_m=8.0), TICK_S)
    tram, car = roads.bus(66.0, kind=ActorKind.TRAM), actor()
    assert shown.shown((tram, car), roads) == (tram, car)


def test_the_guard_stops_a_vehicle_that_is_shown_too_far_from_sumos_place():
    with Engine(1 / 240) as engine:
        pool = BodyPool(engine)
        with pytest.raises(PhysicsError, match=r"'v:bus' is mirrored 3\.200 m beside SUMO's place"):
            pool_and_check(pool, replace(actor(name="v:bus"), deflect_m=3.2))
        pool_and_check(pool, replace(actor(name="v:bus"), deflect_m=2.9))


def pool_and_check(pool: BodyPool, one) -> None:
    from wcsim.bridge import mirror

    pool.place(mirror.moves({}, (replace(one, v_W_mps=np.zeros(3)),), TICK_S))
    _check_mirror(pool, (one,))


def swept(found: Town, few: int = 1):
    """All long vehicles at the corners of a town: (vehicle, sweeps)."""
    ground, net = load_street(found).grid, read_net(found.net, found.file.origin_m)
    for vehicle in LONGEST:
        corners = list(corners_of(net, vehicle.vclass))
        yield vehicle, [sweep(corner, vehicle, ground) for corner in corners[::few]]


def test_at_some_corners_of_manhattan_long_vehicles_cover_a_third_less():
    for vehicle, sweeps in swept(find_town("manhattan"), 4):
        if sweeps:
            assert sum(one.after_m2 for one in sweeps) < 0.7 * sum(one.before_m2 for one in sweeps), vehicle.name


@pytest.mark.proof
@pytest.mark.parametrize("town", ["helsinki", "monaco", "manhattan"])
def test_at_all_corners_long_vehicles_cover_less(town):
    for vehicle, sweeps in swept(find_town(town)):
        before, after = (np.array([getattr(one, name) for one in sweeps]) for name in ("before_m2", "after_m2"))
        if not vehicle.swings:
            assert np.array_equal(before, after)
            continue
        assert after.sum() < 0.75 * before.sum(), vehicle.name
        assert (after > TOUCH_M2).sum() <= (before > TOUCH_M2).sum()
        assert (after > before + 1.0).mean() < 0.1, "the least over the whole bend may be more at one place of it"


@pytest.mark.proof
def test_at_the_corners_of_all_scenes_long_vehicles_cover_less(tmp_path):
    before = after = 0.0
    for folder in list_scenes():
        town, _ = build_scene(folder, tmp_path / folder.name)
        for vehicle, sweeps in swept(town):
            before += sum(one.before_m2 for one in sweeps)
            after += sum(one.after_m2 for one in sweeps)
            assert all(one.after_m2 <= one.before_m2 + 1.0 for one in sweeps), (folder.name, vehicle.name)
    assert after < 0.5 * before
