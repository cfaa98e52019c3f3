"""From a seat's share of a snapshot to what an environment's step returns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wcsim.config import RunConfig
from wcsim.supervisor.observation import Observation, observation_of
from wcsim.supervisor.rewards import joystick_distance, reward
from wcsim.types import F64, ClientSnapshot, Joystick, RewardTerms


class _Judgement(NamedTuple):
    """What one step was worth."""

    observation: Observation
    reward: RewardTerms
    terminated: bool
    truncated: bool


def judge(snapshot: ClientSnapshot, action: int, asked: Joystick, points: F64, config: RunConfig) -> _Judgement:
    """Judge the step that led to `snapshot`.

    Args:
        snapshot: The seat's snapshot after the tick; `snapshot.first` (the next episode) is not looked at.
        action: Index of the executed action.
        asked: The user's joystick in the observation that the action answered, that is, of the snapshot before.
        points: (A, 2) joystick positions of the action set.
        config: The run's configuration.

    Raises:
        ConfigError: The camera of `env.camera` is not on the chair.
        IndexError: No such action.
    """
    taken = points[action]
    distance = joystick_distance(np.array([asked.x, asked.y]), taken, config.reward)
    events = snapshot.events
    return _Judgement(
        observation=observation_of(snapshot, config),
        reward=reward(distance, snapshot.sensors.imu, snapshot.plant, events, config.reward),
        terminated=events.crashed,
        # An episode that crashed has ended: nothing is left that could be cut off.
        truncated=events.truncated and not events.crashed,
    )
