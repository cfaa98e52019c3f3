"""A danger learner after a round, as a folder of plain arrays; a run goes on from it to the same weights."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import torch

from wcsim.agents.collecting.data_folder import key_of
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.learner_files import STATE, read_learner, require_whole, write_learner
from wcsim.core import files
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import PolicyError

KEPT_ROUNDS: Final = 3  # checkpoints that are kept
_KEYS: Final = frozenset(("updates", "loss", "segments", "sha256"))
_KIND: Final = FileKind(what="the state.json of a checkpoint", limit_bytes=64 << 20, error=PolicyError)


def _checkpoint_path(folder: Path, number: int) -> Path:
    """Where the checkpoint after a round lies."""
    return folder / f"round-{number:03d}"


def save_round(folder: Path, number: int, learner: DangerLearner, segments: dict[str, str]) -> None:
    """Keep a learner after a round, whole or not at all, and drop all but the newest three. Raises DiskFullError."""
    with files.whole_folder(_checkpoint_path(folder, number)) as target:
        sha256 = write_learner(target, learner)
        state = {
            "updates": learner.updates,
            "loss": learner.loss,
            "segments": segments,
            "sha256": sha256,
        }
        files.write_sealed_json(target / STATE, state)

    for old in _numbers(folder)[:-KEPT_ROUNDS]:
        shutil.rmtree(_checkpoint_path(folder, old), ignore_errors=True)


def newest_round(folder: Path) -> int:
    """The last round that is kept whole, -1 for none."""
    return next((number for number in reversed(_numbers(folder)) if _is_whole(_checkpoint_path(folder, number))), -1)


def damaged_rounds(folder: Path) -> list[Path]:
    """Checkpoints that are newer than the last whole one: what they held is done again."""
    newest = newest_round(folder)
    return [_checkpoint_path(folder, number) for number in _numbers(folder) if number > newest]


def _numbers(folder: Path) -> list[int]:
    """Of the rounds that there is a checkpoint of."""
    return sorted(int(path.name[6:]) for path in folder.glob("round-*") if path.name[6:].isdecimal())


def load_round(folder: Path, number: int, learner: DangerLearner) -> dict[str, str]:
    """Bring a learner to where it was after a round; the SHA-256 of the segments it had learned from, by file name.

    Raises:
        PolicyError: The checkpoint does not fit, or is damaged.
    """
    path = _checkpoint_path(folder, number)
    state = _state(path)
    updates, loss, segments = (state[name] for name in ("updates", "loss", "segments"))
    named = isinstance(segments, dict) and all(isinstance(sha256, str) for sha256 in segments.values())
    if type(updates) is not int or type(loss) is not float or not isinstance(segments, dict) or not named:
        raise PolicyError(f"{escaped(path / STATE)} is damaged; expected updates, a loss and segments")
    read_learner(path, learner, updates, loss)
    try:
        in_order(segments)
    except PolicyError as error:
        raise PolicyError(f"{escaped(path)} names a segment that no run has: {error}") from None
    return segments


def in_order(segments: Iterable[str]) -> list[str]:
    """Names of segments in the order in which a run learns from them: round by round.

    >>> in_order(["3-1000-0000.npz.zst", "3-999-0001.npz.zst", "3-999-0000.npz.zst"])
    ['3-999-0000.npz.zst', '3-999-0001.npz.zst', '3-1000-0000.npz.zst']
    """
    return sorted(segments, key=lambda name: (key_of(name).round, name))


def _is_whole(path: Path) -> bool:
    if not is_file(path / STATE):
        return False
    try:
        require_whole(path, _state(path)["sha256"])
    except (PolicyError, OSError, KeyError, TypeError):
        return False
    return True


def _state(path: Path) -> dict[str, Any]:
    """What a checkpoint says of itself. Raises PolicyError when it is not what was written."""
    state = read_json(path / STATE, _KIND)
    files.take_seal(state, escaped(path / STATE))
    if set(state) != _KEYS:  # a seal whose name is damaged is no missing one
        raise PolicyError(f"{escaped(path / STATE)} has the keys {escaped(sorted(state))}; it is damaged")
    return state


def digest_of(net: torch.nn.Module) -> str:
    """SHA-256 over the weights of a network."""
    import hashlib

    text = hashlib.sha256()
    for name, value in sorted(net.state_dict().items()):
        text.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return text.hexdigest()
