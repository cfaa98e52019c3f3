"""A checkpoint's folder and its `state.json`: names, order, hashes and bounds, without a look at the arrays."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wcsim.core import files
from wcsim.core.reading import FileKind, escaped, read_json, regular_size
from wcsim.errors import PolicyError

STATE, MODEL, REPLAY = "state.json", "model.safetensors", "replay.safetensors"
SCHEMA = 2  # 1 had no seal
MOST_STEPS = 10**12  # of a run
KEEP = 3  # checkpoints of a run
_STEP = re.compile(r"step-(\d{8,18})")
_KEYS = frozenset(("num_timesteps", "n_updates", "episodes", "explore_rng", "replay_rng", "extra", "sha256"))
_STATE_KIND = FileKind(what="the state of a checkpoint", limit_bytes=1 << 20, error=PolicyError)
_ARRAYS_KIND = FileKind(what="the arrays of a checkpoint", limit_bytes=1 << 42, error=PolicyError)
_GENERATOR = {"counter": (4, 64), "key": (2, 64), "buffer": (4, 64)}  # how many numbers of so many bits


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """The checked contents of `state.json`."""

    num_timesteps: int
    n_updates: int
    episodes: int
    explore_rng: dict[str, Any]  # see `checkpoint.generator_state`
    replay_rng: dict[str, Any]
    extra: dict[str, int | float | str | bool]
    sealed: bool  # False for one of an older version, whose values have no hash


def step_name(step: int) -> str:
    """The name of the checkpoint of a step; their order as text is not that of their steps.

    >>> step_name(5000), step_name(100_000_000)
    ('step-00005000', 'step-100000000')
    """
    return f"step-{step:08d}"


def step_folders(folder: Path) -> list[Path]:
    """The checkpoints of a run, oldest first: real folders with exactly such a name; whatever else is there is not."""
    found = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                match = _STEP.fullmatch(entry.name)
                if match and entry.name == step_name(int(match[1])) and entry.is_dir(follow_symlinks=False):
                    found.append(folder / entry.name)
    except OSError:
        return []
    return sorted(found, key=step_of)


def left_behind(folder: Path) -> list[Path]:
    """What processes that were killed while they wrote a checkpoint have left of it; only who holds the run may ask."""
    begun = (
        path for path in folder.iterdir() if files.is_begun(path) and _STEP.fullmatch(path.name[1:].partition(".")[0])
    )
    return [path for path in begun if path.is_dir() and not path.is_symlink()]


def step_of(path: Path) -> int:
    """The step of a checkpoint's folder."""
    return int(path.name.removeprefix("step-"))


def _write_sealed(path: Path, values: Mapping[str, Any]) -> None:
    """Write the values of a checkpoint, with its version and a hash over all of it."""
    files.write_sealed_json(path, {"schema_version": SCHEMA, **values})


def _read_sealed(path: Path, kind: FileKind, keys: frozenset[str]) -> tuple[dict[str, Any], bool]:
    """What `_write_sealed` wrote, and whether it has a hash; one of a version before there was one has none.

    Raises:
        PolicyError: It is not what was written, or has other entries than `keys`.
    """
    data = read_json(path, kind)
    sealed = files.take_seal(data, STATE)
    schema = data.pop("schema_version", 1)
    if type(schema) is not int or schema not in (1, SCHEMA):
        raise PolicyError(f"{STATE} is of version {escaped(schema)}; expected 1 or {SCHEMA}")
    if set(data) != keys or sealed != (schema == SCHEMA):
        raise PolicyError(f"{STATE} has the keys {escaped(sorted(data))}; it is damaged")
    return data, sealed


def write_state(folder: Path, values: Mapping[str, Any], replay_sha256: str = "") -> None:
    """Write `state.json` with hashes of the files that are there, and one over itself; the replay's may be known."""
    hashes = {MODEL: files.sha256(folder / MODEL), REPLAY: replay_sha256 or files.sha256(folder / REPLAY)}
    _write_sealed(folder / STATE, {**values, "sha256": hashes})


def read_state(folder: Path) -> State:
    """The state of a checkpoint whose files are as they were written. Raises PolicyError with what is not."""
    data, sealed = _read_sealed(folder / STATE, _STATE_KIND, _KEYS)
    state = State(
        num_timesteps=_step_in(folder, data, "num_timesteps"),
        n_updates=_whole_number(data, "n_updates"),
        episodes=_whole_number(data, "episodes"),
        explore_rng=_checked_generator(data, "explore_rng"),
        replay_rng=_checked_generator(data, "replay_rng"),
        extra=_extra(data["extra"]),
        sealed=sealed,
    )
    _check_hashes(folder, data["sha256"])
    return state


def replay_hash(folder: Path) -> str:
    """The hash that a checkpoint has of its replay, not compared with it; "" where it has none."""
    try:
        data, _ = _read_sealed(folder / STATE, _STATE_KIND, _KEYS)
        return str(data["sha256"][REPLAY])
    except (PolicyError, TypeError, KeyError):
        return ""


def _step_in(folder: Path, data: Mapping[str, Any], key: str) -> int:
    """The step that a checkpoint is of. Raises PolicyError when its folder has the name of another one."""
    step = _whole_number(data, key)
    if folder.name != step_name(step):
        raise PolicyError(f"{STATE} is of step {step}; expected that of its folder's name")
    return step


def _check_hashes(folder: Path, hashes: Any) -> None:
    if not isinstance(hashes, dict) or set(hashes) != {MODEL, REPLAY}:
        raise PolicyError(f"{STATE} has hashes of {escaped(hashes)}; expected those of {MODEL} and {REPLAY}")
    for name in (MODEL, REPLAY):
        regular_size(folder / name, _ARRAYS_KIND)
        if files.sha256(folder / name) != hashes[name]:
            raise PolicyError(f"{name} is damaged")


def _whole_number(data: Mapping[str, Any], key: str) -> int:
    """A count of a checkpoint. Raises PolicyError when it is none."""
    value = data[key]
    if type(value) is not int or not 0 <= value <= MOST_STEPS:
        raise PolicyError(f"{STATE}: {key} is {escaped(value)}; expected a number from 0 to {MOST_STEPS}")
    return value


def _extra(data: Any) -> dict[str, int | float | str | bool]:
    if not isinstance(data, dict) or not all(type(value) in (int, float, str, bool) for value in data.values()):
        raise PolicyError(f"{STATE}: extra is {escaped(data)}; expected names with plain values")
    flags = [data.get(name, False) for name in ("phase1_done", "q_alarm", "owes_updates")]
    crashes = data.get("crashes", 0)
    if type(crashes) is not int or crashes < 0 or not all(type(flag) is bool for flag in flags):
        raise PolicyError(f"{STATE}: extra is {escaped(data)}; expected a count of crashes, and flags")
    return data


def _checked_generator(values: Mapping[str, Any], key: str) -> dict[str, Any]:
    """The state of a Philox generator, every number in its bounds. Raises PolicyError when it is none."""
    data = values[key]
    wrong = PolicyError(f"{STATE}: {key} is {escaped(data)}; expected the state of a generator")
    if not isinstance(data, dict) or set(data) != {*_GENERATOR, "buffer_pos", "has_uint32", "uinteger"}:
        raise wrong
    for name, (length, bits) in _GENERATOR.items():
        if not isinstance(data[name], list) or len(data[name]) != length or not all(_bits(v, bits) for v in data[name]):
            raise wrong
    size = np.random.Philox().state["buffer"].size
    if not _bits(data["buffer_pos"], 8) or data["buffer_pos"] > size or not _bits(data["has_uint32"], 1):
        raise wrong
    if not _bits(data["uinteger"], 32):
        raise wrong
    return data


def _bits(value: Any, bits: int) -> bool:
    return type(value) is int and 0 <= value < 1 << bits
