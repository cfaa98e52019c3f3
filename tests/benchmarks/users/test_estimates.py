"""The estimators find what was put into a signal, and notice a hand that is not its profile."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.users.hand_fit import fit_hand
from benchmarks.users.hand_habits import HandLog, Pauses, pauses, switch_holds, tremor
from benchmarks.users.table import RouteLog, meet, statistics
from tests.support.samples import strip_street
from tests.users.actors import actor, make_user
from tests.users.kinematics import Chair, Sim, polyline
from wcsim.core.seeding import make_rng
from wcsim.types import ActorKind, Joystick
from wcsim.users.hand import StickHandModel
from wcsim.users.profiles import find_builtin_profile
from wcsim.users.recordings.hand_series import find_mean_correction_interval_s

DT_S, STEPS, TICK_S = 0.1 / 24, 24, 0.1
STREET = strip_street()


def wishes() -> np.ndarray:
    """Somebody who changes their mind every 0.7 s, for 40 s."""
    rng, blocks = np.random.default_rng(2), math.ceil(40.0 / 0.7)
    return np.repeat(np.c_[rng.normal(0, 0.25, blocks), rng.choice([0.0, 0.5, 0.8], blocks)], 7, axis=0)


def log_of(user, seed=1, stretch=1.0) -> HandLog:
    """A hand that is given wishes; with `stretch` its clock runs wrong."""
    hand, sticks, wanted = StickHandModel(user, make_rng(seed, "hand")), [], wishes()
    for x, y in wanted:
        hand.send_intent(Joystick(x, y))
        sticks.append(hand.move(STEPS, stretch * DT_S))
    return HandLog(dt_s=DT_S, intents=wanted, sticks=np.array(sticks))


def route(user, hand: HandLog) -> RouteLog:
    speed = np.full(len(hand.intents), 1.0)
    return RouteLog(profile=user, tick_s=TICK_S, hand=hand, speed_mps=speed, v_max_mps=1.67, met=0, noticed=0)


def test_a_sine_is_found_with_frequency_and_amplitude():
    time_s = DT_S * np.arange(60 * 240)
    x = 0.2 * np.sin(2 * np.pi * 5.2 * time_s) + 0.3 * np.sin(2 * np.pi * 0.3 * time_s)
    log = HandLog(dt_s=DT_S, intents=np.zeros((600, 2)), sticks=np.c_[x, 0 * x].reshape(600, 24, 2))
    found = tremor(log)
    assert found.hz == pytest.approx(5.2, abs=0.05)
    assert found.amplitude == pytest.approx(0.2 * math.hypot(1.0, 2 * np.pi * 5.2 * 0.02), rel=0.03)


@pytest.mark.parametrize("name", ["competent", "slow", "tremor", "ataxic"])
def test_a_hand_shows_its_parameters(name):
    user = find_builtin_profile(name)
    rows = statistics([route(user, log_of(user, seed=seed)) for seed in (1, 2)])
    off = {key: abs(row.measured - row.parameter) for key, row in rows.items()}
    assert off["reaction_s"] < 0.02 and off["lag_s"] < 0.045
    assert max(off["gain_x"], off["gain_y"], off["bias_x"], off["bias_y"]) < 0.2
    if name == "tremor":
        assert off["tremor_hz"] < 0.1 and off["tremor"] < 0.02
    else:
        assert off["noise"] < 0.1 * user.noise + 0.003 and off["noise_rate"] < 1.0


@pytest.mark.parametrize(
    "name, fault, row",
    [
        ("competent", {"reaction_s": 0.35}, "reaction_s"),
        ("slow", {"lag_s": 0.15}, "lag_s"),
        ("tremor", {"tremor_hz": 5.5}, "tremor_hz"),
        ("tremor", {"tremor": 0.15}, "tremor"),
        ("ataxic", {"gain": (1.3, 1.2)}, "gain_x"),
        ("ataxic", {"bias": (-0.12, 0.0)}, "bias_x"),
        ("competent", {"noise": 0.06}, "noise"),
    ],
)
def test_a_hand_that_is_not_its_profile_is_noticed(name, fault, row):
    user = find_builtin_profile(name)
    got = statistics([route(user, log_of(replace(user, **fault)))])[row]
    assert abs(got.measured - got.parameter) > 0.25 * abs(got.parameter) - 0.01 or row == "tremor_hz"
    if row == "tremor_hz":
        assert got.measured == pytest.approx(5.5, abs=0.15)


def test_a_hand_whose_clock_runs_wrong_is_noticed():
    log = log_of(find_builtin_profile("tremor"), stretch=1.25)
    assert tremor(log).hz == pytest.approx(1.25 * 4.5, abs=0.2)
    assert fit_hand(log, 0.2).delay_s == pytest.approx(0.35 / 1.25, abs=0.03)


def test_pauses_are_where_an_intent_stands_still_but_not_rest_backing_up_or_turning():
    moving = np.c_[np.linspace(0.0, 0.5, 60), np.full(60, 0.8)]
    moving[20:30] = moving[20]
    rest, back = np.zeros((50, 2)), np.tile([0.0, -0.5], (40, 1))
    turn = np.c_[np.linspace(0.6, 0.3, 20), np.zeros(20)]
    assert pauses(np.vstack([moving, rest, back, turn])) == Pauses(still=9, driven=59, ended=1)
    assert pauses(np.vstack([moving, moving[-1:], moving[-1:]])) == Pauses(still=11, driven=61, ended=1)
    assert pauses(np.zeros((20, 2))) == Pauses(still=0, driven=0, ended=0)


def test_corrections_are_counted_without_the_rests_between_them():
    steps = np.repeat(np.random.default_rng(0).normal(0.0, 0.3, (30, 2)), 4, axis=0)
    steps[40:80] = 0.0
    assert find_mean_correction_interval_s(steps, TICK_S) == pytest.approx(0.4)
    assert find_mean_correction_interval_s(np.zeros((30, 2)), TICK_S) is None


def test_how_long_switches_are_held():
    forward, left, rest = (0.0, 0.6), (-0.35, 0.0), (0.0, 0.0)
    sticks = np.array([rest] * 20 + [left] * 48 + [forward] * 72 + [left] * 96 + [forward] * 500)
    turns_s, between_s = switch_holds(sticks, DT_S)
    assert turns_s == pytest.approx([0.2, 0.4]) and between_s == pytest.approx([0.3])
    assert not len(switch_holds(np.zeros((50, 2)), DT_S)[1])


def test_what_must_have_been_noticed_or_missed_is_counted_once():
    shares = []
    for seed in range(6):
        user = make_user("inattentive", seed, street=STREET, away_share=0.0)
        sim, met = Sim(user, polyline((0.0, 5.5), (80.0, 5.5)), Chair(x=0.3, y=5.5)), {}
        sim.obstacles = np.array([[x, 5.95, 0.1] for x in range(8, 76, 4)], float)
        sim.actors = tuple(actor(ActorKind.PEDESTRIAN, x, 6.6, name=f"p{x}") for x in range(10, 76, 4))
        while sim.time_s < 80.0 and not user.arrived:
            sim.tick()
            if user.witness is not None:
                meet(*user.witness, user.profile, met)
        assert len(met) > 25
        shares += met.values()
    assert np.mean(shares) == pytest.approx(0.35, abs=0.08)
