"""A wheel that falls off a kerb: on its own samples, on kerbs and ramps that a chair drives over, and in the world."""

import math

import numpy as np
import pytest

from tests.physics.rig import FORWARD, mesh, rig, step_street
from tests.support.samples import strip_street
from tests.support.worlds import open_world, push
from wcsim.config import resolve
from wcsim.physics.wheelchair.wheel_track import SAMPLE_S, fell
from wcsim.supervisor.rewards import _crash_term
from wcsim.towns.street import load_street
from wcsim.types import ClassId, Joystick, SeatSpec, StartSpec, StreetGrid, WayKind

STREET = strip_street()
BACK = Joystick(0.0, -1.0)
KERB_X_M = 3.0  # of `step_street`
BASE_M = 1.5  # the raster knows no heights below 0
BOTH_PLANTS = pytest.mark.parametrize("plant", ["rwd", "mwd"])


def raster(height_m) -> StreetGrid:
    """The ground of a street whose height depends on x."""
    x_m = -20.0 + 0.1 * (np.arange(600) + 0.5)
    row_cm = np.round(100.0 * (BASE_M + np.vectorize(height_m)(x_m))).astype(np.uint8)
    shape = (300, 600)
    return StreetGrid(
        origin_W_m=(-20.0, -15.0),
        cell_m=0.1,
        height_cm=np.broadcast_to(row_cm, shape).copy(),
        ground_class=np.full(shape, ClassId.SIDEWALK, np.uint8),
        clearance_dm=np.full(shape, 255, np.uint8),
    )


def step_grid(rise_m) -> StreetGrid:
    return raster(lambda x: rise_m if x > KERB_X_M else 0.0)


def ramp_street(grade):
    """Level ground, a ramp down of 8 m, level ground again, with its raster."""
    foot, low = KERB_X_M + 8.0, -grade * 8.0
    line = [(-20.0, 0.0), (KERB_X_M, 0.0), (foot, low), (39.0, low)]
    vertices = [(x, y, z) for x, z in line for y in (-10.0, 10.0)]
    faces = [face for i in (0, 2, 4) for face in ([i, i + 2, i + 3], [i, i + 3, i + 1])]
    return mesh(vertices, faces, ClassId.SIDEWALK), raster(lambda x: -grade * min(max(x - KERB_X_M, 0.0), 8.0))


def driven(street, v_mps, plant="rwd"):
    return rig(street, plant=plant, v_max_mps=v_mps, reverse_share=1.0)


def drops(yard, ground, stick, ticks) -> bool:
    """Whether any tick of a drive holds a fall."""
    for _ in range(ticks):
        yard.drive(stick, 1)
        if fell(*yard.chair.wheel_track(), ground):
            return True
    return False


@BOTH_PLANTS
@pytest.mark.parametrize("v_mps", [0.4, 0.7, 1.2, 1.67])
@pytest.mark.parametrize(
    "yaw_rad, stick",
    [(0.0, FORWARD), (math.pi / 4, FORWARD), (math.pi, BACK)],
    ids=["forward", "diagonal", "backwards"],
)
def test_a_chair_that_drives_off_a_kerb_of_12_cm_falls(plant, v_mps, yaw_rad, stick):
    with driven(step_street(-0.12), v_mps, plant) as yard:
        yard.place(x=2.0 - 0.5 * v_mps, y=-2.0, yaw=yaw_rad)  # as far as it needs for its speed
        assert drops(yard, step_grid(-0.12), stick, round(10 * (4.5 / v_mps + 1.0)))


@BOTH_PLANTS
@pytest.mark.parametrize("rise_m", [-0.03, 0.03])
@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 4], ids=["square", "diagonal"])
def test_a_chair_takes_a_kerb_of_3_cm_up_and_down_and_its_bounce_is_no_fall(plant, rise_m, yaw_rad):
    with driven(step_street(rise_m), 1.67, plant) as yard:
        yard.place(x=-1.0, y=-3.0, yaw=yaw_rad)
        assert not drops(yard, step_grid(rise_m), FORWARD, 55)
        assert yard.chair.state().p_WB_m[0] > KERB_X_M


@BOTH_PLANTS
@pytest.mark.parametrize(
    "grade, v_mps, yaw_rad",
    [(1 / 12, 1.67, 0.0), (1 / 8, 1.67, 0.0), (1 / 8, 1.67, math.pi / 4), (1 / 12, 2.78, 0.0), (1 / 8, 2.78, 0.0)],
)
def test_a_ramp_is_no_fall_however_long_it_is(plant, grade, v_mps, yaw_rad):
    street, ground = ramp_street(grade)
    with driven(street, v_mps, plant) as yard:
        yard.place(x=0.0 if yaw_rad else -3.0, y=-5.0, yaw=yaw_rad)
        assert not drops(yard, ground, FORWARD, 60)
        assert yard.chair.state().p_WB_m[2] < -0.15


@BOTH_PLANTS
@pytest.mark.parametrize(
    "x_m, y_m, yaw_deg, v_mps, falls",
    [
        (40.0, 6.0, -90.0, 1.67, False),  # down the middle of a lowered kerb
        (37.0, 6.0, -60.0, 1.67, False),  # over the ramp at its side, which twists under the chair
        (32.0, 5.0, 0.0, 1.67, False),  # along the pavement, over both ramps
        (37.6, 6.0, -90.0, 1.2, False),  # over the foot of the ramp's side, 2 to 5 cm high
        (36.0, 6.0, -90.0, 1.2, True),  # beside the ramp
        (43.1, 6.0, -90.0, 1.2, True),  # over its top, 9 cm high
    ],
)
def test_a_lowered_kerb_with_ramps_at_its_sides(plant, x_m, y_m, yaw_deg, v_mps, falls):
    with driven(STREET.mesh, v_mps, plant) as yard:
        yard.place(x_m, y_m, float(STREET.grid.height_at(np.array([x_m, y_m]))), math.radians(yaw_deg))
        assert drops(yard, STREET.grid, FORWARD, 60 if yaw_deg == 0.0 else 35) == falls


def sinking(depth_m, speed_mps, seconds, ground_m):
    """Samples of one wheel that goes evenly down over the edge of a kerb, and the ground under it."""
    steps = round(seconds / SAMPLE_S)
    share = np.clip((np.arange(steps + 20) - 10) / steps, 0.0, 1.0)
    x_m = KERB_X_M - 0.02 + share
    p_W_m = np.stack([x_m, np.zeros_like(x_m), 0.178 - depth_m * share], axis=1)[:, None]
    return p_W_m, np.full(len(x_m), speed_mps), step_grid(ground_m)


@pytest.mark.parametrize(
    "depth_m, speed_mps, seconds, ground_m, falls",
    [
        (0.12, 1.0, 0.3, -0.12, True),
        (0.051, 1.0, 0.3, -0.06, True),
        (0.049, 1.0, 0.3, -0.12, False),  # a wheel takes that
        (0.12, 0.31, 0.3, -0.12, True),
        (0.12, 0.29, 0.3, -0.12, False),  # slow
        (0.12, 1.0, 1.0, -0.12, False),  # let down
        (0.12, 1.0, 0.3, -0.05, False),  # what the ground does not explain
    ],
)
def test_both_ends_of_every_limit(depth_m, speed_mps, seconds, ground_m, falls):
    assert fell(*sinking(depth_m, speed_mps, seconds, ground_m)) == falls


def test_no_samples_are_no_fall():
    assert not fell(np.zeros((0, 4, 3)), np.zeros(0), STREET.grid)


def test_where_a_chair_is_put_is_no_way_that_it_fell():
    with driven(step_street(-0.12), 1.0) as yard:
        yard.place(x=1.0)
        yard.drive(FORWARD, 10)
        yard.place(x=6.0, z=-0.12)
        assert not drops(yard, step_grid(-0.12), FORWARD, 10)
        positions, speeds = yard.chair.wheel_track()
        assert positions.shape == (20, 4, 3) and speeds.shape == (20,)
        assert positions[:, :, 0].min() > 5.5


def kerb_of(street):
    """A place on a pavement 1.5 m from the carriageway, and the direction to it: nowhere near a crossing."""
    crossings = [e.points_W_m for e in street.walk.edges if e.kind is WayKind.CROSSING]
    for edge in street.walk.edges:
        if edge.kind is not WayKind.SIDEWALK:
            continue
        middle = 0.5 * (edge.points_W_m[0] + edge.points_W_m[-1])
        if crossings and min(float(np.hypot(*(p - middle).T).min()) for p in crossings) < 6.0:
            continue
        for yaw_rad in np.arange(8) * math.pi / 4:
            way = middle + np.array([[math.cos(yaw_rad), math.sin(yaw_rad)]]) * np.arange(0.0, 4.0, 0.1)[:, None]
            raised_m = street.grid.raised_at(way)
            on_road = (street.grid.class_at(way[-5:]) == ClassId.ROAD).all()
            if raised_m[0] > 0.1 and raised_m[-1] == 0.0 and on_road:
                return middle, float(yaw_rad)
    raise AssertionError("no kerb found")


@pytest.mark.parametrize("counts", [True, False])
def test_in_the_world_a_fall_ends_the_episode_where_it_is_set(corner, corner_town, counts):
    (x, y), yaw_rad = kerb_of(load_street(corner_town))
    goal = (x - 20.0 * math.cos(yaw_rad), y - 20.0 * math.sin(yaw_rad))
    spec = SeatSpec(start=StartSpec(p_W_m=(x, y), yaw_rad=yaw_rad, goal_W_m=goal))
    with open_world(corner, f"reward.drop={str(counts).lower()}", "world.demand_scale=0", spec=spec) as world:
        for _ in range(80):
            client = push(world, Joystick(0.0, 0.5))
            if client.events.crashed:
                break
        assert (client.events.crash_reason == "drop") == counts
        assert not counts or _crash_term(client.events.crashed, world.config.reward) == -100.0


def test_the_setting_is_on_but_in_preset_paper():
    assert resolve("quick").reward.drop
    assert not resolve("paper").reward.drop
