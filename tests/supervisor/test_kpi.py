"""Indicators against hand-made numbers; nothing is ever NaN."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.errors import ConfigError
from wcsim.supervisor.kpi import KpiMeter, KpiStep, StepLog, summarise
from wcsim.types import Events, Joystick

REST = Joystick(0.0, 0.0)
AHEAD = Joystick(0.0, 0.8)


def step(distance=0.0, free=True, speed_mps=1.0, dt_s=0.1, asked=REST, given=REST, **events):
    nothing = {"episode": 0, "step": 1, "crashed": False, "crash_reason": "", "truncated": False}
    happened = Events(**{**nothing, "arrived": False, "gave_up": False, **events})
    return KpiStep(
        distance=distance, free=free, asked=asked, given=given, speed_mps=speed_mps, dt_s=dt_s, events=happened
    )


def row_of(*steps, ends=()):
    meter = KpiMeter()
    for one in steps:
        meter.add(one)
    for steps_alive in ends:
        meter.end_episode(steps_alive)
    return meter.row()


def test_a_small_test_by_hand():
    meter = KpiMeter()
    for distance, free in ((0.0, True), (0.1768, True), (1.0, False), (2.0, None)):
        meter.add(step(distance, free, 1.5))
    meter.end_episode(3, "collision")
    meter.end_episode(1)
    row = meter.row()
    assert (row.steps, row.episodes, row.crashes, row.crash_reasons) == (4, 2, 1, {"collision": 1})
    assert row.distance_mean == pytest.approx(3.1768 / 4)
    assert row.share_within == 0.5
    assert row.distance_free_mean == pytest.approx(0.0884)
    assert row.distance_danger_mean == 1.0
    assert row.free_share == pytest.approx(2 / 3)
    assert row.steps_alive_mean == 2.0
    assert row.steps_alive_median == 2.0
    assert row.km == pytest.approx(0.0006)
    assert row.speed_mean_mps == pytest.approx(1.5)
    assert row.crashes_per_km == pytest.approx(1 / 0.0006)
    assert row.crashes_per_1000_steps == 250.0
    assert row.hours == pytest.approx(0.4 / 3600)


def test_moving_steps_are_those_with_the_stick_out_and_no_danger():
    row = row_of(
        step(0.1, asked=Joystick(0.0, 0.3)),  # not out by more than 0.3
        step(0.2, asked=Joystick(0.0, 0.31)),
        step(0.15, asked=Joystick(-0.25, 0.25)),  # 0.354: turning counts too
        step(0.9, free=False, asked=AHEAD),
        step(0.9, free=None, asked=AHEAD),
    )
    assert row.distance_moving_mean == pytest.approx(0.175)
    assert row.moving_within == 0.5
    assert row.distance_free_mean == pytest.approx(0.15)


def test_blocked_is_half_of_the_throttle_where_the_way_is_free():
    row = row_of(
        step(asked=AHEAD, given=Joystick(0.0, 0.4)),  # half of it
        step(asked=AHEAD, given=Joystick(0.0, 0.39)),  # less
        step(asked=Joystick(0.9, 0.3)),  # no push forward
        step(asked=AHEAD, given=Joystick(0.0, -0.5)),
        step(free=False, asked=AHEAD),
    )
    assert row.blocked_share == 0.5


def frozen(ticks, **other):
    return [step(speed_mps=0.0, asked=AHEAD, **other)] * ticks


def test_a_freeze_takes_three_seconds():
    assert row_of(*frozen(29)).freezes == 0
    assert row_of(*frozen(30)).freezes == 1
    assert row_of(*frozen(95)).freezes == 1
    assert row_of(*frozen(30), step(), *frozen(31)).freezes == 2
    assert row_of(*frozen(20), step(speed_mps=0.05), *frozen(20)).freezes == 0
    assert row_of(*frozen(20), *frozen(20), ends=(20, 20)).freezes == 0  # no stretch goes on in another episode
    assert row_of(*frozen(40), *frozen(40), ends=(40,)).freezes == 2


def test_who_stands_as_the_user_wants_or_tries_to_drive_does_not_freeze():
    assert row_of(*[step(speed_mps=0.0, asked=Joystick(0.0, 0.29))] * 50).freezes == 0
    assert row_of(*frozen(50, given=Joystick(0.3, 0.0))).freezes == 0
    assert row_of(*frozen(50, given=Joystick(0.25, 0.0))).freezes == 1


def test_what_the_world_saw_is_counted():
    row = row_of(
        step(crossed=True, speed_mps=10.0, dt_s=10.0),
        step(crossed=True, entered_red=True, arrived=True),
        step(gave_up=True),
        step(gave_up=True, on_carriageway=True),
        step(speed_mps=0.049, on_carriageway=True, dt_s=0.2),
        step(speed_mps=0.0, on_carriageway=True, dt_s=0.2),
        step(speed_mps=0.0),
    )
    assert (row.routes_completed, row.routes_given_up, row.crossings, row.red_entries) == (1, 2, 2, 1)
    assert row.crossings_per_km == pytest.approx(2 / row.km) and row.km == pytest.approx(0.1, rel=0.01)
    assert row.standing_on_carriageway_s == pytest.approx(0.4)


def test_crashes_are_counted_by_reason():
    meter = KpiMeter()
    for reason in ("tilt", "", "drop", "tilt"):
        meter.add(step())
        meter.end_episode(1, reason)
    row = meter.row()
    assert (row.crashes, row.crash_reasons) == (3, {"drop": 1, "tilt": 2})


def test_nothing_measured_is_none_and_json():
    row = KpiMeter().row()
    assert row.steps == row.episodes == row.freezes == row.crossings == 0
    assert row.distance_mean is None and row.steps_alive_mean is None and row.crashes_per_km is None
    assert row.distance_moving_mean is None and row.blocked_share is None and row.crossings_per_km is None
    json.dumps(dataclasses.asdict(row), allow_nan=False)


def test_a_standing_chair_has_no_crashes_per_km():
    meter = KpiMeter()
    meter.add(step(0.5, None, 0.0))
    meter.end_episode(1, "collision")
    row = meter.row()
    assert row.crashes_per_km is None and row.free_share is None and row.distance_free_mean is None
    assert row.speed_mean_mps == 0.0


def test_reversing_is_a_way_driven_but_no_speed_gained():
    row = row_of(step(speed_mps=1.0, dt_s=1.0), step(speed_mps=-1.0, dt_s=1.0))
    assert row.km == pytest.approx(0.002) and row.speed_mean_mps == 0.0


sticks = st.builds(Joystick, st.floats(-1, 1), st.floats(-1, 1))
steps = st.builds(
    step,
    distance=st.floats(0, 2),
    free=st.sampled_from([None, True, False]),
    speed_mps=st.sampled_from([0.0, 0.0, -0.5, 1.0]),
    dt_s=st.just(0.1),
    asked=sticks,
    given=sticks,
    crossed=st.booleans(),
    on_carriageway=st.booleans(),
)


@given(st.lists(steps, max_size=20), st.lists(st.tuples(st.integers(1, 10_000), st.sampled_from(["", "tilt"]))))
def test_never_nan_and_within_bounds(taken, episodes):
    meter = KpiMeter()
    for one in taken:
        meter.add(one)
    for end in episodes:
        meter.end_episode(*end)
    row = meter.row()
    for value in dataclasses.asdict(row).values():
        assert value is None or isinstance(value, dict) or math.isfinite(value)
    assert row.crashes == sum(row.crash_reasons.values())
    if taken:
        assert 0.0 <= row.distance_mean <= 2.0 and 0.0 <= row.share_within <= 1.0
        assert row.blocked_share is None or 0.0 <= row.blocked_share <= 1.0


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 45)), max_size=12), st.integers(1, 60))
def test_freezes_are_those_that_a_plain_count_finds(stretches, episode_steps):
    plan = [cold for cold, ticks in stretches for _ in range(ticks)]
    ends = [episode_steps] * (len(plan) // episode_steps)
    expected = lasted = 0
    for k, cold in enumerate(plan):
        lasted = (0 if k % episode_steps == 0 else lasted) + 1 if cold else 0
        expected += lasted == 30
    assert row_of(*[frozen(1)[0] if cold else step() for cold in plan], ends=ends).freezes == expected


def test_lengths_must_agree():
    log = KpiMeter().log()
    for name in ("distance", "given", "entered_red"):
        with pytest.raises(ConfigError, match="lengths"):
            summarise(dataclasses.replace(log, **{name: np.zeros(3)}))
    assert isinstance(log, StepLog)
