from dataclasses import replace

import numpy as np
import pytest

from tests.agents.driven import Script, driven
from tests.agents.toy import toy_camera
from wcsim.agents.envs.episode_view import OBJECTS
from wcsim.agents.opening import named_policy
from wcsim.agents.opening.named_policy import open_named_policy, resolve_policy_config
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.policies.onnx_policy import ExportedDangerPolicy
from wcsim.agents.policy_api import MOTION_SENSES
from wcsim.agents.runs.policy_file import find_shipped_policy
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
            if self.truth:
                info[OBJECTS].truth = replace(info[OBJECTS].truth, first_s=first_s)
            return info

    asked: list[int] = []
    oracle = make_baseline_policy("oracle", CONFIG)
    assert driven(oracle, Danger(crash_at=4), episodes=1, max_steps=9).kpi2 == 4
    assert asked == [0, 1, 2, 3]
    with pytest.raises(PolicyError, match=r"env\.truth"):
        driven(oracle, Danger(truth=False), episodes=1, max_steps=9)


@pytest.mark.parametrize("delay", [0, 2])
def test_without_torch_shipped_drives_as_with_it(delay, monkeypatch):
    config = resolve_policy_config("shipped", "quick", (f"world.action_delay_ticks={delay}",))
    policies = [open_named_policy("shipped", config, 0)]
    monkeypatch.setattr(named_policy, "find_spec", lambda name: None)
    policies.append(open_named_policy("shipped", config, 0))
    assert isinstance(policies[1], ExportedDangerPolicy) and policies[1].senses == MOTION_SENSES
    with np.load(find_shipped_policy() / "reference.npz") as ride:
        inputs = {key: ride[key] for key in ride.files if key not in ("danger", "action")}
    done = []
    for policy in policies:
        policy.begin()
        policy.reset()
        for k in range(len(inputs["depth"])):
            done.append(policy.choose({key: rows[k] for key, rows in inputs.items()}))
            policy.sent(done[-1] if k % 4 else k % 80)  # as where the driver overrules it
    assert np.mean(np.equal(*np.reshape(done, (2, -1)))) > 0.98, "but for places on the border of two cells"
    assert len(set(done)) > 5


def test_without_torch_nothing_drives_by_a_law_that_is_not_its_own(monkeypatch):
    for module in ("wcsim.errors", "wcsim.agents.opening.named_policy"):
        monkeypatch.setattr(f"{module}.find_spec", lambda name: None)
    config = resolve_policy_config("shipped", "quick")
    others = ("@0.3", "world.tick_s=0.1"), ("", "world.action_delay_ticks=1"), ("", "chair.v_max_mps=1.0")
    for level, other in others:
        policy = open_named_policy(f"shipped{level}", resolve_policy_config("shipped", "quick", (other,)), 0)
        assert not isinstance(policy, ExportedDangerPolicy)
    with pytest.raises(PolicyError, match=r"pip install 'wcsim\[train\]'"):
        open_named_policy("veto:shipped", config, 0)
    with pytest.raises(PolicyError, match="trained with 2 cameras, this test has 1"):
        open_named_policy("shipped", CONFIG, 0)


def test_an_unknown_policy_is_explained(tmp_path):
    with pytest.raises(PolicyError, match="not a run"):
        open_named_policy(str(tmp_path / "nowhere"), CONFIG, 0)
