"""A danger learner as files in a checkpoint's folder: its weights, and what its optimiser remembers of each."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from safetensors.torch import load, save_file

from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.networks.weights import checked_weights
from wcsim.core import files
from wcsim.core.reading import FileKind, escaped, read_bytes, regular_size
from wcsim.errors import PolicyError

STATE: Final = "state.json"  # beside them; each kind of run writes its own
_WEIGHTS, _MOMENTS = "weights.safetensors", "moments.safetensors"
_KIND: Final = FileKind(what="the arrays of a danger network", limit_bytes=1 << 30, error=PolicyError)


def write_learner(folder: Path, learner: DangerLearner) -> dict[str, str]:
    """Write both files; their SHA-256 by name."""
    save_file({key: value.contiguous() for key, value in learner.net.state_dict().items()}, folder / _WEIGHTS)
    save_file(learner.moments(), folder / _MOMENTS)
    return {name: files.sha256(folder / name) for name in (_WEIGHTS, _MOMENTS)}


def require_whole(folder: Path, sha256: Mapping[str, str]) -> None:
    """Raise PolicyError unless both files are as they were written; KeyError where one has no hash."""
    for name in (_WEIGHTS, _MOMENTS):
        regular_size(folder / name, _KIND)
        if files.sha256(folder / name) != sha256[name]:
            raise PolicyError(f"{name} is damaged")


def read_learner(folder: Path, learner: DangerLearner, updates: int, loss: float) -> None:
    """Bring a learner to where it was after so many updates. Raises PolicyError when it is another one."""
    weights, moments = (read_bytes(folder / name, _KIND) for name in (_WEIGHTS, _MOMENTS))
    learner.net.load_state_dict(checked_weights(folder / _WEIGHTS, weights, learner.net.state_dict()))
    try:
        learner.restore(load(moments), updates, loss)
    except Exception as error:  # of safetensors or PyTorch, by what is wrong with the bytes
        raise PolicyError(f"{escaped(folder)} does not fit this run ({escaped(error)}); expected its own one") from None
