"""Danger networks on disk: a folder with `policy.json` and `weights.safetensors`; nothing in it is code."""

from __future__ import annotations

from pathlib import Path

from wcsim.agents.danger.network import DangerNet, channels_last
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.networks.names import NETWORK_NAMES, require_named
from wcsim.agents.runs.policy_file import SIGHT_KEYS, read_danger_file
from wcsim.agents.runs.weights import load_network, write_policy
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerRule
from wcsim.core.reading import escaped
from wcsim.errors import PolicyError


def save_danger(folder: Path, net: DangerNet, rule: DangerRule, config: RunConfig, manifest_sha256: str = "") -> Path:
    """See `write_policy`."""
    said = {
        "algorithm": "danger",
        "net": net.spec.net.model_dump(),
        "rule": rule.model_dump(),
        "camera": config.cameras[0].model_dump(mode="json"),
        "classes": config.env.classes,
        "chair": config.chair.model_dump(mode="json"),
        "manifest_sha256": manifest_sha256,
    }
    return write_policy(folder, net, said)


def load_net(folder: Path, network: str | None = None) -> tuple[DangerNet, DangerRule]:
    """The network of a policy folder, and its rule.

    Args:
        folder: Of the policy.
        network: Somebody's own class that may be loaded to look at pictures, `module:Class`.

    Raises:
        PolicyError: A file is missing, damaged or unfit, or the policy has a class of its own that was not named.
    """
    file = read_danger_file(folder)
    if file.net.eye != "map" and file.net.network not in NETWORK_NAMES:
        require_named(escaped(folder), file.net.network, network)
    net = load_network(folder, file.weights_sha256, lambda: DangerNet(file))
    net.train(False)
    return channels_last(net), file.rule


def load_danger(
    folder: Path, name: str, config: RunConfig, level: float | None = None, network: str | None = None
) -> DangerPolicy:
    """A policy for one chair.

    Args:
        folder: Of the policy.
        name: How tables call it.
        config: Of the run in which it drives.
        level: Of assistance, a threshold of danger; None for the policy's own.
        network: See `load_net`.

    Raises:
        PolicyError: It cannot be loaded, or was trained with another camera, class form or action set.
    """
    require_same_senses(folder, name, config)
    net, rule = load_net(folder, network)
    return DangerPolicy(name, net, config, rule if level is None else rule.model_copy(update={"threshold": level}))


def require_same_senses(folder: Path, name: str, config: RunConfig) -> None:
    """Refuse a policy that was trained with another camera, class form or action set. Raises PolicyError."""
    file = read_danger_file(folder)
    camera = config.cameras[0]
    other = [key for key in ("width_px", "height_px", *SIGHT_KEYS) if getattr(file.camera, key) != getattr(camera, key)]
    other += [key for key in ("actions",) if file.net.actions != config.env.actions]
    other += [key for key in ("classes",) if file.classes != config.env.classes]
    if other:
        raise PolicyError(
            f"policy {name!r} was trained with another camera, class form or action set ({', '.join(other)} differ): "
            "set these as in its training, or test it on its own"
        )
