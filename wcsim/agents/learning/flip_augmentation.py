"""Batches seen in a mirror: left and right are alike for a chair with its camera in the middle, so data count twice."""

from __future__ import annotations

import torch
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

from wcsim.agents.policy_api import IMU_KEY, JOYSTICK_KEY
from wcsim.agents.replay.safe_actions import AdviceBatch
from wcsim.supervisor.observation import imu_size

Tensors = dict[str, torch.Tensor]
Signs = tuple[tuple[str, tuple[float, ...]], ...]  # of each number of each further sensor, by name

IMU_SIGNS = (1.0, -1.0, 1.0, -1.0, 1.0)  # of ax, ay, az, roll, pitch
GYRO_SIGNS = (-1.0, 1.0, -1.0)
YAW_SIGNS = (-1.0, 1.0)  # of its sine and cosine
JOYSTICK_SIGNS = (-1.0, 1.0)
_SIGNS = {
    imu_size(gyro, yaw): IMU_SIGNS + gyro * GYRO_SIGNS + yaw * YAW_SIGNS
    for gyro in (False, True)
    for yaw in (False, True)
}


def mirrored(batch: DictReplayBufferSamples, actions: torch.Tensor, signs: Signs = ()) -> DictReplayBufferSamples:
    """The same batch with left and right exchanged; `actions` (A,) is the mirror map of the action set."""
    return batch._replace(
        observations=_mirrored(batch.observations, actions, signs),
        actions=actions[batch.actions.long()],
        next_observations=_mirrored(batch.next_observations, actions, signs),
    )


def mirrored_advice(batch: AdviceBatch, actions: torch.Tensor, signs: Signs = ()) -> AdviceBatch:
    """The same for a batch of the training aid."""
    return AdviceBatch(observations=_mirrored(batch.observations, actions, signs), safe=batch.safe[:, actions])


def _mirrored(observations: Tensors, actions: torch.Tensor, further: Signs) -> Tensors:
    out = dict(observations)
    for key, value in observations.items():
        if value.ndim > 2:  # a picture; the others are rows of numbers
            out[key] = value.flip(-1)
    imu_signs = _SIGNS[observations[IMU_KEY].shape[-1]]
    for key, signs in ((IMU_KEY, imu_signs), (JOYSTICK_KEY, JOYSTICK_SIGNS), *further):
        out[key] = observations[key] * observations[key].new_tensor(signs)
    return out
