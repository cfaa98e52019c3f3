import numpy as np
import pytest
import torch
from gymnasium import spaces

from wcsim.agents.envs.episode_view import window_observation_space
from wcsim.agents.networks.costs import _PositionalNet
from wcsim.agents.networks.onnx_form import network_to_onnx
from wcsim.agents.networks.q_network import QNet
from wcsim.agents.networks.registry import preferred_window_size
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY
from wcsim.config.run_file import NetSpec
from wcsim.supervisor.observation import make_observation_space

runtime = pytest.importorskip("onnxruntime")


@pytest.mark.parametrize("name", ["patch", "fig6"])
@pytest.mark.parametrize("classes", ["cityscapes", "wcsim"])
def test_an_exported_network_says_what_the_network_itself_says(name, classes):
    window, picks = preferred_window_size(name), torch.Generator().manual_seed(3)
    space = window_observation_space(make_observation_space("compact", 32, 24), window)
    net = QNet(space, spaces.Discrete(81), NetSpec(network=name, classes=classes))
    net.set_training_mode(False)
    seen = {
        key: torch.randint(0, most, (1, window, 24, 32), dtype=torch.uint8, generator=picks)
        for key, most in ((CLASS_KEY, 60), (DEPTH_KEY, 256))
    } | {IMU_KEY: torch.full((1, 5), 0.3), JOYSTICK_KEY: torch.tensor([[0.5, -0.25]])}
    model = network_to_onnx(_PositionalNet(net, tuple(seen)), tuple(seen.values()), tuple(seen), ("values",))
    session = runtime.InferenceSession(model, providers=["CPUExecutionProvider"])
    (told,) = session.run(None, {key: value.numpy() for key, value in seen.items()})
    with torch.no_grad():
        assert np.abs(told - net(seen).numpy()).max() < 1e-5
