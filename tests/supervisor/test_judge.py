"""From a snapshot to what a step returns."""

from dataclasses import replace

import numpy as np
import pytest

from tests.supervisor.test_observation import sensors
from tests.support.plants import CALM
from tests.support.samples import ACTIONS
from tests.users.kinematics import plant
from wcsim.agents.envs.episode_view import EnvStepResult, SeatEnvAdapter
from wcsim.config import EnvConfig, RunConfig
from wcsim.errors import ConfigError
from wcsim.supervisor.observation import make_observation
from wcsim.types import ClientSnapshot, Joystick

CONFIG = RunConfig()
FORWARD = Joystick(0.0, 1.0)


def snapshot(crashed=False, truncated=False, user=FORWARD) -> ClientSnapshot:
    return ClientSnapshot(
        seat=0,
        tick=3,
        plant=plant(0.0, 0.0, 0.0),
        sensors=sensors(32, 24),
        user=user,
        contacts=(),
        events=replace(CALM, step=5, crashed=crashed, crash_reason="collision" if crashed else "", truncated=truncated),
    )


def judged(after: ClientSnapshot, action: int, asked: Joystick) -> EnvStepResult:
    """The step of a chair whose user asked for this, and whose agent answered so."""
    chair = SeatEnvAdapter(CONFIG)
    chair.now = snapshot(user=asked)
    chair.command(action)
    return chair.finish_step(after)


def test_the_action_is_compared_with_the_stick_it_answered():
    asked = Joystick(0.1, 0.9)
    followed = ACTIONS.nearest((asked.x, asked.y))
    got = judged(snapshot(user=Joystick(-1.0, 0.0)), followed, asked)
    assert got.reward == 1.0
    np.testing.assert_array_equal(got.observation["joystick"], np.float32([-1.0, 0.0]))


def test_the_penalty_grows_with_the_distance():
    stop = ACTIONS.nearest((0.0, 0.0))
    got = judged(snapshot(), stop, Joystick(0.0, 1.0))
    assert got.reward == pytest.approx(-2 * (1.0 - 0.1768) / (2 - 0.1768))
    corner = ACTIONS.nearest((-1.0, -1.0))
    far = judged(snapshot(), corner, Joystick(0.7071, 0.7071))
    assert far.info["reward_joystick"] == -2.0 and not far.terminated


@pytest.mark.parametrize(
    "crashed, truncated, expected",
    [
        (False, False, (False, False)),
        (True, False, (True, False)),
        (False, True, (False, True)),
        (True, True, (True, False)),
    ],
)
def test_how_an_episode_ends(crashed, truncated, expected):
    got = judged(snapshot(crashed, truncated), 0, Joystick(0.0, 0.0))
    assert (got.terminated, got.truncated) == expected
    assert got.info["reward_crash"] == (-100.0 if crashed else 0.0)


def test_the_configuration_chooses_form_classes_and_camera():
    config = CONFIG.model_copy(update={"env": EnvConfig(observation="table3", classes="wcsim")})
    assert make_observation(snapshot(), config)["segmentation"].shape == (3, 24, 32)
    two = (CONFIG.cameras[0].model_copy(update={"name": "rear"}), CONFIG.cameras[0])
    seen = CONFIG.model_copy(update={"cameras": two, "env": EnvConfig(camera="front")})
    assert make_observation(snapshot(), seen)["seg"].shape == (1, 24, 32)
    with pytest.raises(ConfigError, match="no camera 'rear' on this chair"):
        make_observation(snapshot(), seen.model_copy(update={"env": EnvConfig(camera="rear")}))
