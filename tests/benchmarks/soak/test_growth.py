"""Slopes of what grows in a soak, their bounds, and what follows for a long run."""

import math
import os
import subprocess
import sys

import numpy as np
import psutil  # type: ignore[import-untyped]
import pytest

from benchmarks.soak.growth import RUN_H, WARM_S, WORLD, GrowthLog, Slope, fitted, long_run, predicted_s
from benchmarks.soak.learners import settled_step
from wcsim.config import LearnConfig
from wcsim.server.launch.states import ClientProcessState, LaunchProcessStates


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


def test_a_bound_of_recoveries_is_above_their_mean():
    same = [9.0, 10.0, 11.0, 10.0]
    assert 10.0 < predicted_s(same) < 13.0
    assert predicted_s(same[:2]) == math.inf


def test_errors_of_processes_that_grow_apart_are_added_as_variances():
    memory = {name: Slope(per_h=2.0, upper_per_h=5.0, most=100.0) for name in "abcd"}
    assert long_run(memory, Slope(upper_per_h=0.0), 1.0, 0.0).memory_gb == pytest.approx(
        (400.0 + 8.0 * RUN_H + math.sqrt(4.0) * 3.0 * RUN_H) / 1e3
    )
    unknown = {"a": Slope(per_h=0.0, upper_per_h=math.inf)}
    assert long_run(unknown, Slope(upper_per_h=0.0), 1.0, 0.0).memory_gb == math.inf


def test_what_fills_up_before_a_run_has_settled_is_no_growth(tmp_path):
    log = GrowthLog(tmp_path, warm_s=0.0)
    state = LaunchProcessStates(
        elapsed_s=0.0,
        world_standing="running",
        world_pid=os.getpid(),
        world_restarts=0,
        world=None,
        clients=(ClientProcessState(name="a", seat=0, standing="running", pid=os.getpid()),),
    )
    for now in range(20):
        (tmp_path / "replay").write_bytes(bytes(1000 * min(now, 10)))
        log.look(state, float(now), settled=now >= 10)
    assert (log.disk.per_h, log.disk.most) == (pytest.approx(0.0), pytest.approx(0.01))
    assert set(log.memory) == {"launcher", WORLD, "a"} and log.memory["a"].most > 10.0
    whole = GrowthLog(tmp_path, warm_s=0.0)
    whole.look(state, 0.0, settled=False)
    assert whole.disk.upper_per_h == whole.memory["a"].upper_per_h == math.inf


def test_a_process_that_was_killed_and_is_not_yet_waited_for_is_no_sample(tmp_path):
    log = GrowthLog(tmp_path, warm_s=0.0)
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        client = ClientProcessState(name="a", seat=0, standing="running", pid=child.pid)
        shown = LaunchProcessStates(
            elapsed_s=0.0, world_standing="running", world_pid=0, world_restarts=0, world=None, clients=(client,)
        )
        log.look(shown, 0.0)
        child.kill()
        os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)  # it is dead, and stays there
        assert psutil.Process(child.pid).memory_info().rss == 0
        log.look(shown, 10.0)
    finally:
        child.kill()
        child.communicate()
    ((at_s, held_mb),) = log._memory["a", child.pid].pairs
    assert at_s == 0.0 and held_mb > 0.0


def test_a_run_has_settled_when_its_replay_is_full_and_every_checkpoint_holds_one():
    learn = LearnConfig(replay_frames=1000, checkpoint_every=500)
    assert settled_step(learn) == 2500


def test_a_world_grows_for_an_epoch_and_its_clients_for_the_whole_run():
    memory = {WORLD: Slope(per_h=90.0, upper_per_h=90.0, most=700.0)}
    memory |= {"a": Slope(per_h=1.0, upper_per_h=1.3, most=500.0)}
    found = long_run(memory, Slope(upper_per_h=20.0, most=100.0), 0.5, 12.0)
    assert found.memory_gb == pytest.approx((700.0 + 45.0 + 500.0 + 1.3 * RUN_H) / 1e3)
    assert (found.disk_gb, found.recovery_s) == (pytest.approx(12.1), 12.0)


def test_a_client_grows_no_further_than_to_where_it_is_replaced():
    memory = {WORLD: Slope(per_h=0.0, upper_per_h=0.0, most=700.0)}
    memory |= {"slow": Slope(per_h=0.1, upper_per_h=0.2, most=500.0)}
    memory |= {"fast": Slope(per_h=100.0, upper_per_h=200.0, most=500.0)}
    found = long_run(memory, Slope(upper_per_h=0.0), 0.5, 0.0, client_growth_mb=400.0)
    replaced_mb = 500.0 + 400.0 + 200.0 * 0.5  # it is looked at when an epoch begins
    assert found.memory_gb == pytest.approx((700.0 + 500.0 + 0.2 * RUN_H + replaced_mb) / 1e3)
