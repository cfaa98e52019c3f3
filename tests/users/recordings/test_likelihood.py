"""The likelihood of a hand is that of its law, written out; Newton's method finds what it should, and how surely."""

import math

import numpy as np
import pytest

from wcsim.users.recordings.hand_likelihood import _covariance, _delayed_intents, _minimize, _negative_log_density

STEP_S = 0.03


def dense(hand, intent, noise, rate, amplitude, turn, fading, line):
    """Minus the logarithm of the density of a hand (n, 2), by the covariance of all its samples."""
    total, n = 0.0, len(hand)
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    for axis in range(2):
        power = 0.5 * (amplitude * (1.0 if axis == 0 else 0.5)) ** 2
        cov = noise**2 * np.exp(-rate * STEP_S * apart) + power * fading**apart * np.cos(turn * apart)
        cov += 1e-6 * np.eye(n)
        rest = hand[:, axis] - line[axis] * intent[:, axis] - line[2 + axis]
        total += 0.5 * (np.linalg.slogdet(2 * np.pi * cov)[1] + rest @ np.linalg.solve(cov, rest))
    return total


@pytest.mark.parametrize("amplitude, noise", [(0.0, 0.1), (0.2, 0.05)])
def test_it_is_the_density_of_all_samples_together(amplitude, noise):
    rng = np.random.default_rng(3)
    hand, intent, line = 0.2 * rng.normal(size=(40, 2)), rng.normal(size=(40, 2)), np.array([0.8, 1.1, 0.02, -0.1])
    law = np.array([STEP_S, noise, 3.0, amplitude, 0.9, 0.99])
    all_of_them, clear = np.ones(40, np.bool_), np.zeros(40, np.bool_)
    found = _negative_log_density(hand, intent, all_of_them, law, line, all_of_them, clear)
    assert found.sum() == pytest.approx(dense(hand, intent, noise, 3.0, amplitude, 0.9, 0.99, line), rel=1e-6)


def test_samples_that_the_gate_stopped_change_nothing():
    rng = np.random.default_rng(4)
    hand, intent, line = 0.1 * rng.normal(size=(30, 2)), np.zeros((30, 2)), np.array([1.0, 1.0, 0.0, 0.0])
    law, clear = np.array([STEP_S, 0.1, 3.0, 0.0, 0.9, 0.99]), np.zeros(30, np.bool_)
    free = np.ones(30, np.bool_)
    free[10:14] = False
    found = _negative_log_density(hand, intent, free, law, line, free, clear)
    hand[10:14] = 9.0
    assert np.array_equal(found, _negative_log_density(hand, intent, free, law, line, free, clear))
    assert not found[10:14].any() and not clear[11:15].any() and clear[20]
    _negative_log_density(0.1 * hand + 0.66, intent + 0.66, free, law, line, free, clear)
    assert not clear.any()  # too near to the gate


@pytest.mark.parametrize("delay_s", [0.0, 0.23, 0.35])
def test_an_intent_arrives_late_slowly_and_smoothly(delay_s):
    intents, dt_s = np.zeros((30, 2)), 0.1 / 24
    intents[5:, 0] = 1.0
    out = _delayed_intents(intents, 24, dt_s, delay_s, 0.2, 0.0)[:, 0]
    times_s = dt_s * np.arange(1, len(out) + 1)
    expected = 1.0 - np.exp(-np.maximum(times_s - 0.5 - delay_s, 0.0) / 0.2)
    assert np.allclose(out, expected, atol=0.02)
    later = _delayed_intents(intents, 24, dt_s, delay_s + 1e-4, 0.2, 0.0)[:, 0]
    assert 0.0 < float((out - later).max()) < 2e-3
    filtered = _delayed_intents(intents, 24, dt_s, delay_s, 0.2, 0.02)[:, 0]
    assert math.isclose(float((out - filtered).sum()) * dt_s, 0.02, rel_tol=0.15)


def test_newton_finds_mean_and_spread_and_how_sure_they_are():
    values = np.random.default_rng(1).normal(3.0, 2.0, 4000)

    def summands(place):
        return 0.5 * (((values - place[0]) / math.exp(place[1])) ** 2) + place[1]

    steps, together = np.array([0.02, 0.02]), np.arange(4000) // 10
    here = _minimize(summands, np.array([2.6, 0.5]), steps)
    assert here == pytest.approx([values.mean(), math.log(values.std())], abs=5e-3)
    sd = np.sqrt(np.diag(_covariance(summands, here, steps, together)))
    assert sd == pytest.approx([2.0 / math.sqrt(4000), 1.0 / math.sqrt(8000)], rel=0.12)


def test_stretches_that_move_together_are_less_sure():
    rng = np.random.default_rng(2)
    values = np.repeat(rng.normal(3.0, 2.0, 400), 10)

    def summands(place):
        return 0.5 * (values - place[0]) ** 2

    steps = np.array([0.02])
    here = _minimize(summands, np.array([2.5]), steps)
    alone = _covariance(summands, here, steps, np.arange(4000))[0, 0]
    assert _covariance(summands, here, steps, np.arange(4000) // 10)[0, 0] == pytest.approx(10.0 * alone, rel=0.02)
