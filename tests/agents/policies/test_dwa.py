"""The dynamic-window baseline: what it takes for an obstacle, what it does about it, what it remembers."""

import math
from functools import cache

import numpy as np
import pytest

from tests.agents.driven import driven
from tests.agents.policies.test_baselines import WALL, box, drop, ground, looking_at, ramp
from tests.support.samples import ACTIONS
from tests.support.yardstick import multiple
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.agents.perception.arcs import (
    find_collision_free_commands,
    integrate_drive_motion,
    measure_obstacle_gaps,
    time_to_contact_s,
)
from wcsim.agents.perception.depth_image import CameraView
from wcsim.agents.perception.street_memory import KEEP_BRIEFLY_S, StepObstacleDetector
from wcsim.agents.perception.surroundings import _up_in_body
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.policies.dwa import _caution
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.config import CameraConfig, ChairConfig, RunConfig, resolve
from wcsim.core.joystick import drive_limits_from_chair
from wcsim.errors import PolicyError
from wcsim.physics.wheelchair.drive_controller import stopping_distance_m
from wcsim.supervisor.observation import decode_depth

CAMERA = CameraConfig(width_px=96, height_px=72)
CONFIG = RunConfig(cameras=(CAMERA,))
POINTS = ACTIONS.points
CHAIR = np.array([-0.34, 0.80, 0.31])
LIMITS = drive_limits_from_chair(ChairConfig())
AHEAD = np.array([0.0, 1.0], np.float32)


@cache
def view_of(surface):
    """The observation of a surface, of each one once."""
    return looking_at(surface, camera=CAMERA)


def obstacles(surface):
    """What the step map says of a surface, (n, 2)."""
    seen, view = view_of(surface), CameraView(CAMERA)
    view.observe(seen)
    return StepObstacleDetector().obstacles([view], _up_in_body(seen["imu"]), CHAIR).copy()


def dwa(name="dwa"):
    return make_baseline_policy(name, CONFIG)


def drive(surface, ticks, stick=AHEAD, driver=None):
    """Joystick positions that the baseline chooses while it is shown the same picture again and again."""
    driver = driver or dwa()
    view = {**view_of(surface), "joystick": np.asarray(stick, np.float32)}
    return [tuple(POINTS[driver.act(view)]) for _ in range(ticks)]


@pytest.mark.parametrize(
    "name, surface, at_m",
    [
        ("level ground", ground, None),
        ("a step that casters climb", box(1.8, 9.0, -5, 5, 0, 0.04), None),
        ("a ramp up 1:8", ramp(1.0, 8, 0.3), None),
        ("a ramp down 1:8", ramp(1.0, 8, -0.3), None),
        ("a hill of 8 degrees beside a level chair", lambda x, y, z: z <= 0.14 * y, None),
        ("a branch above", box(1.6, 2.2, -1, 1, 1.8, 1.9), None),
        ("a wall", WALL, 2.0),
        ("a kerb up", box(1.8, 9.0, -5, 5, 0, 0.12), 1.8),
        ("a kerb down", drop(1.8, 0.12), 1.8),
        ("a kerb up under the nose", box(0.9, 9.0, -5, 5, 0, 0.12), 1.0),
        ("a kerb down under the nose", drop(0.9, 0.12), 1.0),
        ("a ramp up 1:8 under the nose", ramp(0.5, 8, 0.3), None),
        ("a lowered kerb under the nose", box(0.9, 9.0, -5, 5, 0, 0.03), None),
        ("a bench", box(1.6, 2.0, -1, 1, 0.4, 0.5), 1.6),
        ("steps down", drop(1.7, 0.6), 1.7),
        ("a platform's edge", drop(1.8, 20.0), 1.8),
    ],
)
def test_what_is_an_obstacle_and_where(name, surface, at_m):
    found = obstacles(surface)
    before = found[np.abs(found[:, 1]) < 0.5]  # straight ahead
    if at_m is None:
        assert len(before) == 0, name
    else:
        assert before[:, 0].min() == pytest.approx(at_m, abs=0.16), name


def test_a_kerb_beside_the_way_is_seen_along_its_length():
    found = obstacles(lambda x, y, z: z <= np.where(y < 0.8, 0.0, -0.12))
    near = found[found[:, 0] < 3.0]
    assert len(near) > 10
    assert np.abs(near[:, 1] - 0.8).max() < 0.16
    assert np.ptp(near[:, 0]) > 1.2


def test_what_was_not_measured_is_nothing():
    view = CameraView(CAMERA)
    for depth in (0.0, CAMERA.range_m):
        view.depth_m = np.full(len(view.rays), depth, np.float32)
        found = StepObstacleDetector().obstacles([view], np.array([0.0, 0.0, 1.0]), CHAIR)
        assert (found[:, 0] < 4.0).sum() == 0 or depth > 0.0  # far below the horizon, no ground is a drop


def test_on_a_free_way_the_user_decides():
    rng = np.random.default_rng(1)
    driver = dwa()
    view = view_of(ground)
    for stick in rng.uniform(-0.7, 0.7, (40, 2)):
        assert driver.act({**view, "joystick": stick}) == ACTIONS.nearest(stick)


def test_it_stops_before_a_wall_and_keeps_turning():
    wall = box(0.95, 3.0, -3, 3, 0, 3)
    assert max(y for _, y in drive(wall, 3)) < 0.5
    assert drive(wall, 1, (0.75, 0.0)) == [(0.75, 0.0)]
    assert drive(wall, 1, (0.0, -0.5)) == [(0.0, -0.5)]


def test_it_slows_down_the_later_the_farther_the_wall():
    driver = dwa()
    drive(ground, 25, driver=driver)  # at full speed
    near, far = WALL, box(3.9, 4.5, -3, 3, 0, 3)
    assert drive(far, 1, driver=driver) == [(0.0, 1.0)]
    ((_, y),) = drive(near, 1, driver=driver)
    assert y <= 0.5


def test_it_steers_past_a_post():
    post = box(2.0, 2.1, 0.20, 0.30, 0, 1.2)
    driver = dwa()
    drive(ground, 15, driver=driver)
    ((x, y),) = drive(post, 1, driver=driver)
    assert x > 0.0 and y > 0.4  # to the right of it, and on


def test_what_it_saw_once_is_forgotten_in_seconds_and_what_it_saw_for_longer_is_not():
    beside = box(0.9, 1.6, 0.45, 1.2, 0, 0.5)
    left, seconds = (-0.75, 0.5), round(KEEP_BRIEFLY_S / 0.1) + 1
    for looks, forgotten in ((1, True), (3, False)):
        driver = dwa()
        drive(beside, looks, (0.0, 0.0), driver)
        assert drive(ground, 1, left, driver) != [left], "it is too near to be seen, but it was seen"
        drive(ground, seconds, (0.0, 0.0), driver)
        assert (drive(ground, 1, left, driver) == [left]) is forgotten
        driver.reset()
        assert drive(ground, 1, left, driver) == [left]


def test_what_it_remembers_moves_as_the_chair_does():
    driver = dwa()
    drive(box(2.2, 2.4, -0.1, 0.1, 0, 1.0), 1, (0.0, 0.0), driver)
    before = driver.around.memory.points_B_m(np.zeros(3), 0.0).copy()
    after = driver.around.memory.points_B_m(np.array([0.5, 0.0, 0.3]), 0.5)
    cos, sin = math.cos(0.3), math.sin(0.3)
    assert np.allclose(after, (before - [0.5, 0.0]) @ np.array([[cos, -sin], [sin, cos]]))
    assert np.arctan2(*after.mean(axis=0)[::-1]) < 0.0  # turned to the left, it lies to the right


def test_reckoned_braking_takes_the_way_that_the_drive_takes():
    motion, way_m = np.array([1.67, 0.0, 0.0]), 0.0
    while motion[0] > 0.0:
        before = motion[0]
        integrate_drive_motion(motion, np.zeros(2), LIMITS, 0.02)
        way_m += 0.01 * (before + motion[0])
    assert way_m == pytest.approx(stopping_distance_m(1.67, 1.5, 4.0), abs=0.12)


def from_rest(speed_mps=0.0):
    return np.array([0.0, 0.0, 0.0, speed_mps, 0.0, 0.0])


def free_of(commands, *points, speed_mps=0.0, later_s=0.0):
    """Which commands are free of points (x, y, vx, vy, distance to keep), and how near they come to them."""
    gap_m = np.empty(len(commands))
    rows = np.array(points).reshape(-1, 5)
    free = find_collision_free_commands(
        from_rest(speed_mps), later_s, 0.5, np.array(commands), LIMITS, CHAIR, rows, gap_m
    )
    return free.tolist(), gap_m


def test_arcs_touch_what_they_sweep_over():
    commands, post = [(0.0, 1.0), (0.0, 0.0), (0.0, -1.0)], (2.0, 0.0, 0.0, 0.0, 0.07)
    free, gap_m = free_of(commands, post, speed_mps=1.2)
    assert free == [False, True, True] and 0.07 < gap_m[1] <= gap_m[2]
    free, gap_m = free_of(commands)
    assert free == [True] * 3 and np.isinf(gap_m).all()
    assert not free_of(commands, (2.0, 0.0, 0.0, 0.0, 0.59), speed_mps=1.2)[0][1]  # nearer than should be kept


def test_arcs_meet_those_who_move_where_they_will_be():
    ahead = [(0.0, 1.0)]

    def is_free(*who, later_s=0.0):
        return free_of(ahead, (*who, 0.07), speed_mps=1.2, later_s=later_s)[0][0]

    assert is_free(3.2, 0.0, 0.0, 0.0)  # who stands there is far enough
    assert not is_free(3.2, 0.0, -1.4, 0.0)  # who comes is not
    assert not is_free(1.6, 1.3, 0.0, -1.2) and is_free(1.6, 1.3, 0.0, 1.2)  # who crosses, who leaves
    assert is_free(3.9, 0.0, -0.4, 0.0) and not is_free(3.9, 0.0, -0.4, 0.0, later_s=1.0)  # nearer by then


def test_what_is_inside_the_chair_may_leave_it_and_get_no_deeper():
    inside, post = (0.7, 0.0, 0.0, 0.0, 0.07), (1.05, 0.0, 0.0, 0.0, 0.07)
    assert measure_obstacle_gaps(from_rest(), 0.0, CHAIR, np.array([inside])) == pytest.approx([-0.1])
    commands = [(0.0, 0.5), (0.0, 0.0), (0.0, -0.5)]
    assert free_of(commands, inside)[0] == [False, True, True]
    assert free_of(commands, (0.2, 0.0, 0.0, 0.0, 0.07), post)[0] == [False, True, True]  # nor does it excuse others
    driver = dwa()
    drive(ground, 20, driver=driver)
    assert max(y for _, y in drive(box(0.71, 3.0, -3, 3, 0, 3), 2, driver=driver)) <= 0.0


def test_a_held_stick_meets_a_wall_when_the_chair_gets_there():
    wall, ahead = np.array([[3.0, 0.0, 0.0, 0.0, 0.07]]), np.array([0.0, 1.0])

    def meets_s(within_s, later_s=0.0):
        return time_to_contact_s(from_rest(1.67), later_s, ahead, LIMITS, CHAIR, wall, 0.0, within_s)

    assert meets_s(3.0) == pytest.approx((3.0 - CHAIR[1]) / 1.67, abs=0.1)
    assert math.isinf(meets_s(1.0))
    assert meets_s(3.0, later_s=0.4) == pytest.approx(meets_s(3.0) + 0.4)


def test_what_is_near_already_is_met_only_by_a_stick_that_brings_it_nearer():
    points = np.array([[0.82, 0.0, 0.0, 0.0, 0.07], [0.78, 0.1, 0.0, 0.0, 0.07], [0.3, 0.33, 0.0, 0.0, 0.07]])

    def meets_s(stick, rows=points):
        return time_to_contact_s(from_rest(), 0.2, np.array(stick), LIMITS, CHAIR, rows, 0.03, 2.0)

    assert math.isinf(meets_s((0.0, 0.0))) and math.isinf(meets_s((0.0, -0.5)))
    assert meets_s((0.0, 0.5)) < 1.0
    beside = np.array([[0.3, 0.33, 0.0, 0.0, 0.07]])
    assert math.isinf(meets_s((0.0, 0.5), beside)), "a wall along which it drives"
    comes = np.array([[0.82, 0.0, -0.5, 0.0, 0.07]])
    assert meets_s((0.0, 0.0), comes) < 1.0, "who comes nearer is met at rest, too"


def test_it_warns_of_what_the_users_stick_would_meet_and_not_for_nothing():
    wall, driver = box(2.5, 3.0, -3, 3, 0, 3), dwa()
    drive(ground, 20, driver=driver)
    told = []
    for ahead in (True, False, False, True, True, True, True, False, False, False):
        drive(wall, 1, AHEAD if ahead else (0.0, -1.0), driver)
        told.append(driver.warning)
    assert told == [False, False, False, False, True, True, True, True, False, False]
    drive(wall, 2, driver=driver)
    assert driver.warning
    driver.reset()
    assert not driver.warning


def test_backwards_it_goes_where_it_has_been_and_hardly_farther():
    back = (0.0, -0.75)
    driver = dwa()
    assert drive(ground, 5, back, driver)[-1][1] > -0.75, "it has never looked behind itself"
    driver.reset()
    drive(ground, 30, driver=driver)
    drive(ground, 20, (0.0, 0.0), driver)
    assert drive(ground, 1, back, driver) == [back]


def test_with_a_rear_camera_it_backs_up_as_far_as_the_ground_goes():
    back, config = (0.0, -1.0), resolve(CONFIG, 'env.camera=["front","rear"]')
    for surface, backs in ((ground, True), (lambda x, y, z: z <= np.where(x < -0.6, -0.12, 0.0), False)):
        rear = looking_at(surface, camera=config.eyes["rear_"])
        view = {**view_of(ground), "rear_depth": rear["depth"], "rear_seg": rear["seg"]}
        driver = make_baseline_policy("dwa", config)
        seen = [tuple(POINTS[driver.act({**view, "joystick": np.array(back, np.float32)})]) for _ in range(12)]
        assert (seen[-1] == back) == backs, surface


def test_a_wall_goes_on_beside_the_chair_where_it_does_not_look():
    along = box(-2.0, 6.0, -1.2, -0.5, 0, 1.5)
    ahead_only = box(1.0, 1.4, -1.2, -0.5, 0, 1.5)
    turn = (0.75, 0.0)
    assert drive(along, 4, turn) != [turn] * 4, "the footplate swings into it"
    assert drive(ahead_only, 4, turn) == [turn] * 4


def test_levels_keep_wider_and_earlier_from_what_is_in_the_way():
    cautions = [_caution(level) for level in (0.0, 0.5, 1.0, 1.5, 2.0)]
    for key in ("hold_s", "margin_m", "comfort_m"):
        values = [getattr(one, key) for one in cautions]
        assert values == sorted(values) and len(set(values)) == len(values)
    wall = box(2.6, 3.5, -3, 3, 0, 3)
    chosen = []
    for name in ("dwa@0", "dwa", "dwa@2"):
        driver = dwa(name)
        assert driver.name == name
        drive(ground, 20, driver=driver)
        chosen.append(drive(wall, 1, driver=driver)[0][1])
    assert chosen[0] > chosen[2] and chosen == sorted(chosen, reverse=True)
    assert drive(wall, 5, driver=dwa("dwa@1")) == drive(wall, 5)


@pytest.mark.parametrize("name", ["dwa@", "dwa@-0.1", "dwa@2.01", "dwa@nan", "dwa@much"])
def test_a_level_that_there_is_not_is_refused(name):
    with pytest.raises(PolicyError, match="from 0 to 2"):
        parse_policy_name(name)
    with pytest.raises(PolicyError, match="from 0 to 2"):
        dwa(name)
    assert parse_policy_name("follow@1").kind != "baseline"


def test_both_forms_of_observation_give_the_same_choice():
    view = view_of(box(1.9, 3.0, -0.3, 3, 0, 3))
    depth = decode_depth(view["depth"], CAMERA.range_m) / np.float32(CAMERA.range_m)
    floats = {**view, "depth": depth.astype(np.float32), "joystick": AHEAD}
    assert dwa().act(floats) == dwa().act({**view, "joystick": AHEAD})


def test_a_decision_is_quick():
    config = RunConfig(cameras=(CameraConfig(),), chair=ChairConfig())
    driver = make_baseline_policy("dwa", config)
    coarse = view_of(box(1.5, 3.0, -3, 0.2, 0, 3))
    large = {key: np.kron(coarse[key], np.ones((4, 4), np.uint8))[:, :240, :320] for key in ("depth", "seg")}
    view = {**coarse, **large, "joystick": AHEAD}
    assert multiple(lambda: driver.act(view)) < 25  # about 5


@pytest.mark.proof
def test_in_traffic_it_crashes_less_than_the_user_alone_and_hardly_disobeys():
    config = resolve("quick", ("env.profile=inattentive", "env.truth=true", "env.max_steps=600"))
    env = WheelchairEnv("monaco", config=config)
    try:
        rows = [
            driven(make_baseline_policy(name, config), env, 20, 600, seed=11) for name in ("follow", "dwa", "oracle")
        ]
    finally:
        env.close()
    alone, helped, bound = rows
    assert alone.crashes_own >= 3, "nothing to help with"
    assert helped.crashes_own <= 0.6 * alone.crashes_own and bound.crashes_own <= 0.6 * alone.crashes_own
    assert helped.followed > 0.85
    assert helped.speed_mps > 0.8 * alone.speed_mps
