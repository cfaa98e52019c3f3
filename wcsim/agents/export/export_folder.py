"""What the folder of an exported policy holds; which recordings and folders an export refuses."""

import json
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from wcsim.agents.export.guard import MEANING
from wcsim.agents.policies.onnx_policy import ABOUT_FILE
from wcsim.agents.policy_api import MODEL_FILE
from wcsim.agents.runs.policy_file import CAMERA_KEYS
from wcsim.config import RunConfig
from wcsim.core.reading import escape, is_folder
from wcsim.errors import ConfigError, PolicyError

REFERENCE: Final = "reference.npz"
LOOP: Final = "exported_policy.py"
# What `onnx_export.export_policy` writes; it does not read this list. A file that is missing here
# makes the next export into the same folder be refused.
WRITTEN: Final = (MODEL_FILE, ABOUT_FILE, MEANING, REFERENCE, LOOP)
# Beside these Python leaves its own folder, once the loop was imported.
_EXPECTED: Final = (*WRITTEN, "__pycache__")
_MOST_NAMED: Final = 3
_OTHER_KEYS: Final = (
    ("env", "actions"),
    ("env", "classes"),
    ("world", "tick_s"),
    ("env", "observe_gyro"),
    ("env", "observe_yaw"),
)


def find_differing_settings(own: RunConfig, other: RunConfig) -> list[str]:
    """The policy's settings of what it sees and can choose, where `other` has other ones.

    `other` is a recording to refuse, or the preset that policy.toml is laid over.
    """
    found: list[tuple[str, Any]] = []
    names = [eye.name for eye in own.eyes.values()]
    if len(names) > len(other.eyes):
        found.append(("env.camera", names))
    pairs = zip(own.eyes.values(), other.eyes.values(), strict=False)
    for number, (eye, seen) in enumerate(pairs):
        for key in CAMERA_KEYS:
            if getattr(eye, key) != getattr(seen, key):
                found.append((f"cameras.{number}.{key}", getattr(eye, key)))
    for name, sensor in own.sensors.on().items():
        if name not in other.sensors.on():
            # `typical` switches a sensor on with its defaults, which own values then replace.
            usual = type(sensor)()
            found.append((f"sensors.{name}", "typical"))
            found += [
                (f"sensors.{name}.{key}", value)
                for key, value in sensor
                if value != getattr(usual, key)
            ]
    own_json, other_json = own.model_dump(mode="json"), other.model_dump(mode="json")
    for section, key in _OTHER_KEYS:
        if own_json[section][key] != other_json[section][key]:
            found.append((f"{section}.{key}", own_json[section][key]))
    return format_setting_overrides(found)


def format_setting_overrides(settings: Iterable[tuple[str, Any]]) -> list[str]:
    """Settings as `--set` takes them.

    >>> format_setting_overrides([("world.tick_s", 0.1), ("env.classes", "wcsim")])
    ['world.tick_s=0.1', 'env.classes=wcsim']
    """
    return [
        f"{name}={value if isinstance(value, str) else json.dumps(value)}"
        for name, value in settings
    ]


def require_matching_recording(
    recorded: RunConfig, own: RunConfig, file: Path, policy: str
) -> None:
    """Refuse a recording that shows a network other inputs than its training did, or too few.

    Args:
        recorded: Settings of the recording.
        own: Settings that fit the policy, with its senses.
        file: The recording.
        policy: The network's name.

    Raises:
        PolicyError: With all settings that a new recording needs.
    """
    settings = find_differing_settings(own, recorded)
    if settings:
        options = " ".join(f"--set {shlex.quote(setting)}" for setting in settings)
        raise PolicyError(
            f"{escape(file)} lacks inputs of {escape(policy)}; expected a recording with "
            f"{', '.join(settings)}: record it again with the same command and {options}, or with "
            f"wcsim drive --policy {shlex.quote(policy)} --record FILE, which needs no settings"
        )


def require_replaceable_folder(option: str, folder: Path) -> None:
    """Refuse a folder with files that no export wrote, since an export replaces all of it.

    Raises:
        ConfigError: There are such files.
    """
    if not is_folder(folder):
        return
    others = sorted(path.name for path in folder.iterdir() if path.name not in _EXPECTED)
    if others:
        named = ", ".join(escape(name, 80) for name in others[:_MOST_NAMED])
        more = " and more" if len(others) > _MOST_NAMED else ""
        raise ConfigError(
            f"{option} {escape(folder)} holds {named}{more}, which is not from an export; "
            "expected a new folder, or an earlier export, which is replaced: choose another one"
        )
