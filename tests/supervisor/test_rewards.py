"""Tables 1 and 2: every row, both ends of every window."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import CALM, plant_state
from wcsim.config import RewardConfig
from wcsim.errors import ConfigError
from wcsim.supervisor.rewards import (
    _accel_term,
    _crash_term,
    _intensity,
    _joystick_terms,
    _tilt_term,
    compute_reward_terms,
    find_crash_reason,
    joystick_distance,
)
from wcsim.types import Contact, Events, ImuFrame

C = RewardConfig()
finite = st.floats(-1e6, 1e6)


def imu(peak=(0.0, 0.0, 0.0)) -> ImuFrame:
    """A tilt sensor that is quite wrong: the supervisor does not look at it."""
    return ImuFrame(
        accel_mean_mps2=np.array([0.0, 0.0, 9.81]),
        accel_peak_mps2=np.array(peak, float),
        gyro_radps=np.zeros(3),
        roll_rad=0.7,
        pitch_rad=0.7,
        yaw_rad=0.0,
    )


def plant(roll_deg=0.0, pitch_deg=0.0):
    return plant_state(roll=math.radians(roll_deg), pitch=math.radians(pitch_deg))


def events(crashed=False) -> Events:
    return replace(CALM, crashed=crashed, crash_reason="tilt" if crashed else "")


def contact(kind, part, impulse=1.0) -> Contact:
    return Contact(kind=kind, part=part, impulse_Ns=impulse, cause="own")


@pytest.mark.parametrize(
    "distance, base, joystick",
    [
        (0.0, 1.0, 0.0),
        (0.1768, 1.0, 0.0),
        (math.hypot(0.125, 0.125), 1.0, 0.0),
        (float(np.hypot(np.float32(0.125), np.float32(0.125))), 1.0, 0.0),
        (0.177, 0.0, -2.0 * 0.0002 / 1.8232),
        (0.25, 0.0, -2.0 * 0.0732 / 1.8232),
        (1.0884, 0.0, -1.0),
        (2.0, 0.0, -2.0),
        (2.41, 0.0, -2.0),
    ],
)
def test_joystick_rows(distance, base, joystick):
    got = _joystick_terms(distance, C)
    assert got == (base, pytest.approx(joystick, abs=1e-9))


@pytest.mark.parametrize(
    "peak, penalty",
    [
        ((20, 20, 20), 0),
        ((30, 0, 0), -1),
        ((0, -30, 0), -1),
        ((0, 0, 40), -2),
        ((40, -40, 40), -6),
        ((99, 0, 0), -2),
        ((9, 9, 19.9), 0),
    ],
)
def test_acceleration_rows(peak, penalty):
    assert _accel_term(np.array(peak, float), C) == pytest.approx(penalty)


@pytest.mark.parametrize(
    "roll, pitch, penalty",
    [(5, 20, 0), (12.5, 0, -1), (-12.5, 0, -1), (20, 0, -2), (0, 25, -1), (0, -30, -2), (20, 30, -4), (4.9, 19.9, 0)],
)
def test_tilt_rows(roll, pitch, penalty):
    assert _tilt_term(math.radians(roll), math.radians(pitch), C) == pytest.approx(penalty, abs=1e-12)


def test_a_crash_costs_100_once_and_the_terms_add_up():
    terms = compute_reward_terms(1.0884, imu(peak=(50, 50, 50)), plant(50, 50), events(crashed=True), C)
    assert terms.crash == -100.0
    assert terms.total == pytest.approx(0.0 - 1.0 - 6.0 - 4.0 - 100.0)
    assert _crash_term(False, C) == 0.0
    assert compute_reward_terms(0.1, imu(), plant(), events(), C).total == 1.0


@given(finite, finite)
def test_intensity_is_bounded_and_monotone(a, b):
    low, high = sorted((_intensity(a, 20.0, 40.0), _intensity(b, 20.0, 40.0)))
    assert 0.0 <= low <= high <= 1.0
    assert (_intensity(a, 20.0, 40.0) <= _intensity(b, 20.0, 40.0)) or a > b


@given(st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_reward_never_grows_with_distance(a, b):
    near, far = sorted((a, b))
    assert sum(_joystick_terms(near, C)) >= sum(_joystick_terms(far, C)) >= -2.0


@given(st.lists(st.floats(-200, 200), min_size=3, max_size=3), st.floats(-180, 180), st.floats(-90, 90), st.booleans())
def test_reward_is_bounded_and_even_in_its_signs(peak, roll, pitch, crashed):
    got = compute_reward_terms(0.5, imu(peak), plant(roll, pitch), events(crashed), C).total
    assert -2 * 6 - 100 <= got <= 1.0
    mirrored = compute_reward_terms(0.5, imu([-p for p in peak]), plant(-roll, -pitch), events(crashed), C).total
    assert got == pytest.approx(mirrored)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_joystick_distance_ends_at_the_window(a, b, c, d):
    got = joystick_distance(np.array([a, b]), np.array([c, d]), C)
    assert got == pytest.approx(min(2.0, math.hypot(a - c, b - d)))
    assert 0.0 <= got <= 2.0


def test_empty_window_is_refused():
    with pytest.raises(ConfigError, match="low < high"):
        _intensity(1.0, 40.0, 20.0)


@pytest.mark.parametrize(
    "kind, part, impulse, expected",
    [
        ("ground", "wheel", 500.0, ""),
        ("kerb", "caster", 500.0, ""),
        ("kerb", "antitip", 500.0, ""),
        ("ground", "footplate", 19.9, ""),
        ("kerb", "body", 20.0, ""),
        ("ground", "footplate", 20.1, "collision"),
        ("kerb", "body", 21.0, "collision"),
        ("building", "wheel", 0.01, "collision"),
        ("static", "caster", 0.01, "collision"),
        ("pedestrian", "footplate", 0.0, "collision"),
        ("car", "body", 3.0, "collision"),
        ("wheelchair", "antitip", 3.0, "collision"),
    ],
)
def test_which_contacts_crash(kind, part, impulse, expected):
    assert find_crash_reason(imu(), plant(), [contact(kind, part, impulse)], C) == expected


@pytest.mark.parametrize(
    "kind, part, impulse, expected",
    [
        ("ground", "wheel", 500.0, "drop"),
        ("ground", "footplate", 80.0, "drop"),  # where it falls to
        ("kerb", "body", 80.0, "drop"),
        ("car", "body", 3.0, "collision"),  # what pushed it
        ("building", "wheel", 0.01, "collision"),
    ],
)
def test_a_fall_explains_what_the_ground_does_and_not_what_others_do(kind, part, impulse, expected):
    assert find_crash_reason(imu((41, 0, 0)), plant(25.0), [contact(kind, part, impulse)], C, dropped=True) == expected
    assert find_crash_reason(imu(), plant(), [], C, dropped=True) == "drop"


@pytest.mark.parametrize(
    "peak, roll_deg, pitch_deg, expected",
    [
        ((0, 0, 0), 0.0, 0.0, ""),
        ((40, 40, 40), 0.0, 0.0, ""),
        ((0, -40.1, 0), 0.0, 0.0, "acceleration"),
        ((0, 0, 0), 19.99, 0.0, ""),
        ((0, 0, 0), -20.1, 0.0, "tilt"),
        ((0, 0, 0), 0.0, 29.9, ""),
        ((0, 0, 0), 0.0, -30.1, "tilt"),
        ((41, 0, 0), 90.0, 0.0, "acceleration"),
    ],
)
def test_crashes_by_what_was_felt(peak, roll_deg, pitch_deg, expected):
    frame, state = imu(peak), plant(roll_deg, pitch_deg)
    assert find_crash_reason(frame, state, [contact("ground", "wheel")], C) == expected
    assert find_crash_reason(frame, state, [contact("bus", "body")], C) == "collision"
