"""Policies on disk: a folder with `policy.json` and `weights.safetensors`, and no code in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import torch
from gymnasium import spaces

from wcsim.agents.envs.episode_view import trim_frame_window, window_observation_space
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.networks.encoder import (
    image_size_from_space,
    observation_form_from_space,
    vector_keys_from_space,
    vector_size_from_space,
    window_size_from_space,
)
from wcsim.agents.networks.names import NETWORK_NAMES, require_trusted_network
from wcsim.agents.networks.q_network import QNet
from wcsim.agents.networks.registry import NETWORKS
from wcsim.agents.perception.alarm import TWO_TICKS, AlarmState, next_alarm_state
from wcsim.agents.policy_api import CLASS_KEY, JOYSTICK_KEY, Observation
from wcsim.agents.runs.policy_file import SIGHT_KEYS, read_value_policy_file
from wcsim.agents.runs.weights import load_network, write_policy_folder
from wcsim.config import CameraConfig, RunConfig
from wcsim.config.run_file import QPolicyFile
from wcsim.core.reading import escape
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import count_imu_values, make_observation_space
from wcsim.types import F32, ClassId

_JOYSTICK_SIZE: Final = 2
# Measured: with 1, noise of the values warns in three times as many steps without danger.
_WARN_STEPS: Final = 3


def save_policy(
    folder: Path, model: SeqDQN, camera: CameraConfig, manifest_sha256: str = ""
) -> Path:
    """Save the network of a learner, see `write_policy_folder`."""
    space = model.observation_space
    sensors = {
        key: vector_size_from_space(space, (key,)) for key in vector_keys_from_space(space)[2:]
    }
    form = observation_form_from_space(space)
    about = {
        "algorithm": "SeqDQN",
        "net": model.q_net.spec.model_dump(),
        "image_hw_px": list(image_size_from_space(space)),
        "vector_size": vector_size_from_space(space),
        **({"sensors": sensors} if sensors else {}),
        **({"observation": form} if form != "compact" else {}),
        "window": window_size_from_space(space),
        "camera": camera.model_dump(mode="json"),
        "reward_scale": model.settings.reward_scale,
        "manifest_sha256": manifest_sha256,
    }
    return write_policy_folder(folder, model.q_net, about)


def load_policy(path: Path, network: str | None = None) -> _NetPolicy:
    """Load a policy folder.

    A network that is not registered is imported only when the caller names it
    (`network="module:Class"`): a policy from another party must not decide which code runs here.

    Raises PolicyError when a file is missing, damaged or does not fit.
    """
    file = read_value_policy_file(path)
    if file.net.network not in NETWORKS:
        require_trusted_network(escape(path), file.net.network, network)
    net = load_network(
        path, file.weights_sha256, lambda: _empty_net(file), own=file.net.network in NETWORK_NAMES
    )
    policy = _NetPolicy(net, path.name, file)
    for observation in _probes(file):
        policy.values(observation)
    return policy


def load_policy_for_config(
    folder: Path, name: str, config: RunConfig, network: str | None
) -> _NetPolicy:
    """A policy for one chair.

    Args:
        folder: Of the policy.
        name: How tables call it.
        config: Of the run in which it drives.
        network: See `load_policy`.

    Raises:
        PolicyError: It cannot be loaded, or was trained with other pictures, numbers or actions.
    """
    policy = load_policy(folder, network)
    camera, file = config.eye, policy.file
    # 1. Size of pictures, and the set of actions.
    size_px = (camera.height_px, camera.width_px)
    if file.image_hw_px != size_px or file.net.actions != config.env.actions:
        raise PolicyError(
            f"policy {name!r} needs {file.image_hw_px[1]}x{file.image_hw_px[0]} images and actions "
            f"{file.net.actions}; this test has {camera.width_px}x{camera.height_px} and "
            f"{config.env.actions}: test it alone"
        )
    # 2. Numbers from IMU and joystick, and those of further sensors.
    available = count_imu_values(config.env.observe_gyro, config.env.observe_yaw) + _JOYSTICK_SIZE
    needed = file.vector_size - sum(file.sensors.values())
    if needed != available:
        raise PolicyError(
            f"policy {name!r} needs {needed} numbers from IMU and joystick, this test gives "
            f"{available}: set env.observe_gyro and env.observe_yaw as in its training"
        )
    sensors = {key: len(measure.parts) for key, measure in config.sensors.measures().items()}
    if not file.sensors.items() <= sensors.items():
        raise PolicyError(
            f"policy {name!r} needs the sensors {file.sensors} (numbers of each), this test has "
            f"{sensors}: set their sections of [sensors] as in its training"
        )
    # 3. What the pictures hold. A policy of classes alone ignores colours beside them.
    trained, tested = file.observation, config.env.observation
    if trained != tested and (trained, tested) != ("compact", "compact_rgb"):
        raise PolicyError(
            f"policy {name!r} sees env.observation={trained}, this test has {tested}: set it as in "
            "its training"
        )
    other = [key for key in SIGHT_KEYS if getattr(file.camera, key) != getattr(camera, key)]
    if other or file.net.classes != config.env.classes:
        raise PolicyError(
            f"policy {name!r} was trained with another camera or other classes than this test has "
            f"({', '.join(other) or 'env.classes'} differ): test it alone"
        )
    policy.name = name
    return policy


class _NetPolicy:
    """A trained network that acts greedily.

    Of a longer window than its own it sees the newest images. One that carries a state does so from
    `act` to `act`, and begins anew with each episode.

    It warns by the value of the user's own stick, see `next_alarm_state`. A step of not following
    costs at most base reward and joystick penalty (3; a crash costs 100). A stick that is worth
    less than the best action by more than three such steps, in unscaled reward, leads to something
    worse: the network expects a crash or a jolt.
    """

    def __init__(self, net: QNet, name: str, file: QPolicyFile) -> None:
        self.net = net
        self.name = name
        self.file = file
        self.net.set_training_mode(False)
        prior = file.net.prior
        self._actions = action_set(file.net.actions)
        self.tolerated_loss = _WARN_STEPS * file.reward_scale * (prior.base + prior.penalty)
        self.reset()

    @property
    def warning(self) -> bool:
        """Whether the user's own stick is worth too little, as of the last `act`."""
        return self._alarm.on

    def begin(self) -> None:
        """Forget everything."""
        self.reset()

    def reset(self) -> None:
        """Forget the episode before."""
        self._state = self.net.begin(1)
        self._alarm = AlarmState()

    def act(self, observation: Observation) -> int:
        """The action of the highest value; a network with a state remembers the observation."""
        values, self._state = self._evaluate(observation)
        lost = float(values.max() - values[self._actions.nearest(observation[JOYSTICK_KEY])])
        self._alarm = next_alarm_state(self._alarm, float(lost > self.tolerated_loss), TWO_TICKS)
        return int(values.argmax())

    def values(self, observation: Observation) -> F32:
        """Values of all actions (A,), in units of the scaled reward; nothing is remembered.

        Raises PolicyError when the observation holds fewer images than the network was trained on,
        or the network leaves the finite numbers.
        """
        return self._evaluate(observation)[0]

    def _evaluate(self, observation: Observation) -> tuple[F32, torch.Tensor]:
        """Values of all actions (A,), and the state after this observation."""
        seen = trim_frame_window(observation, self.file.window)
        with torch.inference_mode():
            batch = {key: torch.as_tensor(np.asarray(value))[None] for key, value in seen.items()}
            if self.net.spec.stateful:
                found, after = self.net.step(batch, self._state)
            else:
                found, after = self.net(batch), self._state
            values = np.asarray(found[0].numpy(), np.float32)
        if not np.isfinite(values).all():
            raise PolicyError(
                f"policy {escape(self.name)!r} returns values that are not finite; train it again"
            )
        return values, after


def _empty_net(file: QPolicyFile) -> QNet:
    return QNet(_space(file), spaces.Discrete(len(action_set(file.net.actions))), file.net)


def _space(file: QPolicyFile) -> spaces.Dict:
    """The observations that a policy was trained with."""
    height, width = file.image_hw_px
    imu = file.vector_size - _JOYSTICK_SIZE - sum(file.sensors.values())
    boxes = {key: spaces.Box(-1.0, 1.0, (size,), np.float32) for key, size in file.sensors.items()}
    now = make_observation_space(file.observation, width, height, imu)
    return window_observation_space(spaces.Dict({**now.spaces, **boxes}), file.window)


def _probes(file: QPolicyFile) -> Iterator[Observation]:
    """What a usable network has values for: nothing seen, and every number at its largest."""
    for share in (0.0, 1.0):
        yield {
            key: np.full(
                box.shape,
                share * (ClassId.ROAD if key == CLASS_KEY else box.high.flat[0]),
                box.dtype,
            )
            for key, box in _space(file).spaces.items()
            if isinstance(box, spaces.Box)
        }
