"""What a finished test left is read again, and nothing else."""

import json

import pytest

from tests.view.report.results import SCRIPT, write_result
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.errors import ConfigError


def test_a_result_is_read_again_with_the_rows_of_its_episodes(tmp_path):
    said = write_result(tmp_path)
    result = read_result(tmp_path)
    assert list(result.episodes) == ["follow", "dwa", "net@0.25", "net@0.75", SCRIPT]
    assert result.episodes["dwa"][0].path_m == ((1.0, 0.0), (2.5, 0.0))
    assert result.to_json() == said and result.list_name == "try" and result.preset == "quick"
    assert json.loads(json.dumps(said)) == json.loads((tmp_path / "result.json").read_text("utf-8"))


def assert_refused(folder, damage):
    write_result(folder)
    path = folder / "episodes.json"
    episodes = json.loads(path.read_text("utf-8"))
    damage(episodes)
    path.write_text(json.dumps(episodes))
    with pytest.raises(ConfigError):
        read_result(folder)


@pytest.mark.parametrize(
    "change",
    [
        {"steps": "many"}, {"steps": True}, {"status": "won"}, {"part": 3}, {"nothing": 1}, {"path_m": [[0.0]]},
        {"path_m": 3}, {"end_m": ["a", "b"]}, {"accel_sq_sum": "x"}, {"interventions": [{"first": 1}]},
        {"m": None}, {"route_m": 1e308}, {"end_m": ["1", 2.0]}, {"steps": 10**15}, {"accel_sq_sum": -1e300},
    ],
)  # fmt: skip
def test_a_damaged_episode_is_refused(tmp_path, change):
    assert_refused(tmp_path, lambda episodes: episodes["dwa"][2].update(change))


@pytest.mark.parametrize("change", [{"suite": 7}, {"changed": "x"}, {"changed": [3]}, {"list_sha256": None}])
def test_a_damaged_result_is_refused(tmp_path, change):
    write_result(tmp_path, **change)
    with pytest.raises(ConfigError):
        read_result(tmp_path)


def test_a_policy_without_episodes_or_fields_is_refused(tmp_path):
    for damage in (lambda e: e.update(dwa=[]), lambda e: e["dwa"][0].pop("status")):
        assert_refused(tmp_path, damage)


@pytest.mark.parametrize(
    "file, was, now",
    [
        ("result.json", '"crashes_own": 1', '"crashes_own": 0'),
        ("result.json", "tick_s=0.1", "tick_s=0.2"),
        ("episodes.json", "[2.5, 0.0]", "[2.5, 1.0]"),
    ],
)
def test_files_that_contradict_each_other_are_refused(tmp_path, file, was, now):
    write_result(tmp_path)
    path = tmp_path / file
    path.write_text(path.read_text("utf-8").replace(was, now, 1))
    with pytest.raises(ConfigError, match="both of one test"):
        read_result(tmp_path)
