"""What an exported policy's folder holds, and what is refused: another's folder, a recording that lacks inputs."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from wcsim.agents.export.guard import MEANING
from wcsim.agents.policies.onnx_policy import ABOUT_FILE
from wcsim.agents.policy_api import MODEL_FILE
from wcsim.agents.runs.policy_file import SIGHT_KEYS
from wcsim.config import RunConfig
from wcsim.core.reading import escaped, is_folder
from wcsim.errors import ConfigError, PolicyError

_CAMERA: Final = ("width_px", "height_px", *SIGHT_KEYS)
_OTHERS: Final = (
    *(("env", "actions"), ("env", "classes"), ("world", "tick_s")),
    *(("env", "observe_gyro"), ("env", "observe_yaw")),
)
REFERENCE, LOOP = "reference.npz", "exported_policy.py"
WRITTEN: Final = (MODEL_FILE, ABOUT_FILE, MEANING, REFERENCE, LOOP)
_MOST_NAMED: Final = 3


def settings_apart(own: RunConfig, other: RunConfig) -> list[str]:
    """The settings of what a network sees and can choose, as far as another configuration has others."""
    mine, others = own.model_dump(mode="json"), other.model_dump(mode="json")
    there = other.sensors.on()
    camera, usual = own.eye, other.eye
    seen = {key: getattr(camera, key) for key in _CAMERA}
    told = [
        (f"cameras.0.{key}", value) for key, value in seen.items() if value != getattr(usual, key)
    ]
    for name, sensor in own.sensors.on().items():
        if name not in there:
            told += [(f"sensors.{name}", "typical")]
            told += [
                (f"sensors.{name}.{key}", value)
                for key, value in sensor
                if value != getattr(type(sensor)(), key)
            ]
    told += [
        (f"{part}.{key}", mine[part][key])
        for part, key in _OTHERS
        if mine[part][key] != others[part][key]
    ]
    return as_words(told)


def as_words(told: Iterable[tuple[str, Any]]) -> list[str]:
    """Settings as words.

    >>> as_words([("world.tick_s", 0.1), ("env.classes", "wcsim")])
    ['world.tick_s=0.1', 'env.classes=wcsim']
    """
    return [
        f"{name}={value if isinstance(value, str) else json.dumps(value)}" for name, value in told
    ]


def require_shown(recorded: RunConfig, own: RunConfig, file: Path, policy: str) -> None:
    """Refuse a recording in which a network would see another street than it knows, or lack a sense.

    Args:
        recorded: Settings of the recording.
        own: Those that fit the policy, with its senses.
        file: The recording.
        policy: The network's name.

    Raises:
        PolicyError: With all that has to be set when it is recorded again.
    """
    words = settings_apart(own, recorded)
    if words:
        typed = " ".join(f"--set {shlex.quote(word)}" for word in words)
        raise PolicyError(
            f"{escaped(file)} lacks inputs of {escaped(policy)}; expected a recording with "
            f"{', '.join(words)}: record it again with the same command and {typed}, or with "
            f"wcsim drive --policy {shlex.quote(policy)} --record FILE, which needs no settings"
        )


def require_export_place(option: str, folder: Path) -> None:
    """Refuse a folder that holds what no export wrote, for an export takes its whole place. Raises ConfigError."""
    expected = (*WRITTEN, "__pycache__")  # Python's, once the loop was imported
    others = (
        sorted(path.name for path in folder.iterdir() if path.name not in expected)
        if is_folder(folder)
        else []
    )
    if others:
        named = ", ".join(escaped(name, 80) for name in others[:_MOST_NAMED]) + " and more" * (
            len(others) > _MOST_NAMED
        )
        raise ConfigError(
            f"{option} {escaped(folder)} holds {named}, which is not from an export; expected a new folder, or an "
            "earlier export, which is replaced: choose another one"
        )
