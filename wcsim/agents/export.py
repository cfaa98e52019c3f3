"""Policies on disk: a folder with `policy.json` and `weights.safetensors`; nothing in it is code."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from wcsim.agents import files, registry
from wcsim.agents.networks import image_size, vector_size, window_size
from wcsim.agents.policy import FollowPrior, NetSpec, QNet, spec_to_json
from wcsim.agents.policy_file import POLICY_JSON, read_policy_file
from wcsim.agents.protocol import Observation
from wcsim.agents.seqdqn import SeqDQN
from wcsim.agents.window import newest
from wcsim.config import CameraConfig, PolicyFile
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import action_set

WEIGHTS = "weights.safetensors"
MAX_WEIGHTS_BYTES = 1 << 30
JOYSTICK_SIZE = 2


class NetPolicy:
    """A trained network that acts greedily; of a longer window than its own it sees the newest images."""

    def __init__(self, net: QNet, name: str, file: PolicyFile) -> None:
        self.net = net
        self.name = name
        self.file = file
        self.net.set_training_mode(False)

    def begin(self) -> None:
        """Nothing is remembered between steps."""

    def reset(self) -> None:
        """Nothing is remembered between steps."""

    def act(self, observation: Observation) -> int:
        """The action of the highest value."""
        return int(self.values(observation).argmax())

    def values(self, observation: Observation) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Values of all actions (A,), in units of the scaled reward.

        Raises PolicyError when the observation holds fewer images than the network was trained on.
        """
        seen = newest(observation, self.file.window)
        with torch.inference_mode():
            batch = {key: torch.as_tensor(np.asarray(value))[None] for key, value in seen.items()}
            return np.asarray(self.net(batch)[0].numpy(), dtype=np.float32)


def save_policy(folder: Path, model: SeqDQN, camera: CameraConfig, manifest_sha256: str = "") -> Path:
    """Write a policy folder in one step, replacing an older one; returns the folder."""
    net = model.q_net
    tensors = {key: value.detach().cpu().contiguous() for key, value in net.state_dict().items()}

    def fill(target: Path) -> None:
        save_file(tensors, target / WEIGHTS)
        digest = files.sha256(target / WEIGHTS)
        files.write_json(target / POLICY_JSON, _describe(model, camera, manifest_sha256, digest))

    files.write_folder(folder, fill)
    return folder


def load_policy(path: Path, network: str | None = None) -> NetPolicy:
    """Load a policy folder.

    A network that is not registered is imported only when the caller names it (`network="module:Class"`): a policy from
    somebody else must not decide which code runs here.

    Raises PolicyError when a file is missing, damaged or does not fit.
    """
    file = read_policy_file(path)
    spec = _spec(file, network)
    weights = path / WEIGHTS
    if not weights.is_file() or weights.stat().st_size > MAX_WEIGHTS_BYTES:
        raise PolicyError(f"{weights} is missing or larger than {MAX_WEIGHTS_BYTES} bytes; copy the policy again")
    found = files.sha256(weights)
    if found != file.weights_sha256:
        raise PolicyError(
            f"{weights} has SHA-256 {found[:12]}..., policy.json says {file.weights_sha256[:12]}...: "
            "the file was damaged or exchanged; copy the whole policy folder again"
        )
    net = _empty_net(file, spec)
    try:
        tensors = load_file(weights)
    except SafetensorError as error:
        raise PolicyError(f"{weights} is not a safetensors file: {error}") from error
    _check_shapes(weights, tensors, net)
    net.load_state_dict(tensors)
    return NetPolicy(net, path.name, file)


def _describe(model: SeqDQN, camera: CameraConfig, manifest_sha256: str, weights_sha256: str) -> dict[str, Any]:
    spec = model.q_net.spec
    return {
        "schema_version": 1,
        "algorithm": "SeqDQN",
        "net": spec_to_json(spec),
        "image_hw_px": list(image_size(model.observation_space)),
        "vector_size": vector_size(model.observation_space),
        "window": window_size(model.observation_space),
        "camera": camera.model_dump(mode="json"),
        "reward_scale": model.settings.reward_scale,
        "manifest_sha256": manifest_sha256,
        "weights_sha256": weights_sha256,
        "versions": {name: metadata.version(name) for name in ("torch", "stable-baselines3")},
    }


def _spec(file: PolicyFile, network: str | None) -> NetSpec:
    name = file.net.network
    if not registry.is_registered(name) and network != name:
        raise PolicyError(
            f"this policy uses the network {name!r}, which is not one of wcsim's; loading it runs its code: "
            f"name it yourself (network={name}) if you trust it"
        )
    plain = file.net.model_dump()
    prior = FollowPrior(**plain.pop("prior"))
    return NetSpec(**plain, prior=prior)


def _empty_net(file: PolicyFile, spec: NetSpec) -> QNet:
    height, width = file.image_hw_px
    image = spaces.Box(0, 255, (file.window, height, width), np.uint8)
    space = spaces.Dict(
        seg=image,
        depth=image,
        imu=spaces.Box(-1.0, 1.0, (file.vector_size - JOYSTICK_SIZE,), np.float32),
        joystick=spaces.Box(-1.0, 1.0, (JOYSTICK_SIZE,), np.float32),
    )
    return QNet(space, spaces.Discrete(len(action_set(spec.actions))), spec)


def _check_shapes(path: Path, tensors: dict[str, torch.Tensor], net: QNet) -> None:
    expected = {key: tuple(value.shape) for key, value in net.state_dict().items()}
    got = {key: tuple(value.shape) for key, value in tensors.items()}
    if got == expected:
        finite = all(bool(torch.isfinite(value).all()) for value in tensors.values())
        if not finite:
            raise PolicyError(f"{path} holds numbers that are not finite; train this policy again")
        return
    odd = sorted(key for key in expected.keys() | got.keys() if expected.get(key) != got.get(key))
    first = odd[0]
    raise PolicyError(
        f"{path} does not fit the network {net.spec.network!r}: {first} is {got.get(first, 'missing')}, "
        f"expected {expected.get(first, 'nothing')} ({len(odd)} tensors differ); use the network it was trained with"
    )
