"""People do not go on as they go: what the oracle reckons with, and how its chair runs into them."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.supervisor.test_oracle import ACTIONS, FORWARD, ORACLE, STAY, STOP
from tests.support.samples import USUAL_OUTLINE
from tests.users.actors import walker
from tests.users.kinematics import TICK_S, Chair, plant
from wcsim.types import ActorState, Joystick

Y_M = 5.5  # the middle of the pavement
RADIUS_M, FRONT_M = 0.23, 0.8
TOUCH_M = 5.0 + FRONT_M + RADIUS_M
"""Where somebody stands who touches the front of a chair at 5 m."""
PERSON = replace(walker(0.0, 0.0), size_lwh_m=(0.26, 2.0 * RADIUS_M, 1.7))

Path = Callable[[float], tuple[float, float]]


def person(x: float, y: float, yaw: float, v: tuple[float, float] = (0.0, 0.0), aside_m: float = 0.0) -> ActorState:
    """Somebody with the speed (vx, vy)."""
    return replace(PERSON, p_W_m=np.array([x, y, 0.0]), yaw_rad=yaw, v_W_mps=np.array([*v, 0.0]), deflect_m=aside_m)


def gap_m(chair: Chair, x: float, y: float) -> float:
    """From the chair, which looks along x, to somebody round."""
    out_x = abs(x - chair.x - USUAL_OUTLINE.middle_x_m) - 0.5 * USUAL_OUTLINE.length_m
    return math.hypot(max(0.0, out_x), max(0.0, abs(y - chair.y) - 0.5 * USUAL_OUTLINE.width_m)) - RADIUS_M


def drive_late(chair: Chair, waiting: deque[Joystick], best, distances) -> None:
    """One tick of a chair that obeys late; it is given the best of the actions that is nearest to its wish."""
    waiting.append(Joystick(*ACTIONS.points[np.where(best, distances, np.inf).argmin()]))
    for _ in range(24):
        chair.drive(waiting[0], TICK_S / 24)
    waiting.popleft()


def met_at_mps(chair: Chair, *places: tuple[float, float, float]) -> float:
    """How fast the oracle's chair, which obeys two ticks late, is when its front touches somebody, else 0."""
    waiting, path = deque([FORWARD, FORWARD]), along(*places)
    for tick in range(round(8.0 / TICK_S)):
        (x0, y0), (x, y) = path((tick - 1) * TICK_S), path(tick * TICK_S)
        if gap_m(chair, x, y) <= 0.0:
            return chair.v if x > chair.x + FRONT_M else 0.0
        other = person(x, y, math.pi, ((x - x0) / TICK_S, (y - y0) / TICK_S), Y_M - y)
        said = ORACLE.assess(chair.plant(), FORWARD, (other,), tuple(waiting), accel_mps2=chair.a)
        distances = np.hypot(*(ACTIONS.points - (FORWARD.x, FORWARD.y)).T)
        straight = np.where(ACTIONS.points[:, 0] == 0.0, distances, 9.0)
        best = said.first_s == said.first_s[ACTIONS.points[:, 0] == 0.0].max()
        drive_late(chair, waiting, best, straight)
    return 0.0


def along(*places: tuple[float, float, float]) -> Path:
    """A way through (second, x, y) in straight lines."""

    def at(time_s: float) -> tuple[float, float]:
        for (t0, x0, y0), (t1, x1, y1) in pairwise(places):
            if time_s < t1:
                share = (time_s - t0) / (t1 - t0)
                return x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        return places[-1][1], places[-1][2]

    return at


@pytest.mark.parametrize("at_m", [1.6, 2.0, 2.4, 2.8, 3.2])
def test_who_has_stepped_aside_may_step_back(at_m):
    """Somebody comes, steps out of the chair's way, stands, and goes back to the own line."""
    chair = Chair(x=5.0, y=Y_M, v=1.1)
    far = TOUCH_M + at_m
    near, out_m = far - 1.3, Y_M + 0.8
    path = (-0.1, far + 0.13, Y_M - 0.08), (1.0, near, out_m), (1.1, near, out_m), (2.1, near, Y_M)
    assert met_at_mps(chair, *path) <= 0.05


@pytest.mark.parametrize("at_m", [1.4, 1.8, 2.2, 2.6])
def test_who_crosses_may_stop_in_the_way(at_m):
    chair = Chair(x=5.0, y=Y_M, v=1.1)
    x = TOUCH_M + at_m
    assert met_at_mps(chair, (-0.1, x, Y_M - 0.8), (0.7, x, Y_M), (9.0, x, Y_M)) <= 0.05


def test_who_ends_a_step_aside_walks_on_along_the_own_line():
    """Its velocity of the moment, half of it sideways, would lead it past; its heading leads it before the chair."""
    coming = person(TOUCH_M + 1.9, Y_M - 0.35, math.pi, (-1.3, -0.8))
    assert ORACLE.assess(plant(5.0, Y_M, 0.0, 1.3), Joystick(0.0, 1.0), (coming,)).danger
    away = replace(coming, p_W_m=np.array([coming.p_W_m[0], Y_M - 0.8, 0.0]))
    assert not ORACLE.assess(plant(5.0, Y_M, 0.0, 1.3), Joystick(0.0, 1.0), (away,)).danger


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("yaw", [0.0, math.pi])
def test_who_stands_aside_may_step_back_before_the_chair(yaw, side):
    """To the own line, that is, and no further."""
    aside_m = side * (0.5 * USUAL_OUTLINE.width_m + RADIUS_M + 0.15)
    there = person(TOUCH_M + 0.9, Y_M + aside_m, yaw)
    fast = plant(5.0, Y_M, 0.0, 1.3), Joystick(0.0, 0.8)
    left_m = aside_m * math.cos(yaw)
    assert not ORACLE.assess(*fast, (there,)).danger
    assert ORACLE.assess(*fast, (replace(there, deflect_m=left_m),)).danger
    assert not ORACLE.assess(*fast, (replace(there, deflect_m=0.1 * left_m),)).danger
    assert not ORACLE.assess(*fast, (replace(there, deflect_m=-left_m),)).danger


# somebody who comes, steps out to the left and back to the own line: metres ahead and to the left, tick by tick
COMES_M = [
    *((4.88, -1.08), (4.76, -0.95), (4.64, -0.82), (4.46, -0.84), (4.3, -0.87), (4.14, -0.89), (4.0, -0.84)),
    *((3.85, -0.79), (3.7, -0.73), (3.55, -0.67), (3.4, -0.62), (3.25, -0.56), (3.1, -0.51), (3.1, -0.51)),
]


@pytest.mark.parametrize("room_m", [0.4, 0.5, 0.6, 0.7])
def test_who_comes_does_not_drive_the_chair_into_a_wall(room_m):
    """A wall on the left, somebody on the right whose way of the moment seems to lead into the chair's."""
    half_m, wall_y_m = 0.5 * USUAL_OUTLINE.width_m, 9.0
    chair = Chair(x=53.0, y=wall_y_m - half_m - room_m, v=1.36, a=-1.0)
    first_y_m, waiting = chair.y, deque([Joystick(0.0, 0.75), Joystick(0.0, 0.5)])
    for before, here in zip([(5.0, -1.21), *COMES_M], COMES_M + 16 * COMES_M[-1:], strict=False):
        v = ((here[0] - before[0]) / TICK_S, (here[1] - before[1]) / TICK_S)
        other = person(53.0 + here[0], first_y_m + here[1], math.pi - 0.36, v)
        first_s = ORACLE.assess(chair.plant(), FORWARD, (other,), tuple(waiting), accel_mps2=chair.a).first_s
        wish = (0.0, 0.0) if np.isfinite(first_s).all() else (0.0, 1.0)
        distances = np.hypot(*(ACTIONS.points - np.array(wish)).T)
        drive_late(chair, waiting, first_s == first_s.max(), distances)
        reach_m = 0.8 * math.sin(chair.yaw) + half_m * math.cos(chair.yaw)
        assert wall_y_m - chair.y - reach_m > 0.05


def test_a_person_is_round():
    """A body turns no thin side to the chair: it is as far away whichever way it looks."""
    for yaw in (0.0, 0.5 * math.pi, 1.0):
        other = person(TOUCH_M + 0.3, Y_M, yaw)
        assert ORACLE.assess(plant(5.0, Y_M, 0.0), STOP, (other,)).clearance_m == pytest.approx(0.3)
    corner = person(5.0 + FRONT_M + 0.3, Y_M + 0.5 * USUAL_OUTLINE.width_m + 0.4, 0.3)
    assert ORACLE.assess(plant(5.0, Y_M, 0.0), STOP, (corner,)).clearance_m == pytest.approx(0.5 - RADIUS_M)


@pytest.mark.parametrize("gap", [0.2, 0.25, 0.3, 0.4, 0.6])
def test_a_slow_chair_does_not_nudge_who_stands(gap):
    chair = Chair(x=5.0, y=Y_M)
    x = TOUCH_M + gap
    assert met_at_mps(chair, (-0.1, x, Y_M), (9.0, x, Y_M)) == 0.0
    assert gap_m(chair, x, Y_M) > 0.0


@pytest.mark.parametrize("accel", [0.0, 0.5, 1.0])
def test_a_chair_that_speeds_up_needs_more_room(accel):
    """What the drive has begun fades with its jerk; the way to a stop, let go at once, is the chair's own."""
    chair = Chair(x=5.0, y=Y_M, v=0.8, a=accel)
    for _ in range(24 * 30):
        chair.drive(STOP, TICK_S / 24)
    start = plant(5.0, Y_M, 0.0, 0.8)
    ends_m = chair.x + FRONT_M + RADIUS_M
    for spare_m, hits in ((-0.01, True), (0.12, False)):
        said = ORACLE.assess(start, STOP, (person(ends_m + spare_m, Y_M, math.pi),), accel_mps2=accel)
        assert said.danger == hits


def test_who_walks_up_to_a_chair_that_stands_is_no_danger():
    coming = person(TOUCH_M + 0.6, Y_M, math.pi, (-1.3, 0.0))
    said = ORACLE.assess(plant(5.0, Y_M, 0.0), STOP, (coming,))
    assert not said.danger and said.first_s[STAY] == math.inf
    assert np.isfinite(said.first_s[ACTIONS.nearest((0.0, 0.5))])
    behind = person(5.0 - 0.3 - RADIUS_M - 0.4, Y_M, 0.0, (1.6, 0.0))
    assert not ORACLE.assess(plant(5.0, Y_M, 0.0, 0.6), Joystick(0.0, 0.4), (behind,)).danger
    assert ORACLE.assess(plant(5.0, Y_M, 0.0, -0.4), Joystick(0.0, -0.6), (behind,)).danger


def test_who_stands_beside_may_be_passed_and_not_turned_into():
    beside = person(5.6, Y_M + 0.5 * USUAL_OUTLINE.width_m + RADIUS_M + 0.06, 0.0)
    assert not ORACLE.assess(plant(5.0, Y_M, 0.0, 1.0), FORWARD, (beside,)).danger
    assert ORACLE.assess(plant(5.0, Y_M, 0.0, 0.0), Joystick(-1.0, 0.0), (beside,)).danger
