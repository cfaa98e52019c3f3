"""A policy that somebody else trained, as a folder with an ONNX model: `policy.onnx` and `policy.toml`.

The model's inputs are named as the keys of an observation (`depth`, `seg`, `imu`, `joystick`, and those of sensors) and
have a first dimension of 1. Its first output (1, actions) holds a value for each action; the highest one is taken. An
input `state_X` is zero at the start of an episode and then what the output `next_state_X` was. An output `warning`
above 0.5 warns the user. ONNX: https://onnx.ai; the `onnx` extra brings its runtime.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.agents.policy_api import NotFinite, Observation
from wcsim.config import parse
from wcsim.config.run_file import OnnxPolicyFile
from wcsim.core.reading import FileKind, is_file, read_toml, shown
from wcsim.errors import ConfigError, PolicyError

MODEL_FILE: Final = "policy.onnx"
ABOUT_FILE: Final = "policy.toml"
_ABOUT: Final = FileKind(what="the policy.toml of an ONNX folder", limit_bytes=1 << 20)
_STATE, _NEXT, _WARNING = "state_", "next_", "warning"
_LIMIT_BYTES: Final = 1 << 30


def is_onnx_folder(path: Path) -> bool:
    """Whether a folder holds an ONNX model."""
    return is_file(path / MODEL_FILE)


def read_about(path: Path) -> OnnxPolicyFile:
    """Read `policy.toml` of such a folder; without one all is as in the preset `quick`. Raises PolicyError."""
    file = path / ABOUT_FILE
    if not is_file(file):
        return OnnxPolicyFile()
    try:
        return parse(OnnxPolicyFile, read_toml(file, _ABOUT), shown(file))
    except ConfigError as error:
        raise PolicyError(f"{error}; expected the keys preset and settings") from None


class OnnxPolicy:
    """Drives as the model says; on one core, so that the same model gives the same actions.

    Args:
        path: The folder.
        name: How tables call it.
        actions: How many actions there are.
    """

    def __init__(self, path: Path, name: str, actions: int) -> None:
        """Raises PolicyError when there is no such model, or it has other outputs than actions."""
        self.name, self._actions, self._warning = name, actions, False
        self._session = open_session(path / MODEL_FILE)
        self._inputs = {item.name: item for item in self._session.get_inputs()}
        self._outputs = [item.name for item in self._session.get_outputs()]
        for key in self._inputs:
            if key.startswith(_STATE) and f"{_NEXT}{key}" not in self._outputs:
                raise PolicyError(f"{shown(path)}: input {key!r} has no output {_NEXT + key!r}; expected one")
        self._state: dict[str, Any] = {}

    @property
    def warning(self) -> bool:
        """Whether the model warns, as of its last `act`."""
        return self._warning

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Every state is zero."""
        self._warning = False
        self._state = {
            key: np.zeros([size if isinstance(size, int) else 1 for size in item.shape], np.float32)
            for key, item in self._inputs.items()
            if key.startswith(_STATE)
        }

    def act(self, observation: Observation) -> int:
        """The action of the highest value. Raises PolicyError when the model cannot use the observation."""
        given = {key: self._state[key] if key in self._state else _fed(key, observation) for key in self._inputs}
        try:
            found = dict(zip(self._outputs, self._session.run(None, given), strict=True))
        except Exception as error:  # the runtime has a class of its own for each kind of mistake
            raise PolicyError(f"{self.name}: its model refuses the observation: {error}") from None
        values = np.asarray(found[self._outputs[0]]).reshape(-1)
        if values.shape != (self._actions,) or not np.isfinite(values).all():
            kind = PolicyError if values.shape != (self._actions,) else NotFinite
            raise kind(
                f"{self.name}: the model gives {values.shape[0]} values, {int(np.isnan(values).sum())} of them NaN; "
                f"expected {self._actions} finite ones: set env.actions in {ABOUT_FILE} as in its training"
            )
        self._state = {key: found[f"{_NEXT}{key}"] for key in self._state}
        self._warning = _WARNING in found and float(np.asarray(found[_WARNING]).reshape(-1)[0]) > 0.5
        return int(values.argmax())


def _fed(key: str, observation: Observation) -> Any:
    if key not in observation:
        raise PolicyError(f"the model wants an input {key!r}; this test observes {', '.join(sorted(observation))}")
    return np.ascontiguousarray(observation[key])[None]


def open_session(path: Path) -> Any:
    """A model in ONNX Runtime, on one core. Raises PolicyError when it cannot be loaded."""
    try:
        import onnxruntime
    except ImportError:
        raise PolicyError(
            f"{shown(path)} needs ONNX Runtime, which is not installed: pip install 'wcsim[onnx]'"
        ) from None
    if path.stat().st_size > _LIMIT_BYTES:
        raise PolicyError(f"{shown(path)} has {path.stat().st_size} bytes; expected at most {_LIMIT_BYTES}")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime has a class of its own for each kind of mistake
        raise PolicyError(f"{shown(path)} cannot be loaded: {error}; expected an ONNX model") from None
