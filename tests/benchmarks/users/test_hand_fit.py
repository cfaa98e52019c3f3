"""Hands and eyes of users who steer by what they see: what a profile declares is found, and what is not so is noticed.

In the loop an intent answers to the hand's noise, and a strong hand is stopped by the joystick's round gate.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.users.hand_fit import fit_hand
from benchmarks.users.hand_habits import HandLog
from benchmarks.users.table import RouteLog, statistics
from tests.benchmarks.users.test_drives import off
from tests.users.actors import make_user
from tests.users.kinematics import SUBSTEPS, TICK_S, Chair, Sim, polyline
from wcsim.users.profiles import find_builtin_profile

ZIGZAG = polyline(*((8.0 * k, 5.0 * (k % 2)) for k in range(12)))
STRAIGHT = polyline((0.0, 0.0), (90.0, 0.0))
HAND = {"reaction_s", "lag_s", "gain_x", "gain_y", "bias_x", "bias_y", "noise", "noise_rate"}


@cache
def driven(name: str, seed: int, straight: bool = False, **fault) -> RouteLog:
    """A user on a way, said to be of a profile."""
    sim = Sim(make_user(name, seed, **fault), STRAIGHT if straight else ZIGZAG, Chair())
    intents, sticks = [], []
    while sim.time_s < 40.0 and not sim.user.arrived:
        intents.append((sim.user.intent.x, sim.user.intent.y))
        sim.tick()
        sticks.append(sim.user.sticks)
    hand = HandLog(dt_s=TICK_S / SUBSTEPS, intents=np.array(intents), sticks=np.array(sticks))
    speed = np.array(sim.track.speed)
    return RouteLog(
        profile=find_builtin_profile(name), tick_s=TICK_S, hand=hand, speed_mps=speed, v_max_mps=1.67, met=0, noticed=0
    )


def wrong(name: str, names: set[str], straight: bool = False, **fault) -> set[str]:
    """Which statistics over a few routes are out of the bounds of the proof."""
    seeds = range(2 if fault else 4)  # a fault shows in two routes
    rows = statistics([driven(name, seed, straight, **fault) for seed in seeds])
    assert names <= set(rows)
    return set(off({key: rows[key] for key in names}))


@pytest.mark.parametrize("name", ["slow", "ataxic", "inattentive"])
def test_users_on_their_way_show_their_parameters(name):
    assert not wrong(name, HAND)


@pytest.mark.parametrize(
    "name, fault, row",
    [
        ("ataxic", {"gain": (0.6, 1.2)}, "gain_x"),
        ("ataxic", {"gain": (0.8, 1.0)}, "gain_y"),
        ("ataxic", {"bias": (0.03, 0.0)}, "bias_x"),
        ("ataxic", {"reaction_s": 0.35}, "reaction_s"),
        ("ataxic", {"noise_rate": 4.0}, "noise_rate"),
        ("inattentive", {"gain": (0.85, 1.0)}, "gain_x"),
        ("slow", {"lag_s": 0.2}, "lag_s"),
    ],
)
def test_a_hand_that_is_not_its_profile_is_noticed_on_the_way(name, fault, row):
    assert row in wrong(name, {row}, **fault)


def test_a_hand_that_only_its_own_noise_keeps_busy_is_not_taken_for_a_weaker_one():
    assert not wrong("ataxic", HAND, straight=True)
    assert "gain_x" in wrong("ataxic", {"gain_x"}, straight=True, gain=(0.6, 1.2))


def test_looks_elsewhere_are_as_many_and_as_long_as_declared():
    rows = {"away_share", "away_s"}
    assert not wrong("inattentive", rows)
    assert "away_share" in wrong("inattentive", rows, away_share=0.5)
    assert "away_s" in wrong("inattentive", rows, away_s=1.2)


def test_a_gain_is_as_certain_as_its_wish_moves():
    lively = driven("ataxic", 0).hand
    lazy = replace(lively, intents=lively.intents * (1.0, 0.0) + (0.0, 0.6))
    assert fit_hand(lazy).gain_sd[1] > 100.0 * fit_hand(lively).gain_sd[1]
    assert 0.02 < fit_hand(lively).gain_sd[0] < 0.2


def test_a_hand_that_the_gate_always_stops_still_has_a_fit():
    stopped = HandLog(dt_s=TICK_S / SUBSTEPS, intents=np.tile([0.0, 1.0], (200, 1)), sticks=np.ones((200, 24, 2)))
    assert np.isfinite(fit_hand(stopped).gain).all()
