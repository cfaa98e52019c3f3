"""A danger learner after a round, as a folder of plain arrays; a run goes on from it to the same weights."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import torch
from safetensors.torch import load_file, save_file

from wcsim.agents.danger.learner import DangerLearner
from wcsim.core import files
from wcsim.core.reading import FileKind, is_file, read_json, shown
from wcsim.errors import PolicyError

_WEIGHTS, _MOMENTS, _STATE = "weights.safetensors", "moments.safetensors", "state.json"
_KIND: Final = FileKind(what="the state.json of a checkpoint", limit_bytes=1 << 20, error=PolicyError)


def checkpoint_path(folder: Path, number: int) -> Path:
    """Where the checkpoint after a round lies."""
    return folder / f"round-{number:03d}"


def save_round(folder: Path, number: int, learner: DangerLearner, segments: dict[str, str]) -> None:
    """Keep a learner after a round, whole or not at all. Raises DiskFullError."""

    def fill(target: Path) -> None:
        save_file({key: value.contiguous() for key, value in learner.net.state_dict().items()}, target / _WEIGHTS)
        save_file(learner.moments(), target / _MOMENTS)
        state = {
            "updates": learner.updates,
            "loss": learner.loss,
            "segments": segments,
            "sha256": {name: files.sha256(target / name) for name in (_WEIGHTS, _MOMENTS)},
        }
        files.write_json(target / _STATE, state)

    files.write_folder(checkpoint_path(folder, number), fill)


def newest_round(folder: Path) -> int:
    """The last round that is kept whole, -1 for none."""
    number = -1
    while _is_whole(checkpoint_path(folder, number + 1)):
        number += 1
    return number


def load_round(folder: Path, number: int, learner: DangerLearner) -> dict[str, str]:
    """Bring a learner to where it was after a round; the SHA-256 of the segments it had learned from, by file name.

    Raises:
        PolicyError: The checkpoint does not fit, or is damaged.
    """
    path = checkpoint_path(folder, number)
    state = read_json(path / _STATE, _KIND)
    try:
        learner.net.load_state_dict(load_file(path / _WEIGHTS))
        learner.restore(load_file(path / _MOMENTS), int(state["updates"]), float(state["loss"]))
        return {str(name): str(sha256) for name, sha256 in state["segments"].items()}
    except (RuntimeError, KeyError, ValueError, TypeError) as error:
        raise PolicyError(f"{shown(path)} does not fit this run ({error}); expected its own checkpoint") from None


def _is_whole(path: Path) -> bool:
    if not is_file(path / _STATE):
        return False
    try:
        told = read_json(path / _STATE, _KIND)["sha256"]
        return all(files.sha256(path / name) == told[name] for name in (_WEIGHTS, _MOMENTS))
    except (PolicyError, OSError, KeyError, TypeError):
        return False


def digest_of(net: torch.nn.Module) -> str:
    """SHA-256 over the weights of a network."""
    import hashlib

    text = hashlib.sha256()
    for name, value in sorted(net.state_dict().items()):
        text.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return text.hexdigest()
