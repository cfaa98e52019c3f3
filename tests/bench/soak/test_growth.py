"""Slopes of what grows in a soak, their bounds, and what follows for a long run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from wcsim.bench.soak.growth import RUN_H, WARM_S, WORLD, Slope, fitted, long_run, predicted_s


def life(begin_s, level, per_h, noise=0.0, seed=0, count=400):
    rng = np.random.default_rng(seed)
    times_s = begin_s + np.arange(count)
    return [(float(t), level + per_h * (t - begin_s) / 3600.0 + float(rng.normal(0.0, noise))) for t in times_s]


def test_a_slope_is_found_through_lives_at_different_levels():
    found = fitted([life(0.0, 500.0, 36.0), life(1000.0, 800.0, 36.0)])
    assert found.per_h == pytest.approx(36.0) and found.upper_per_h == pytest.approx(36.0)
    assert found.most == pytest.approx(800.0 + 36.0 * 399 / 3600)


def test_what_happens_while_a_process_warms_up_is_no_growth():
    steep = [(float(t), 100.0 * t) for t in range(int(WARM_S))]
    assert fitted([steep + [(float(t), 1000.0) for t in range(int(WARM_S), 300)]]).per_h == pytest.approx(0.0, abs=1e-6)


def test_a_bound_holds_in_nineteen_of_twenty_soaks():
    bounds = [fitted([life(0.0, 500.0, 10.0, noise=0.3, seed=seed)]).upper_per_h for seed in range(200)]
    assert 0.9 <= np.mean(np.array(bounds) > 10.0) <= 0.99


@pytest.mark.parametrize("lives", [[], [[(0.0, 1.0)]], [[(0.0, 1.0), (100.0, 1.0)]]])
def test_too_few_samples_give_no_bound(lives):
    assert fitted(lives).upper_per_h == math.inf


def test_a_recovery_by_replay_is_reckoned_for_the_last_tick_of_an_epoch():
    exact = [(ticks, 8.0 + 0.05 * ticks) for ticks in (100.0, 400.0, 900.0, 2000.0)]
    assert predicted_s(exact, 6000.0) == pytest.approx(308.0)
    same = [(0.0, took) for took in (9.0, 10.0, 11.0, 10.0)]
    assert 10.0 < predicted_s(same, 0.0) < 13.0
    assert predicted_s(same[:2], 0.0) == math.inf


def test_a_world_grows_for_an_epoch_and_its_clients_for_the_whole_run():
    memory = {WORLD: Slope(per_h=90.0, upper_per_h=100.0, most=700.0), "a": Slope(upper_per_h=1.0, most=500.0)}
    found = long_run(memory, Slope(upper_per_h=20.0, most=100.0), 0.5, 12.0)
    assert found.memory_gb == pytest.approx((700.0 + 50.0 + 500.0 + RUN_H) / 1e3)
    assert (found.disk_gb, found.recovery_s) == (pytest.approx(12.1), 12.0)
