"""A danger learner after a round, as a folder of plain arrays; a run goes on from it to the same weights."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import torch

from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.learner_files import STATE, read_learner, require_whole, write_learner
from wcsim.core import files
from wcsim.core.reading import FileKind, is_file, read_json, shown
from wcsim.errors import PolicyError

_SEGMENT: Final = re.compile(r"[0-9]+-[0-9]{3,}-[0-9]{4,}\.npz\.zst", re.ASCII)
_KIND: Final = FileKind(what="the state.json of a checkpoint", limit_bytes=64 << 20, error=PolicyError)


def checkpoint_path(folder: Path, number: int) -> Path:
    """Where the checkpoint after a round lies."""
    return folder / f"round-{number:03d}"


def save_round(folder: Path, number: int, learner: DangerLearner, segments: dict[str, str]) -> None:
    """Keep a learner after a round, whole or not at all. Raises DiskFullError."""

    def fill(target: Path) -> None:
        sha256 = write_learner(target, learner)
        state = {
            "updates": learner.updates,
            "loss": learner.loss,
            "segments": segments,
            "sha256": sha256,
        }
        files.write_json(target / STATE, state)

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
    state = read_json(path / STATE, _KIND)
    try:
        read_learner(path, learner, int(state["updates"]), float(state["loss"]))
        segments = {str(name): str(sha256) for name, sha256 in state["segments"].items()}
    except (RuntimeError, KeyError, ValueError, TypeError) as error:
        raise PolicyError(f"{shown(path)} does not fit this run ({error}); expected its own checkpoint") from None
    other = next((name for name in segments if _SEGMENT.fullmatch(name) is None), None)
    if other is not None:
        raise PolicyError(f"{shown(path)} names the segment {shown(other)!r}; expected its own checkpoint")
    return segments


def in_order(segments: Iterable[str]) -> list[str]:
    """Names of segments in the order in which a run learns from them: round by round.

    >>> in_order(["3-1000-0000.npz.zst", "3-999-0001.npz.zst", "3-999-0000.npz.zst"])
    ['3-999-0000.npz.zst', '3-999-0001.npz.zst', '3-1000-0000.npz.zst']
    """
    return sorted(segments, key=lambda name: (int(name.split("-")[1]), name))


def _is_whole(path: Path) -> bool:
    if not is_file(path / STATE):
        return False
    try:
        require_whole(path, read_json(path / STATE, _KIND)["sha256"])
    except (PolicyError, OSError, KeyError, TypeError):
        return False
    return True


def digest_of(net: torch.nn.Module) -> str:
    """SHA-256 over the weights of a network."""
    import hashlib

    text = hashlib.sha256()
    for name, value in sorted(net.state_dict().items()):
        text.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return text.hexdigest()
