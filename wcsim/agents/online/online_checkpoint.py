"""Checkpoints of a danger network that learns as it drives: plain arrays, counters, random states, data hashes.

All of a checkpoint is under a hash, its segments are in the data folder; one that is damaged in any place is passed
over for the one before it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.agents.collecting.data_folder import key_of
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.learner_files import STATE, read_learner, require_whole, write_learner
from wcsim.agents.learning.checkpoint import (
    Loaded,
    PassedOver,
    drop_old,
    generator_state,
    none_sound,
    passed_over,
    restored_generator,
)
from wcsim.agents.learning.checkpoint_file import (
    checked_generator,
    read_sealed,
    step_folders,
    step_in,
    step_name,
    whole_number,
    write_sealed,
)
from wcsim.agents.online.taught_ride import TaughtRide
from wcsim.core import files
from wcsim.core.reading import FileKind, shown
from wcsim.errors import PolicyError

_KIND: Final = FileKind(what="the state.json of a checkpoint", limit_bytes=64 << 20, error=PolicyError)
_SHA256: Final = re.compile(r"[0-9a-f]{64}", re.ASCII)
_KEYS: Final = frozenset(
    (
        *("step", "episodes", "crashes", "phase1_done", "updates", "loss"),
        *("segments", "explore_rng", "lectures_rng", "sha256"),
    )
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Counters:
    """How far a run has come."""

    step: int = 0
    episodes: int = 0
    crashes: int = 0
    phase1_done: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OnlineState:
    """All that a run goes on with, beside the network."""

    counters: Counters
    segments: dict[str, str]  # SHA-256 by file name
    explore_rng: np.random.Generator
    lectures_rng: np.random.Generator


def save_online(folder: Path, learner: DangerLearner, state: OnlineState) -> Path:
    """Write `folder/step-N`, whole or not at all, and drop all but the newest three. Raises DiskFullError."""
    counters = state.counters
    target = folder / step_name(counters.step)

    def fill(work: Path) -> None:
        sha256 = write_learner(work, learner)
        values = {
            "step": counters.step,
            "episodes": counters.episodes,
            "crashes": counters.crashes,
            "phase1_done": counters.phase1_done,
            "updates": learner.updates,
            "loss": learner.loss if learner.updates else None,
            "segments": state.segments,
            "explore_rng": generator_state(state.explore_rng),
            "lectures_rng": generator_state(state.lectures_rng),
            "sha256": sha256,
        }
        write_sealed(work / STATE, values)

    files.write_folder(target, fill)
    drop_old(folder, target)
    return target


def load_online(
    folder: Path, learner: DangerLearner, ride: TaughtRide, alive: Callable[[], object] = lambda: None
) -> tuple[OnlineState, Loaded] | None:
    """Bring a learner, and what it learns from, to the newest sound checkpoint of a run.

    None for a run that was ended before its first checkpoint: it begins again. `alive` is called now and then.

    Raises:
        PolicyError: There are checkpoints, and none is sound; they stay as they are.
    """
    passed: list[PassedOver] = []
    for path in reversed(step_folders(folder)):
        try:
            state, sealed = _restored(path, learner, ride, alive)
        except Exception as error:  # whatever is wrong with it, the one before may be sound
            passed.append(passed_over(path, error))
            continue
        return state, Loaded(path=path, extra={}, sealed=sealed, passed_over=tuple(passed))
    if passed:
        raise none_sound(folder, passed)
    return None


def _restored(
    path: Path, learner: DangerLearner, ride: TaughtRide, alive: Callable[[], object]
) -> tuple[OnlineState, bool]:
    """The state of a checkpoint, and whether it is sealed; all of it is read before the ride is changed."""
    told, sealed = read_sealed(path / STATE, _KIND, _KEYS)
    counters = Counters(
        step=step_in(path, told, "step"),
        episodes=whole_number(told, "episodes"),
        crashes=whole_number(told, "crashes"),
        phase1_done=_flag(told, "phase1_done"),
    )
    state = OnlineState(
        counters=counters,
        segments=_segments(told["segments"]),
        explore_rng=restored_generator(checked_generator(told, "explore_rng")),
        lectures_rng=restored_generator(checked_generator(told, "lectures_rng")),
    )
    updates, loss = whole_number(told, "updates"), _loss(told["loss"])
    require_whole(path, told["sha256"])
    read_learner(path, learner, updates, loss)
    ride.restore(state.segments, alive)
    return state, sealed


def _flag(told: dict[str, Any], key: str) -> bool:
    if type(told[key]) is not bool:
        raise PolicyError(f"{STATE}: {key} is {shown(told[key])}; expected true or false")
    return bool(told[key])


def _loss(told: Any) -> float:
    if told is not None and (type(told) is not float or told < 0.0):
        raise PolicyError(f"{STATE}: loss is {shown(told)}; expected a number from 0 on, or null before any update")
    return float("nan") if told is None else told


def _segments(told: Any) -> dict[str, str]:
    """Hashes by file name, of segments that are numbered from 0 on."""
    whole = isinstance(told, dict) and all(type(value) is str and _SHA256.fullmatch(value) for value in told.values())
    if not whole or sorted(key_of(name).index for name in told) != list(range(len(told))):
        raise PolicyError(f"{STATE}: segments are {shown(told)}; expected hashes of all, from the first one on")
    return dict(told)
