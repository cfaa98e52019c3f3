from dataclasses import replace

import numpy as np
import pytest

from tests.agents.driven import Script, driven
from tests.agents.toy import toy_camera
from wcsim.agents.opening.named_policy import open_named
from wcsim.agents.policies.baselines import baseline
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


def test_an_unknown_policy_is_explained(tmp_path):
    with pytest.raises(PolicyError, match="not a run"):
        open_named(str(tmp_path / "nowhere"), CONFIG, 0)
