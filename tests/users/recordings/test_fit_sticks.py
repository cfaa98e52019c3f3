"""What a stick does is read off it, a hand's lag and wander are found, and a person unlike the others is shown."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.core.seeding import make_rng
from wcsim.users.profiles import find_builtin_profile, list_profile_names
from wcsim.users.recordings.fit_sticks import STICK_DT_S, fit_user_to_sticks, measure_stick_habits, simulate_hand_stick

BASE, CALM = find_builtin_profile("slow"), replace(find_builtin_profile("competent"), noise=0.01)


def driven(user, seed: int, seconds: float = 90.0) -> np.ndarray:
    """The stick of a person that aims at another place every one or two seconds, and rests now and then."""
    rng, intents = make_rng(seed, "stairs"), []
    while sum(map(len, intents)) < seconds / STICK_DT_S:
        place = (rng.uniform(-0.6, 0.6), rng.choice([0.0, 0.35, 0.5, 0.7]))
        intents.append(np.tile(place if rng.random() < 0.8 else (0.0, 0.0), (int(rng.integers(50, 100)), 1)))
    return simulate_hand_stick(user, np.concatenate(intents), 0.01, seed)


def habits(stick, step=0.0):
    return measure_stick_habits(stick, CALM.noise_rate, step)


def test_a_push_to_the_gate_is_timed_and_shares_are_those_of_the_time():
    way = np.interp(np.arange(500), [100, 115, 300, 306], [0.0, 1.0, 1.0, 0.0])
    found = habits(np.c_[0.0 * way, way])
    assert found["rest_share"] == pytest.approx(0.59, abs=0.004)
    assert found["gate_share"] == pytest.approx(0.372, abs=0.004)
    assert found["moves_per_s"] == pytest.approx(2 / 4.1, rel=0.02)
    rise_s = 0.8 * 0.5 * (15 + 6) * STICK_DT_S
    assert found["lag_s"] == pytest.approx(math.sqrt((rise_s / math.log(9.0)) ** 2 - 0.02**2), abs=0.001)
    assert math.isnan(habits(np.zeros((500, 2)))["lag_s"]), "a stick at rest tells no movement"


@pytest.mark.parametrize("hz, top", [(0.6, 1), (2.0, 3), (5.0, 8)])
def test_a_swing_is_in_its_band_alone(hz, top):
    time_s = STICK_DT_S * np.arange(3000)
    found = habits(np.c_[0.2 * np.sin(math.tau * hz * time_s), np.full(3000, 0.5)])
    bands = [found[f"below_{name}_hz"] for name in (1, 3, 8)]
    assert found[f"below_{top}_hz"] == pytest.approx(0.2 / math.sqrt(2.0), rel=0.12) and sum(bands) < 0.165
    assert found["moves_per_s"] == pytest.approx(2.0 * hz, rel=0.05)


def test_a_slow_push_along_a_line_and_the_rounding_of_a_device_are_no_wander():
    line = np.linspace([0.1, 0.2], [0.5, 0.7], 1500)
    assert habits(line)["noise"] < 1e-9
    assert habits(line.round(2), 0.01)["noise"] < 0.003 < habits(line.round(2))["noise"]


@pytest.mark.parametrize("lag_s, noise", [(0.07, 0.01), (0.12, 0.005), (0.12, 0.015), (0.2, 0.01)])
def test_lag_and_wander_of_a_hand_are_found(lag_s, noise):
    found = habits(driven(replace(CALM, lag_s=lag_s, noise=noise), 1, 240.0), 0.01)
    assert found["lag_s"] == pytest.approx(lag_s, rel=0.15 if lag_s < 0.2 else 0.2), "slow ends are lost in the wander"
    assert found["noise"] == pytest.approx(noise, rel=0.3)


@given(st.integers(0, 99))
def test_left_and_right_are_alike(seed):
    stick = driven(find_builtin_profile("ataxic"), seed, 6.0)
    assert habits(stick) == pytest.approx(habits(stick * (-1.0, 1.0)), nan_ok=True)


def test_people_are_their_mean_and_one_unlike_the_others_is_out_of_the_range_that_they_let_expect():
    lags_s = (0.1, 0.11, 0.12, 0.13, 0.24)
    people = {f"p{k}": driven(replace(CALM, lag_s=lag_s), k, 45.0) for k, lag_s in enumerate(lags_s)}
    fit = fit_user_to_sticks(people, BASE)
    assert fit.profile == replace(BASE, spread=0.0, lag_s=fit.profile.lag_s, noise=fit.profile.noise)
    assert fit.estimates["lag_s"].low < 0.13 < fit.estimates["lag_s"].high and fit.estimates["lag_s"].n == 5
    assert fit.profile.noise == pytest.approx(0.01, rel=0.25) and "in steps of 0.01," in fit.warnings[0]
    rows = fit.habits
    assert list(rows) == ["people", "fitted", *list_profile_names(), *(f"person {name}" for name in people)]
    lags = [rows[f"person {name}"]["lag_s"] for name in people]
    assert [item.low < item.value < item.high for item in lags] == [True] * 4 + [False] and lags[4].n == 4
    for name in ("rest_share", "gate_share", "below_1_hz", "noise"):
        assert rows["fitted"][name].value == pytest.approx(rows["people"][name].value, rel=0.2, abs=0.01), name
    assert rows["tremor"]["below_8_hz"].value > 5.0 * rows["people"]["below_8_hz"].value


def test_one_person_has_pieces_and_a_hand_that_never_holds_shows_nothing():
    assert fit_user_to_sticks({"a": driven(CALM, 1, 60.0)}, BASE).estimates["lag_s"].n == 3
    fit = fit_user_to_sticks({"a": driven(find_builtin_profile("tremor"), 1, 60.0)}, BASE)
    assert fit.profile == replace(BASE, spread=0.0) and not fit.estimates and "hardly ever held" in fit.warnings[1]
