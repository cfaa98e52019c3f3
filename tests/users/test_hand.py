"""The hand: delay, lag, wander, tremor, switches; always on the disc."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wcsim.core.seeding import make_rng
from wcsim.types import Joystick
from wcsim.users.hand import StickHandModel, SwitchHandModel, clip_to_disc
from wcsim.users.profiles import find_builtin_profile, list_profile_names

DT_S = 1 / 240
TICK_S = 0.1
QUIET = replace(find_builtin_profile("competent"), noise=0.0, reaction_s=0.3, lag_s=0.1)


def moved(hand, intent, seconds, dt_s=DT_S):
    hand.send_intent(intent)
    steps = round(TICK_S / dt_s)
    return np.concatenate([hand.move(steps, dt_s) for _ in range(round(seconds / TICK_S))])


def test_nothing_moves_before_the_reaction_time_and_then_with_the_lag():
    path = moved(StickHandModel(QUIET, make_rng(0)), Joystick(0.0, 0.8), 1.5)[:, 1]
    assert np.abs(path[: int(0.29 / DT_S)]).max() == 0.0
    reached = int(np.argmax(path > 0.8 * (1 - math.exp(-1)))) * DT_S
    assert reached == pytest.approx(0.3 + 0.1 + 0.02, abs=0.015)
    assert path[-1] == pytest.approx(0.8, abs=1e-3)
    assert (np.diff(path) >= 0).all()


def test_the_wander_has_its_size_and_pace_at_any_step():
    for dt_s in (1 / 240, 1 / 120):
        user = replace(QUIET, noise=0.1, noise_rate=4.0)
        path = moved(StickHandModel(user, make_rng(1)), Joystick(0.0, 0.0), 200.0, dt_s)
        assert path.std(axis=0) == pytest.approx([0.1, 0.1], rel=0.15)
        later = round(0.25 / dt_s)  # one time constant
        assert np.corrcoef(path[:-later, 0], path[later:, 0])[0, 1] == pytest.approx(math.exp(-1), abs=0.1)


def test_tremor_has_its_amplitude_and_frequency():
    user = replace(QUIET, tremor=0.25, tremor_hz=4.5)
    path = moved(StickHandModel(user, make_rng(2)), Joystick(0.0, 0.0), 60.0)[:, 0]
    power = np.abs(np.fft.rfft(path)) ** 2
    peak_hz = np.fft.rfftfreq(len(path), DT_S)[power.argmax()]
    assert peak_hz == pytest.approx(4.5, abs=0.4)
    assert 0.19 < np.abs(path).max() < 0.25  # the electronics take a little off


@settings(max_examples=40)
@given(st.sampled_from(list_profile_names()), st.integers(0, 999), st.floats(-9, 9), st.floats(-9, 9))
def test_the_stick_stays_on_the_disc(name, seed, x, y):
    user = find_builtin_profile(name)
    hand = SwitchHandModel(user) if user.discrete else StickHandModel(user, make_rng(seed))
    path = moved(hand, Joystick(x, y), 1.0)
    assert np.isfinite(path).all()
    assert np.hypot(*path.T).max() <= 1.0 + 1e-9


def test_switches_know_four_positions_and_turn_in_pulses():
    hand = SwitchHandModel(find_builtin_profile("switch"))
    forward = moved(hand, Joystick(0.0, 0.8), 2.0)
    assert forward[-1].tolist() == [0.0, 0.6]
    turning = moved(hand, Joystick(0.9, 0.4), 3.0)
    assert {(0.35, 0.0), (0.0, 0.6)} <= {tuple(row) for row in turning.tolist()}
    stopped = moved(hand, Joystick(0.0, 0.0), 2.5)
    assert stopped[-1].tolist() == [0.0, 0.0]
    everything = {tuple(row) for row in np.vstack([forward, turning, stopped]).tolist()}
    assert everything <= {(0.0, 0.0), (0.0, 0.6), (0.35, 0.0), (-0.35, 0.0)}


@given(st.floats(-5, 5), st.floats(-5, 5))
def test_on_disc_preserves_the_direction(x, y):
    a, b = clip_to_disc(x, y)
    assert math.hypot(a, b) <= 1.0 + 1e-12
    assert a * y == pytest.approx(b * x, abs=1e-9)
