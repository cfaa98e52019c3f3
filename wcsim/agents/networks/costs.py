"""What a network costs: parameters, multiplications, memory, time of a decision on one core."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn

from wcsim.agents.envs.episode_view import window_observation_space
from wcsim.agents.networks.q_network import QNet
from wcsim.agents.networks.registry import preferred_window_size
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, IMU_KEY, JOYSTICK_KEY
from wcsim.config.run_file import NetSpec
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import make_observation_space

LIMIT_MS: Final = 100.0  # for a decision: a tick of the paper
# Of it, for the network that makes the classes of a real camera's pictures.
RESERVE_MS: Final = 60.0
_WARM_UP: Final = 3  # calls that are not timed
Times = tuple[float, float]  # median and 99th percentile in ms


@dataclass(frozen=True, slots=True, kw_only=True)
class _NetworkCost:
    """One network at one size of pictures."""

    name: str
    window: int
    params: int
    macs: int  # multiplications and additions of one decision
    mb: float  # of weights, and of what one decision holds in memory at a time
    p50_ms: float
    p99_ms: float
    onnx_p50_ms: float | None  # by ONNX Runtime; None where that is not installed or cannot run it

    @property
    def within_100_ms(self) -> bool:
        """Whether a decision fits into a tick, with the reserve for the segmentation."""
        return self.p99_ms <= LIMIT_MS - RESERVE_MS


def measure_network_cost(
    name: str, height_px: int = 240, width_px: int = 320, runs: int = 30
) -> _NetworkCost:
    """Measure a network on one core of this machine. Raises PolicyError for an unknown name."""
    # 1. The network, and an observation for it.
    window = preferred_window_size(name)
    space = window_observation_space(make_observation_space("compact", width_px, height_px), window)
    actions = spaces.Discrete(len(action_set("square81")))
    net = QNet(space, actions, NetSpec(network=name))
    net.set_training_mode(False)
    seen = {
        CLASS_KEY: torch.full((1, window, height_px, width_px), 7, dtype=torch.uint8),
        DEPTH_KEY: torch.full((1, window, height_px, width_px), 90, dtype=torch.uint8),
        IMU_KEY: torch.zeros(1, 5),
        JOYSTICK_KEY: torch.zeros(1, 2),
    }
    # 2. What is counted.
    macs, held_bytes = _count_macs(net, seen)
    params = sum(value.numel() for value in net.parameters())
    # 3. What is timed, on one core.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        p50_ms, p99_ms = _time_calls(lambda: net(seen), runs)
        onnx_ms = _time_onnx(net, seen, runs)
    finally:
        torch.set_num_threads(threads)
    return _NetworkCost(
        name=name,
        window=window,
        params=params,
        macs=macs,
        mb=round((4 * params + held_bytes) / 1e6, 2),
        p50_ms=round(p50_ms, 3),
        p99_ms=round(p99_ms, 3),
        onnx_p50_ms=None if onnx_ms is None else round(onnx_ms, 3),
    )


def _time_calls(call: Callable[[], object], runs: int) -> Times:
    times_ms = []
    with torch.inference_mode():
        for number in range(_WARM_UP + runs):
            start_s = time.perf_counter()
            call()
            if number >= _WARM_UP:
                times_ms.append(1000.0 * (time.perf_counter() - start_s))
    return float(np.median(times_ms)), float(np.percentile(times_ms, 99))


def _count_macs(net: nn.Module, seen: dict[str, Tensor]) -> tuple[int, int]:
    """Multiplications of one call, and the bytes of the largest layer's output."""
    macs, largest = 0, 0

    def count(layer: nn.Module, given: Any, out: Any) -> None:
        nonlocal macs, largest
        result = out[0] if isinstance(out, tuple) else out
        largest = max(largest, result.numel() * result.element_size())
        if isinstance(layer, nn.Conv2d | nn.Conv3d):
            macs += (
                result.numel() * layer.in_channels // layer.groups * math.prod(layer.kernel_size)
            )
        elif isinstance(layer, nn.Linear):
            macs += result.numel() * layer.in_features
        elif isinstance(layer, nn.LSTM | nn.GRU):
            steps = given[0].shape[0] * given[0].shape[1]
            macs += steps * sum(
                weight.numel() for name, weight in layer.named_parameters() if "weight" in name
            )

    handles = [
        layer.register_forward_hook(count) for layer in net.modules() if not list(layer.children())
    ]
    with torch.inference_mode():
        net(seen)
    for handle in handles:
        handle.remove()
    return macs, largest


class _PositionalNet(nn.Module):
    """Calls a network, which takes a dict of tensors, with tensors by their position."""

    def __init__(self, net: nn.Module, keys: Sequence[str]) -> None:
        super().__init__()
        self.net, self.keys = net, tuple(keys)

    def forward(self, *tensors: Tensor) -> Tensor:
        """Values of all actions."""
        return torch.as_tensor(self.net(dict(zip(self.keys, tensors, strict=True))))


def _time_onnx(net: QNet, seen: dict[str, Tensor], runs: int) -> float | None:
    """Median of a decision by ONNX Runtime, in ms; None where it cannot run the network."""
    from wcsim.agents.networks.onnx_form import network_to_onnx

    keys = tuple(seen)
    try:
        model = network_to_onnx(_PositionalNet(net, keys), tuple(seen.values()), keys, ("values",))
    except PolicyError:
        return None
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    given = {key: value.numpy() for key, value in seen.items()}
    return _time_calls(lambda: session.run(None, given), runs)[0]
