"""Danger networks on disk: a folder with `policy.json` and `weights.safetensors`; nothing in it is code."""

from __future__ import annotations

from dataclasses import asdict, replace
from importlib import metadata
from pathlib import Path

import torch
from safetensors.torch import save_file

from wcsim.agents.danger.network import DangerNet, DangerSpec
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.danger.rule import DangerRule
from wcsim.agents.networks.weights import checked_weights, read_weights
from wcsim.agents.runs.policy_file import POLICY_JSON, read_danger_file
from wcsim.config import RunConfig
from wcsim.core import files
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import action_set

WEIGHTS = "weights.safetensors"
_CAMERA_KEYS = ("width_px", "height_px", "hfov_deg", "range_m", "near_m", "p_BC_m", "yaw_deg", "pitch_deg")


def save_danger(folder: Path, net: DangerNet, rule: DangerRule, config: RunConfig, manifest_sha256: str = "") -> Path:
    """Write a policy folder in one step, replacing an older one; returns the folder. Raises DiskFullError."""
    tensors = {key: value.detach().cpu().contiguous() for key, value in net.state_dict().items()}

    def fill(target: Path) -> None:
        save_file(tensors, target / WEIGHTS)
        data = {
            "schema_version": 1,
            "algorithm": "danger",
            "net": asdict(net.spec),
            "rule": asdict(rule),
            "camera": config.cameras[0].model_dump(mode="json"),
            "classes": config.env.classes,
            "chair": config.chair.model_dump(mode="json"),
            "manifest_sha256": manifest_sha256,
            "weights_sha256": files.sha256(target / WEIGHTS),
            "versions": {"torch": metadata.version("torch")},
        }
        files.write_json(target / POLICY_JSON, data)

    files.write_folder(folder, fill)
    return folder


def load_net(folder: Path) -> tuple[DangerNet, DangerRule]:
    """The network of a policy folder, and its rule. Raises PolicyError when a file is missing, damaged or unfit."""
    file = read_danger_file(folder)
    net = DangerNet(DangerSpec(**file.net.model_dump()), torch.as_tensor(action_set(file.net.actions).points))
    weights = folder / WEIGHTS
    data = read_weights(weights, file.weights_sha256, net.state_dict())
    net.load_state_dict(checked_weights(weights, data, net.state_dict()))
    net.train(False)
    return net.to(memory_format=torch.channels_last), DangerRule(**file.rule.model_dump())  # type: ignore[call-overload]


def load_danger(folder: Path, name: str, config: RunConfig, level: float | None = None) -> DangerPolicy:
    """A policy for one chair.

    Args:
        folder: Of the policy.
        name: How tables call it.
        config: Of the run in which it drives.
        level: Of assistance, a threshold of danger; None for the policy's own.

    Raises:
        PolicyError: It cannot be loaded, or was trained with another camera, class form or action set.
    """
    file = read_danger_file(folder)
    camera = config.cameras[0]
    other = [key for key in _CAMERA_KEYS if getattr(file.camera, key) != getattr(camera, key)]
    other += [key for key in ("actions",) if file.net.actions != config.env.actions]
    other += [key for key in ("classes",) if file.classes != config.env.classes]
    if other:
        raise PolicyError(
            f"policy {name!r} was trained with another camera, class form or action set ({', '.join(other)} differ): "
            "test it on its own"
        )
    net, rule = load_net(folder)
    return DangerPolicy(name, net, config, rule if level is None else replace(rule, threshold=level))
