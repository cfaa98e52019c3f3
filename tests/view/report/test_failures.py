"""Failures: which, in which order, and the command that drives one again."""

import json
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.support.plants import CALM
from tests.view.report.results import (
    PATH_M,
    SCRIPT,
    crashed,
    record,
    score_anew,
    unreached,
    with_episodes,
    write_result,
)
from wcsim.agents.envs.episode_view import InfoObjects
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.supervisor.kpi import KpiStep, sum_kpi_steps
from wcsim.types import Joystick
from wcsim.view.report.failures import _judged, _last_speed_mps, chosen, failures_of, where_typed


def worst_of(failures, policy):
    return next(failure for failure in failures if failure.policy == policy)


def kept(path_m, time_s):
    return record(0, time_s=time_s, path_m=path_m)


@pytest.mark.parametrize(
    "item, said",
    [
        (record(0), ("", "")),
        (record(5, status="timed_out"), ("", "")),
        (record(0, status="timed_out"), ("timed out", "")),
        (record(0, status="gave_up"), ("gave up", "")),
        (record(0, red_entries=2), ("red light", "own")),
        (record(0, status="policy_failed", steps=3), ("policy failed", "policy")),
        (crashed(0, reason="drop"), ("drop", "own")),
        (crashed(0, fault="other"), ("collision", "other")),
        (unreached(4), ("not reached", "before the policy")),
    ],
)
def test_what_counts_as_a_failure(item, said):
    assert _judged(item)[:2] == said


def test_the_worst_come_first(tmp_path):
    write_result(tmp_path)
    failures = failures_of(read_result(tmp_path), tmp_path)
    order = [crashed(0, partner="car"), crashed(0, reason="drop"), crashed(0, fault="other"),
             record(0, status="policy_failed"), record(0, red_entries=1), record(0, status="gave_up"),
             unreached(0)]  # fmt: skip
    assert [_judged(item)[2] for item in order] == sorted(_judged(item)[2] for item in order)
    assert [one.severity for one in failures] == sorted(one.severity for one in failures)
    worst = worst_of(failures, "net@0.25")
    assert (worst.key, worst.reason, worst.unaided) == ((0, 0), "collision", "drop (own fault) after 2 s")
    assert all(failure.policy != "dwa" for failure in failures)
    assert [one.key for one in chosen(failures, 1) if one.policy == "follow"] == [(0, 1)]  # with a car, not the fall
    early = with_episodes(read_result(tmp_path), {"follow": (unreached(0),)})
    assert failures_of(early, tmp_path) and not chosen(failures_of(early, tmp_path), 100)


def test_of_two_like_failures_the_faster_is_worse(tmp_path):
    write_result(tmp_path)
    path = tmp_path / "episodes.json"
    episodes = json.loads(path.read_text("utf-8"))
    episodes["net@0.75"][0]["path_m"][-1] = [4.0, 0.0]
    path.write_text(json.dumps(episodes))
    score_anew(tmp_path)
    first = failures_of(read_result(tmp_path), tmp_path)[0]
    assert (first.policy, first.key, first.speed_mps) == ("net@0.75", (0, 0), pytest.approx(3.0 / 0.5))


def test_the_speed_of_the_last_second_comes_from_the_way():
    assert _last_speed_mps(kept(PATH_M, 1.5)) == pytest.approx(1.5 / 0.5)
    assert _last_speed_mps(kept(((0.0, 0.0), (1.0, 0.0), (1.1, 0.0)), 2.1)) == pytest.approx(1.1 / 1.1)
    assert _last_speed_mps(kept(((0.0, 0.0), (1.0, 0.0), (3.0, 0.0)), 3.0)) == pytest.approx(2.0)
    assert _last_speed_mps(kept((), 1.5)) is None


@pytest.mark.parametrize("steps", [11, 14, 120, 121, 123, 129])
def test_a_steady_speed_is_told_however_long_the_episode(steps):
    driven = []
    for step in range(1, steps + 1):
        state = SimpleNamespace(p_WB_m=(0.15 * step, 0.0, 0.0))
        at_rest = Joystick(0.0, 0.0)
        objects = InfoObjects(state=state, events=CALM, asked=at_rest, given=at_rest)
        told = {"objects": objects, "joystick_distance": 0.0, "speed_mps": 1.5}
        driven.append(KpiStep.of(told))
    path_m = sum_kpi_steps(driven, 0.1)["path_m"]
    assert _last_speed_mps(kept(path_m, 0.1 * steps)) == pytest.approx(1.5, abs=0.2 if steps in (11, 121) else 0.06)


def test_the_command_says_all_that_was_changed_and_nothing_can_leave_its_word(tmp_path):
    write_result(tmp_path)
    (tmp_path / "asked.json").write_text('{"suite": "my list.json", "preset": "paper", "network": "a:B"}')
    failures = failures_of(read_result(tmp_path), Path("runs/out"))
    command = worst_of(failures, SCRIPT).command
    assert shlex.split(command) == [
        "wcsim", "test", SCRIPT, "--suite", "my list.json", "--play", "0.0", "--out", "out", "--preset", "paper",
        "--network", "a:B", "--set", "world.tick_s=0.1",
    ]  # fmt: skip


def test_the_command_names_the_folder_as_the_test_did(tmp_path):
    write_result(tmp_path / "runs" / "out")
    assert where_typed(read_result(tmp_path / "runs" / "out")) == "that contains the folder of the test"
    (tmp_path / "runs" / "out" / "asked.json").write_text('{"suite": "dev2", "out": "runs/out"}')
    result = read_result(tmp_path / "runs" / "out")
    command = worst_of(failures_of(result, tmp_path / "runs" / "out"), SCRIPT).command
    assert "--suite dev2 --play 0.0 --out runs/out" in command and where_typed(result) == "in which you ran the test"
