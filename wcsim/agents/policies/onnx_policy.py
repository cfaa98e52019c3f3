"""A policy of another project: a folder with an ONNX model, `policy.onnx`, and `policy.toml`.

The model's inputs are named as the keys of an observation (`depth`, `seg`, `imu`, `joystick`, and
those of sensors) and have a first dimension of 1. Its first output (1, actions) holds a value for
each action; the highest one is taken. An input `state_X` is zero at the start of an episode, then
the last output `next_state_X`. An output `warning` above 0.5 warns the user. ONNX: https://onnx.ai.

A model is bounded: in bytes, in the memory of its arrays, and in the time to load and of each step.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from pathlib import Path
from threading import Thread
from typing import Any, Final

import numpy as np

from wcsim.agents.policy_api import (
    ANSWER_S,
    CLASS_KEY,
    DEPTH_KEY,
    MODEL_FILE,
    MOTION_SENSES,
    NotFinite,
    Observation,
)
from wcsim.config import RunConfig, parse
from wcsim.config.run_file import OnnxPolicySettings
from wcsim.core.reading import ONNX_TOML, escape, is_file, read_toml
from wcsim.errors import ConfigError, PolicyError
from wcsim.supervisor.actions import action_set

ABOUT_FILE: Final = "policy.toml"
_STATE: Final = "state_"
_NEXT: Final = "next_"
_WARNING: Final = "warning"
_LIMIT_BYTES: Final = 1 << 30  # of a model, and of its states
_MEMORY_BYTES: Final = 1 << 32  # of all arrays of a process's models
_STOP_S: Final = 5.0  # for a model to stop


def read_onnx_policy_file(path: Path) -> OnnxPolicySettings:
    """Read `policy.toml` of a folder; without one it is that of `quick`. Raises PolicyError."""
    file = path / ABOUT_FILE
    if not is_file(file):
        return OnnxPolicySettings()
    try:
        return parse(OnnxPolicySettings, read_toml(file, ONNX_TOML), escape(file))
    except ConfigError as error:
        raise PolicyError(f"{error}; expected the keys preset and settings") from None


class OnnxPolicy:
    """Runs a model; on one core, so that the same model gives the same actions.

    `warning` is whether it warned in its last `act`; a model without this output is no `Warns`.

    Args:
        path: The folder.
        name: In tables.
        actions: How many actions there are.
        model: Its file.
    """

    def __init__(self, path: Path, name: str, actions: int, model: str = MODEL_FILE) -> None:
        """Raises PolicyError when there is no such model, or it has other outputs than actions."""
        self.name = name
        self._actions = actions
        self._session = open_onnx_session(path / model)
        self._inputs = {item.name: item for item in self._session.get_inputs()}
        self._outputs = [item.name for item in self._session.get_outputs()]
        self._shapes = {
            key: [size if isinstance(size, int) else 1 for size in item.shape]
            for key, item in self._inputs.items()
            if key.startswith(_STATE)
        }
        for key in self._shapes:
            if f"{_NEXT}{key}" not in self._outputs:
                raise PolicyError(
                    f"{escape(path)}: input {escape(key, 40)!r} has no output "
                    f"{_NEXT + escape(key, 40)!r}; expected one"
                )
        size = 4 * sum(math.prod(shape) for shape in self._shapes.values())
        if size > _LIMIT_BYTES:
            raise PolicyError(
                f"{escape(path)}: its states have {size} bytes; expected at most {_LIMIT_BYTES}"
            )
        self.reset()

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Set every state to zero."""
        if _WARNING in self._outputs:
            self.warning = False
        self._state: dict[str, Any] = {
            key: np.zeros(shape, np.float32) for key, shape in self._shapes.items()
        }

    def act(self, observation: Observation) -> int:
        """The action of the highest value.

        Raises:
            PolicyError: The model cannot use the observation, returns something else, or needs more
                than `ANSWER_S`.
        """
        given = {
            key: self._state[key] if key in self._state else _input(key, item.shape, observation)
            for key, item in self._inputs.items()
        }
        try:
            found = self._run(given)
            values = np.asarray(found[self._outputs[0]], np.float64).reshape(-1)
            if _WARNING in found:
                self.warning = float(np.asarray(found[_WARNING]).reshape(-1)[0]) > 0.5
        except PolicyError:
            raise
        except Exception as error:  # the runtime has a class of its own for each kind of mistake
            raise PolicyError(
                f"{self.name}: its model refuses the observation: {escape(error)}"
            ) from None
        if values.shape != (self._actions,) or not np.isfinite(values).all():
            kind = PolicyError if values.shape != (self._actions,) else NotFinite
            raise kind(
                f"{self.name}: the model gives {values.shape[0]} values, "
                f"{int(np.isnan(values).sum())} of them NaN; expected {self._actions} finite ones: "
                f"set env.actions in {ABOUT_FILE} as in its training"
            )
        self._state = {key: found[f"{_NEXT}{key}"] for key in self._state}
        return int(values.argmax())

    def _run(self, given: dict[str, Any]) -> dict[str, Any]:
        import onnxruntime

        options = onnxruntime.RunOptions()
        values = _bounded(
            lambda: self._session.run(None, given, options),
            lambda: setattr(options, "terminate", True),
            f"{escape(self.name)}: its model gave no answer for {ANSWER_S:g} s; expected one a "
            "tick: make it faster",
        )
        return dict(zip(self._outputs, values, strict=True))


class ExportedDangerPolicy(OnnxPolicy):
    """A danger network of wcsim as it was exported, with its memory; it receives what was sent.

    Args:
        path: The folder.
        name: In tables.
        model: Its file.
        config: Of the chair that it drives.
    """

    def __init__(self, path: Path, name: str, model: str, config: RunConfig) -> None:
        """Raises PolicyError as `OnnxPolicy` does."""
        # It has kernels, which the checks of names must not load.
        from wcsim.core.joystick import shape_joysticks

        points = action_set(config.env.actions).points
        super().__init__(path, name, len(points), model)
        self.senses = MOTION_SENSES
        self._points = points
        self._commands = shape_joysticks(points, config.chair)

    def choose(self, observation: Observation) -> int:
        """The action of the highest value. Raises PolicyError."""
        return self.act(observation)

    def sent(self, action: int) -> None:
        """Put the executed action into the state, in place of the model's own choice."""
        self._state["state_waiting"][0, -1] = self._commands[action]
        self._state["state_sent"][0, 0] = self._points[action]
        self._state["state_last"][0, 0] = action + 1


def _bounded(work: Callable[[], Any], stop: Callable[[], None], late: str) -> Any:
    """The result of `work` within `ANSWER_S`; later a PolicyError with the text `late`.

    The runtime receives no signal, so it works in another thread. Ctrl-C, too, ends it by `stop`.
    """
    found = Future[Any]()

    def run() -> None:
        try:
            found.set_result(work())
        except Exception as error:  # raised again in the thread that waits
            found.set_exception(error)

    Thread(target=run, daemon=True).start()
    in_time = False
    try:
        in_time = bool(wait((found,), ANSWER_S).done)
    finally:
        if not in_time:
            stop()
            # A process that ends before the runtime has stopped would abort.
            wait((found,), _STOP_S)
    if not in_time:
        raise PolicyError(late)
    return found.result()


def _input(key: str, shape: Sequence[Any], observation: Observation) -> Any:
    """An input of that shape; of a window with more images than the model names, the newest."""
    if key not in observation:
        raise PolicyError(
            f"the model wants an input {escape(key, 40)!r}; this test observes "
            f"{', '.join(sorted(observation))}"
        )
    # With 0 the slice takes all images.
    pictured = key.rpartition("_")[2] in (CLASS_KEY, DEPTH_KEY) and len(shape) > 1
    images = shape[1] if pictured and isinstance(shape[1], int) else 0
    return np.ascontiguousarray(observation[key][-images:])[None]


def open_onnx_session(path: Path) -> Any:
    """A model in ONNX Runtime, on one core.

    Raises PolicyError when it cannot be loaded, or not within `ANSWER_S`.
    """
    import onnxruntime

    size = path.stat().st_size
    if size > _LIMIT_BYTES:
        raise PolicyError(f"{escape(path)} has {size} bytes; expected at most {_LIMIT_BYTES}")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    # A failure is raised; the log would show a model's own text unescaped.
    options.log_severity_level = 4
    memory = onnxruntime.OrtMemoryInfo(
        "Cpu", onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, onnxruntime.OrtMemType.DEFAULT
    )
    onnxruntime.create_and_register_allocator(
        memory, onnxruntime.OrtArenaCfg({"max_mem": _MEMORY_BYTES})
    )
    options.add_session_config_entry("session.use_env_allocators", "1")
    try:
        return _bounded(
            lambda: onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            ),
            lambda: options.set_load_cancellation_flag(True),
            f"{escape(path)} could not be loaded within {ANSWER_S:g} s; expected a smaller model",
        )
    except PolicyError:
        raise
    except Exception as error:  # the runtime has a class of its own for each kind of mistake
        raise PolicyError(
            f"{escape(path)} cannot be loaded: {escape(error)}; expected an ONNX model"
        ) from None
