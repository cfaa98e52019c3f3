import json
import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from tests.agents.toy import ToyStreet, toy_camera
from wcsim.agents.baselines import baseline
from wcsim.agents.evaluate import evaluate
from wcsim.agents.testing import TestResult, open_policy, run_test
from wcsim.config import RunConfig
from wcsim.errors import ConfigError, PolicyError
from wcsim.types import Joystick, Truth

KEYS = (
    "policy", "episodes", "kpi1_mean", "kpi1_within", "kpi1_free_mean", "free_share", "kpi2_mean_steps", "crashes",
    "km", "crashes_per_km", "speed_mps",
)  # fmt: skip
CAMERA = toy_camera(24, 32)
CONFIG = RunConfig(cameras=(CAMERA,))


class Script(gym.Env):
    """Distances 0, 0.1, 0.2, ... of an episode; danger whenever the distance about to be answered is at least 0.2."""

    def __init__(self, crash_at=6, speed_mps=1.0, truth=True):
        self.crash_at, self.speed_mps, self.truth, self.closed = crash_at, speed_mps, truth, False
        self.seeds = []

    def _info(self, distance):
        truth = Truth(
            intent=Joystick(0, 0), danger=self.k >= 2, safe_actions=np.ones(81, bool), clearance_m=1, progress_m=0
        )
        return {"joystick_distance": distance, "speed_mps": self.speed_mps, "truth": truth if self.truth else None}

    def reset(self, *, seed=None, options=None):
        self.seeds.append(seed)
        self.k = 0
        return {"joystick": np.zeros(2, np.float32)}, self._info(0.0)

    def step(self, action):
        distance = self.k / 10
        self.k += 1
        return {"joystick": np.zeros(2, np.float32)}, 0.0, self.k == self.crash_at, False, self._info(distance)

    def close(self):
        self.closed = True


FOLLOW = baseline("follow", CONFIG)


def test_the_indicators_of_a_scripted_drive():
    env = Script(crash_at=6)
    row = evaluate(FOLLOW, env, episodes=2, max_steps=100, seed=7, tick_s=10.0)
    assert tuple(row.to_json()) == KEYS
    assert row.kpi1_mean == pytest.approx(0.25)
    assert row.kpi1_within == pytest.approx(2 / 6)
    assert row.kpi1_free_mean == pytest.approx(0.05)  # 0.0 and 0.1: the truth of the moment that was answered
    assert row.free_share == pytest.approx(2 / 6)
    assert (row.kpi2_mean_steps, row.crashes, row.episodes) == (6, 2, 2)
    assert (row.km, row.crashes_per_km) == (pytest.approx(0.12), pytest.approx(2 / 0.12))
    assert env.seeds == [7, None]


def test_a_cut_episode_survived_and_little_was_measured():
    row = evaluate(FOLLOW, Script(crash_at=99, truth=False), episodes=1, max_steps=5, seed=0)
    assert (row.kpi2_mean_steps, row.crashes, row.crashes_per_km) == (5, 0, None)
    assert row.kpi1_free_mean is None
    assert row.free_share is None
    assert not any(isinstance(v, float) and math.isnan(v) for v in row.to_json().values())
    assert evaluate(FOLLOW, Script(speed_mps=0.0), 1, 5, 0).speed_mps == 0.0


def test_the_oracle_is_shown_the_truth_of_the_moment_it_answers_to():
    class Danger(Script):
        def step(self, action):
            asked.append(int(action))
            return super().step(action)

        def _info(self, distance):
            info = super()._info(distance)
            safe = np.zeros(81, bool)
            safe[self.k] = True
            return {**info, "truth": replace(info["truth"], safe_actions=safe)} if self.truth else info

    asked: list[int] = []
    oracle = baseline("oracle", CONFIG)
    assert evaluate(oracle, Danger(crash_at=4), episodes=1, max_steps=9, seed=0).kpi2_mean_steps == 4
    assert asked == [0, 1, 2, 3]
    with pytest.raises(PolicyError, match=r"env\.truth"):
        evaluate(oracle, Danger(truth=False), episodes=1, max_steps=9, seed=0)


def test_the_table_calls_the_oracle_an_upper_bound():
    row = evaluate(FOLLOW, Script(), episodes=1, max_steps=5, seed=0)
    result = TestResult(town="a", seed=0, profile="b", rows=(row, replace(row, policy="oracle")))
    assert "upper bound" in str(result.table().caption)
    assert replace(result, rows=(row,)).table().caption is None


def test_nonsense_is_refused():
    with pytest.raises(ConfigError, match="at least 1"):
        evaluate(FOLLOW, Script(), episodes=0, max_steps=5, seed=0)


def test_a_test_of_several_policies_towns_and_profiles():
    made = []

    def make_env(town, profile):
        made.append((town, profile, ToyStreet(CAMERA, max_steps=40)))
        return made[-1][2]

    policies = [open_policy(name, CONFIG, seed=1) for name in ("follow", "zero")]
    results = run_test(policies, make_env, towns=["a", "b"], profiles=["blind"], episodes=2, max_steps=30, seed=4)
    assert [(r.town, r.profile, r.seed) for r in results] == [("a", "blind", 4), ("b", "blind", 4)]
    data = results[0].to_json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert list(data) == ["town", "seed", "profile", "rows"]
    assert [row["policy"] for row in data["rows"]] == ["follow", "zero"]
    assert results[0].rows == results[1].rows  # the same seed gives the same drive
    table = results[0].table()
    assert table.row_count == 2


def test_the_environment_is_closed_when_a_policy_fails():
    env = Script()

    class Broken:
        name = "broken"

        def begin(self):
            raise RuntimeError("no")

    with pytest.raises(RuntimeError):
        run_test([Broken()], lambda *_: env, towns=["a"], profiles=["b"], episodes=1, max_steps=1, seed=0)
    assert env.closed


def test_an_unknown_policy_is_explained(tmp_path):
    with pytest.raises(PolicyError, match="not a run"):
        open_policy(str(tmp_path / "nowhere"), CONFIG)
