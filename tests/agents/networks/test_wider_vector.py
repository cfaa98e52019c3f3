"""Turn rates and heading in the network: sizes follow, and mirrors turn the right signs."""

import numpy as np
import pytest
import torch
from gymnasium import spaces

from wcsim.agents.learning.flip_augmentation import _mirrored
from wcsim.agents.networks.q_network import NetSpec, QNet
from wcsim.supervisor.observation import imu_size, observation_space


@pytest.mark.parametrize(("gyro", "yaw"), [(False, False), (True, False), (False, True), (True, True)])
def test_a_network_takes_what_the_observation_has(gyro, yaw):
    space = observation_space("compact", 32, 24, imu_size(gyro, yaw))
    net = QNet(space, spaces.Discrete(81), NetSpec())
    batch = {key: torch.as_tensor(np.asarray(value))[None] for key, value in space.sample().items()}
    assert net(batch).shape == (1, 81)


def test_what_turns_left_turns_right_in_the_mirror():
    batch = {
        "seg": torch.zeros(1, 1, 2, 2, dtype=torch.uint8),
        "depth": torch.zeros(1, 1, 2, 2, dtype=torch.uint8),
        "imu": torch.arange(1.0, 11.0)[None],
        "joystick": torch.ones(1, 2),
    }
    signs = torch.sign(_mirrored(batch)["imu"][0]).tolist()
    assert signs == [1, -1, 1, -1, 1, -1, 1, -1, -1, 1]  # ax ay az roll pitch, gx gy gz, sine and cosine of yaw
