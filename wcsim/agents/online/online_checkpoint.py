"""Checkpoints of a danger network that learns as it drives: plain arrays, counters, random states, data hashes."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.learner_files import STATE, read_learner, require_whole, write_learner
from wcsim.agents.learning.checkpoint import PassedOver, generator_state, none_sound, restored_generator
from wcsim.agents.learning.checkpoint_file import KEEP, step_folders, step_name
from wcsim.core import files
from wcsim.core.reading import FileKind, read_json, shown
from wcsim.errors import PolicyError

_KIND: Final = FileKind(what="the state.json of a checkpoint", limit_bytes=64 << 20, error=PolicyError)


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
        files.write_json(work / STATE, values)

    files.write_folder(target, fill)
    for old in step_folders(folder)[:-KEEP]:
        if old != target:
            shutil.rmtree(old, ignore_errors=True)
    return target


def load_online(folder: Path, learner: DangerLearner) -> tuple[OnlineState | None, tuple[PassedOver, ...]]:
    """Bring a learner to its newest sound checkpoint; also those that are not sound, newest first.

    None for a run that was ended before its first checkpoint: it begins again.

    Raises:
        PolicyError: There are checkpoints, and none is sound; they stay as they are.
    """
    passed: list[PassedOver] = []
    for path in reversed(step_folders(folder)):
        try:
            return _restored(path, learner), tuple(passed)
        except (PolicyError, OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            passed.append(PassedOver(path=path, reason=shown(f"{type(error).__name__}: {error}", 300)))
    if passed:
        raise none_sound(folder, passed)
    return None, ()


def _restored(path: Path, learner: DangerLearner) -> OnlineState:
    told: dict[str, Any] = read_json(path / STATE, _KIND)
    require_whole(path, told["sha256"])
    counters = Counters(
        step=int(told["step"]),
        episodes=int(told["episodes"]),
        crashes=int(told["crashes"]),
        phase1_done=bool(told["phase1_done"]),
    )
    state = OnlineState(
        counters=counters,
        segments={str(name): str(sha256) for name, sha256 in told["segments"].items()},
        explore_rng=restored_generator(told["explore_rng"]),
        lectures_rng=restored_generator(told["lectures_rng"]),
    )
    loss = float("nan") if told["loss"] is None else float(told["loss"])
    read_learner(path, learner, int(told["updates"]), loss)
    return state
