"""A replay memory as arrays for a file, and back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from wcsim.agents import frames_store
from wcsim.agents.replay import FrameReplay

Arrays = dict[str, npt.NDArray[Any]]

PER_STEP = ("vectors", "actions", "rewards", "ended", "terminated", "episode_step")
SLICE = 512  # steps read at once


def replay_arrays(replay: FrameReplay, alive: Callable[[], object] = lambda: None) -> Arrays:
    """Everything in the memory, oldest step first; images are compressed, which takes minutes for a large one.

    `alive` is called now and then.
    """
    first, size = replay.total - replay.size(), replay.size()
    index = first + np.arange(size)
    rows = index % replay.buffer_size
    blobs: list[bytes] = []
    for seat in range(replay.n_envs):
        for k in range(0, size, SLICE):
            blobs += frames_store.pack(replay.windows.read_newest(index[k : k + SLICE], seat))
            alive()
    ends = sorted(replay.after_end)
    arrays: Arrays = {name: getattr(replay, name)[rows] for name in PER_STEP}
    if replay.advice is not None:
        arrays.update(replay.advice.arrays(rows))
    arrays["total"] = np.array([replay.total, size], dtype=np.int64)
    arrays["frames"] = np.frombuffer(b"".join(blobs), dtype=np.uint8)
    arrays["blob_bytes"] = np.array([len(blob) for blob in blobs], dtype=np.int64)
    arrays["end_at"] = np.array(ends, dtype=np.int64).reshape(-1, 2)
    empty_image = np.zeros((0, replay.layout.image_bytes), dtype=np.uint8)
    empty_vector = np.zeros((0, replay.layout.vector_size), dtype=np.float32)
    arrays["whole_at"] = np.array(_whole(replay), dtype=np.int64).reshape(-1, 2)
    arrays["whole_images"] = replay.windows.read(*arrays["whole_at"].T)
    arrays["end_images"] = np.stack([replay.after_end[key][0] for key in ends]) if ends else empty_image
    arrays["end_vectors"] = np.stack([replay.after_end[key][1] for key in ends]) if ends else empty_vector
    arrays["next_images"], arrays["next_vectors"] = replay.expected or (empty_image, empty_vector)
    return {key: np.ascontiguousarray(value) for key, value in arrays.items()}


def _whole(replay: FrameReplay) -> list[tuple[int, int]]:
    """Where the window of a step does not follow from the steps that are kept: (absolute index, seat)."""
    first = replay.total - replay.size()
    cut = range(first, min(first + replay.layout.window - 1, replay.total))  # frames of steps that are forgotten
    return sorted({(index, seat) for index in cut for seat in range(replay.n_envs)} | set(replay.windows.whole))


def restore_replay(replay: FrameReplay, arrays: Arrays) -> None:
    """Put the arrays of `replay_arrays` into an empty memory of the same size. Raises ValueError when they do not fit.

    A resumed run begins a new episode; its first step differs from the expected one, which ends the old chain.
    """
    total, size = (int(value) for value in arrays["total"])
    if size > replay.buffer_size or arrays["vectors"].shape[1:] != replay.vectors.shape[1:]:
        raise ValueError(f"replay holds {arrays['vectors'].shape} vectors; expected at most {replay.vectors.shape}")
    if arrays["end_images"].shape[1] != replay.layout.image_bytes:
        raise ValueError(f"replay holds {arrays['end_images'].shape[1]} bytes a step, not {replay.layout.image_bytes}")
    replay.reset()
    index = total - size + np.arange(size)
    rows = index % replay.buffer_size
    for name in PER_STEP:
        getattr(replay, name)[rows] = arrays[name]
    if replay.advice is not None:
        replay.advice.restore(arrays, index)
    _restore_frames(replay, arrays, index)
    if "whole_at" in arrays:
        for (step, seat), window in zip(arrays["whole_at"], arrays["whole_images"], strict=True):
            replay.windows.whole[int(step), int(seat)] = window
    for (step, seat), image, vector in zip(arrays["end_at"], arrays["end_images"], arrays["end_vectors"], strict=True):
        replay.after_end[int(step), int(seat)] = (image, vector)
    for k in np.flatnonzero(replay.terminated[rows].any(axis=1)):
        for seat in np.flatnonzero(replay.terminated[rows[k]]):
            replay.crashes.append((total - size + int(k), int(seat)))
    replay.total, replay.pos, replay.full = total, total % replay.buffer_size, size == replay.buffer_size
    if len(arrays["next_images"]):
        replay.expected = (arrays["next_images"], arrays["next_vectors"])


def _restore_frames(replay: FrameReplay, arrays: Arrays, index: npt.NDArray[np.int64]) -> None:
    ends = np.cumsum(arrays["blob_bytes"])
    data = arrays["frames"].tobytes()
    blobs = [data[end - length : end] for end, length in zip(ends, arrays["blob_bytes"], strict=True)]
    each = len(blobs) // replay.n_envs  # one seat after the other
    at = 0
    for parts in zip(*(blobs[seat * each : (seat + 1) * each] for seat in range(replay.n_envs)), strict=True):
        frames = np.stack([frames_store.unpack([blob], replay.layout.frame_bytes) for blob in parts], axis=1)
        for step, frame in zip(index[at : at + len(frames)], frames, strict=True):  # (seats, frame_bytes)
            fresh = replay.episode_step[step % replay.buffer_size] == 0
            replay.windows.write_newest(int(step), frame, fresh)
        at += len(frames)
