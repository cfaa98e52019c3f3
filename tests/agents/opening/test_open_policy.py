from dataclasses import replace

import numpy as np
import pytest

from tests.agents.driven import Script, driven
from tests.agents.toy import toy_camera
from wcsim.agents.opening import named_policy
from wcsim.agents.opening.named_policy import config_for, open_named
from wcsim.agents.policies.baselines import baseline
from wcsim.agents.policies.onnx_policy import OnnxPolicy
from wcsim.agents.policy_api import MOTION_SENSES
from wcsim.agents.runs.policy_file import shipped_folder
from wcsim.config import RunConfig
from wcsim.errors import PolicyError

CONFIG = RunConfig(cameras=(toy_camera(24, 32),))


def test_the_oracle_is_shown_the_truth_of_the_moment_it_answers_to():
    class Danger(Script):
        def step(self, action):
            asked.append(int(action))
            return super().step(action)

        def _info(self, distance):
            info = super()._info(distance)
            first_s = np.ones(81)
            first_s[self.k] = np.inf
            return {**info, "truth": replace(info["truth"], first_s=first_s)} if self.truth else info

    asked: list[int] = []
    oracle = baseline("oracle", CONFIG)
    assert driven(oracle, Danger(crash_at=4), episodes=1, max_steps=9).kpi2 == 4
    assert asked == [0, 1, 2, 3]
    with pytest.raises(PolicyError, match=r"env\.truth"):
        driven(oracle, Danger(truth=False), episodes=1, max_steps=9)


def test_without_torch_shipped_drives_as_recorded_and_no_other_threshold_does(monkeypatch):
    monkeypatch.setattr(named_policy, "find_spec", lambda name: None)
    config = config_for("shipped", "quick")
    policy = open_named("shipped", config, 0)
    assert isinstance(policy, OnnxPolicy) and policy.senses == MOTION_SENSES
    with np.load(shipped_folder() / "reference.npz") as ride:
        inputs = {key: ride[key] for key in ride.files if key not in ("danger", "action")}
        wanted = ride["action"].tolist()
    steps = [{key: rows[step] for key, rows in inputs.items()} for step in range(len(wanted))]
    policy.begin()
    policy.reset()
    assert [policy.act(step) for step in steps] == wanted
    assert not isinstance(open_named("shipped@0.3", config, 0), OnnxPolicy)
    with pytest.raises(PolicyError, match="trained with another camera"):
        open_named("shipped", CONFIG, 0)


def test_an_unknown_policy_is_explained(tmp_path):
    with pytest.raises(PolicyError, match="not a run"):
        open_named(str(tmp_path / "nowhere"), CONFIG, 0)
