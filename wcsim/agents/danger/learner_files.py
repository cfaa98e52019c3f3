"""A danger learner as files in a checkpoint's folder: its weights, and what its optimiser remembers of each."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from safetensors.torch import load_file, save_file

from wcsim.agents.danger.learner import DangerLearner
from wcsim.core import files
from wcsim.errors import PolicyError

STATE: Final = "state.json"  # beside them; each kind of run writes its own
_WEIGHTS, _MOMENTS = "weights.safetensors", "moments.safetensors"


def write_learner(folder: Path, learner: DangerLearner) -> dict[str, str]:
    """Write both files; their SHA-256 by name."""
    save_file({key: value.contiguous() for key, value in learner.net.state_dict().items()}, folder / _WEIGHTS)
    save_file(learner.moments(), folder / _MOMENTS)
    return {name: files.sha256(folder / name) for name in (_WEIGHTS, _MOMENTS)}


def require_whole(folder: Path, sha256: Mapping[str, str]) -> None:
    """Raise PolicyError unless both files are as they were written; OSError or KeyError where one is missing."""
    for name in (_WEIGHTS, _MOMENTS):
        if files.sha256(folder / name) != sha256[name]:
            raise PolicyError(f"{name} is damaged")


def read_learner(folder: Path, learner: DangerLearner, updates: int, loss: float) -> None:
    """Bring a learner to where it was after so many updates. Raises RuntimeError or KeyError when it is another one."""
    weights, moments = load_file(folder / _WEIGHTS), load_file(folder / _MOMENTS)
    learner.net.load_state_dict(weights)
    learner.restore(moments, updates, loss)
