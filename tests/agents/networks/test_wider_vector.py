"""Turn rates and heading in the network: sizes follow, and mirrors turn the right signs."""

import numpy as np
import pytest
import torch
from gymnasium import spaces

from wcsim.agents.learning.seqdqn import _mirrored
from wcsim.agents.networks.encoder import vector_keys_from_space
from wcsim.agents.networks.q_network import QNet
from wcsim.config.run_file import NetSpec
from wcsim.supervisor.observation import count_imu_values, make_observation_space
from wcsim.types import Measure

MEASURES = {
    "wheels": Measure(parts=("speed_mps", "turn_radps"), full_scale=(4.0, 4.0), mirror=(1.0, -1.0)),
    "beams": Measure(parts=("ahead_m",) * 3, full_scale=(9.0,) * 3, mirror=(1.0,) * 3),
}


IMAGE = torch.zeros(1, 1, 2, 2, dtype=torch.uint8)


def drawn(space):
    return {key: torch.as_tensor(np.asarray(value))[None] for key, value in space.sample().items()}


@pytest.mark.parametrize("gyro, yaw", [(False, False), (True, False), (False, True), (True, True)])
def test_a_network_takes_what_the_observation_has(gyro, yaw):
    space = make_observation_space("compact", 32, 24, count_imu_values(gyro, yaw))
    net = QNet(space, spaces.Discrete(81), NetSpec())
    batch = drawn(space)
    assert net(batch).shape == (1, 81)


def test_what_turns_left_turns_right_in_the_mirror():
    batch = {"seg": IMAGE, "depth": IMAGE, "imu": torch.arange(1.0, 11.0)[None], "joystick": torch.ones(1, 2)}
    signs = torch.sign(_mirrored(batch, torch.arange(1), ())["imu"][0]).tolist()
    assert signs == [1, -1, 1, -1, 1, -1, 1, -1, -1, 1]  # ax ay az roll pitch, gx gy gz, sine and cosine of yaw


def test_further_rows_of_numbers_come_last_and_nobody_names_them():
    paper, more = (
        make_observation_space("compact", 32, 24),
        make_observation_space("compact", 32, 24, measures=MEASURES),
    )
    net, wide = QNet(paper, spaces.Discrete(81), NetSpec()), QNet(more, spaces.Discrete(81), NetSpec())
    assert vector_keys_from_space(paper) == ("imu", "joystick") and vector_keys_from_space(more) == (
        "imu",
        "joystick",
        "beams",
        "wheels",
    )
    batch = drawn(more)
    got = wide.encoder.vector(batch)[0].tolist()
    assert got[7:] == [*batch["beams"][0].tolist(), *batch["wheels"][0].tolist()]
    plain = {key: batch[key] for key in paper.spaces}
    assert torch.equal(net(batch), net(plain))  # what it was not trained with changes nothing


def test_further_numbers_turn_their_signs_in_the_mirror():
    pair = torch.ones(1, 2)
    batch = {"seg": IMAGE, "depth": IMAGE, "imu": torch.ones(1, 5), "joystick": pair, "wheels": pair}
    assert _mirrored(batch, torch.arange(1), (("wheels", (1.0, -1.0)),))["wheels"].tolist() == [[1.0, -1.0]]
