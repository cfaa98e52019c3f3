"""Lost control: faults that are planted into tracks are found, and normal driving is none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.crashes.lost_control import LASTS_S, Stretch, Track, stretches
from tests.physics.rig import flat_street, rig
from wcsim.config import ChairConfig
from wcsim.core.joystick import limits_of, shaped_rows
from wcsim.errors import ConfigError
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.rollout import driven
from wcsim.types import Joystick

CHAIR = ChairConfig()
TICK_S = 0.1
GRID = action_set("square81").points.tolist()


def driven_track(sticks, chair=CHAIR, v_mps=0.0):
    """What the kinematic chair does, as a track."""
    sticks = np.array(sticks, np.float64).reshape(-1, 2)
    v, w, a = v_mps, 0.0, 0.0
    speeds, turns = [v], [w]
    for x, y in shaped_rows(sticks, chair).tolist():
        for _ in range(4):
            v, w, a = driven(v, w, a, x, y, limits_of(chair), 0.25 * TICK_S)
        speeds.append(v)
        turns.append(w)
    return Track(tick_s=TICK_S, sticks=sticks, speed_mps=np.array(speeds), turn_radps=np.array(turns))


def planted(track, first, ticks, speed_mps=None, turn_radps=None):
    """A track whose chair does something else for some ticks."""
    speeds, turns = track.speed_mps.copy(), track.turn_radps.copy()
    if speed_mps is not None:
        speeds[first + 1 : first + ticks + 1] = speed_mps
    if turn_radps is not None:
        turns[first + 1 : first + ticks + 1] = turn_radps
    return Track(tick_s=TICK_S, sticks=track.sticks, speed_mps=speeds, turn_radps=turns)


REST = driven_track([(0.0, 0.0)] * 40)
RIGHT = driven_track([(0.5, 0.0)] * 40)


@pytest.mark.parametrize(("speed_mps", "found"), [(0.26, True), (-0.26, True), (0.24, False)])
def test_rolling_on_with_the_stick_at_rest_is_found(speed_mps, found):
    lost = stretches(planted(REST, 10, 9, speed_mps=speed_mps), CHAIR)
    assert lost == ((Stretch(first=10, ticks=9, turned=False, rolled=True),) if found else ())


def test_a_turn_on_the_spot_that_rolls_on_is_found():
    lost = stretches(planted(RIGHT, 20, 7, speed_mps=0.4), CHAIR)
    assert lost == (Stretch(first=20, ticks=7, turned=False, rolled=True),)


@pytest.mark.parametrize(("turn_radps", "found"), [(0.26, True), (0.24, False), (-1.5, False)])
def test_turning_against_the_stick_is_found(turn_radps, found):
    """A stick to the right asks for a turn rate below 0."""
    lost = stretches(planted(RIGHT, 15, 12, turn_radps=turn_radps), CHAIR)
    assert lost == ((Stretch(first=15, ticks=12, turned=True, rolled=False),) if found else ())
    left = driven_track([(-0.5, 0.0)] * 40)
    assert bool(stretches(planted(left, 15, 12, turn_radps=-turn_radps), CHAIR)) == found


@pytest.mark.parametrize("ticks", [6, 7])
def test_it_must_last(ticks):
    assert len(stretches(planted(REST, 10, ticks, speed_mps=0.5), CHAIR)) == (ticks * TICK_S >= LASTS_S - 1e-9)
    assert len(stretches(planted(RIGHT, 10, ticks, turn_radps=0.5), CHAIR)) == (ticks * TICK_S >= LASTS_S - 1e-9)


def test_both_at_once_are_one_stretch():
    both = planted(planted(RIGHT, 10, 10, speed_mps=0.5), 15, 10, turn_radps=0.5)
    assert stretches(both, CHAIR) == (Stretch(first=10, ticks=15, turned=True, rolled=True),)


def test_two_losses_are_two_stretches():
    twice = planted(planted(REST, 5, 8, speed_mps=0.5), 20, 9, speed_mps=-0.5)
    assert [(item.first, item.ticks) for item in stretches(twice, CHAIR)] == [(5, 8), (20, 9)]


@pytest.mark.parametrize("decel_mps2", [0.5, 1.5])
@pytest.mark.parametrize("fast", [0.25, 0.5, 1.0, -1.0])
def test_a_normal_stop_is_none(fast, decel_mps2):
    chair = CHAIR.model_copy(update={"decel_mps2": decel_mps2})
    assert not stretches(driven_track([(0.0, fast)] * 30 + [(0.0, 0.0)] * 60, chair), chair)


@pytest.mark.parametrize("later", [0, 1, 2, 5])
def test_a_stop_may_be_late_by_less_than_two_ticks(later):
    """From 1.67 m/s, 0.25 m/s are reached after about 1.1 s."""
    stop = driven_track([(0.0, 1.0)] * 30 + [(0.0, 0.0)] * 40)
    until = 31 + int(np.argmax(stop.speed_mps[31:] <= 0.25))  # the first speed that is low enough
    assert 41 <= until <= 43
    lost = stretches(planted(stop, until - 1, later, speed_mps=0.3), CHAIR)
    assert lost == ((Stretch(first=30, ticks=until - 31 + later, turned=False, rolled=True),) if later >= 2 else ())


def test_a_stop_that_is_weaker_than_configured_is_found():
    weak = CHAIR.model_copy(update={"decel_mps2": 0.5})
    track = driven_track([(0.0, 1.0)] * 30 + [(0.0, 0.0)] * 60, weak)
    assert not stretches(track, weak)
    (lost,) = stretches(track, CHAIR)
    assert lost.first == 30 and 25 <= lost.ticks <= 35


def test_letting_go_while_getting_faster_is_none():
    assert not stretches(driven_track([(0.0, 1.0)] * 8 + [(0.0, 0.0)] * 40), CHAIR)


def test_turning_round_is_none():
    there_and_back = ([(1.0, 0.0)] * 15 + [(-1.0, 0.0)] * 15) * 3
    assert not stretches(driven_track(there_and_back), CHAIR)


def test_turning_round_that_never_comes_is_found():
    still_right = planted(driven_track([(1.0, 0.0)] * 15 + [(-1.0, 0.0)] * 25), 15, 20, turn_radps=-1.5)
    (lost,) = stretches(still_right, CHAIR)
    assert lost.turned and (lost.first, lost.ticks) == (15, 20)


@given(st.lists(st.tuples(st.sampled_from(GRID), st.integers(1, 25)), min_size=1, max_size=12))
def test_the_kinematic_chair_never_loses_control(orders):
    sticks = [stick for stick, ticks in orders for _ in range(ticks)]
    assert not stretches(driven_track(sticks), CHAIR)


def test_a_chair_in_the_engine_keeps_control_on_level_ground():
    with rig(flat_street()) as made:
        made.place()
        sticks, speeds, turns = [], [0.0], [0.0]
        for stick, ticks in (((0.0, 1.0), 25), ((0.0, 0.0), 20), ((1.0, 0.0), 12), ((-1.0, 0.0), 15), ((0.5, 0.75), 15),
                             ((-0.5, 0.0), 15), ((0.0, -1.0), 12), ((0.25, 0.0), 12)):  # fmt: skip
            ride = made.drive(Joystick(*stick), ticks)
            sticks += [stick] * ticks
            speeds += ride.speed
            turns += ride.yaw_rate
    track = Track(tick_s=TICK_S, sticks=np.array(sticks), speed_mps=np.array(speeds), turn_radps=np.array(turns))
    assert max(speeds) > 1.5 and max(turns) > 1.0 and min(turns) < -1.0
    assert not stretches(track, CHAIR)
    assert stretches(planted(track, 34, 10, speed_mps=0.6), CHAIR)


def test_an_empty_track_holds_nothing_and_a_torn_one_is_refused():
    assert not stretches(driven_track([]), CHAIR)
    with pytest.raises(ConfigError, match="expected 4 of each"):
        torn = Track(tick_s=TICK_S, sticks=np.zeros((3, 2)), speed_mps=np.zeros(3), turn_radps=np.zeros(4))
        stretches(torn, CHAIR)
