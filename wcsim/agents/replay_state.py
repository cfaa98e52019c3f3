"""A replay memory as arrays for a file, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from wcsim.agents import frames_store
from wcsim.agents.replay import FrameReplay

Arrays = dict[str, npt.NDArray[Any]]

PER_STEP = ("vectors", "actions", "rewards", "ended", "terminated", "episode_step")
SLICE = 512  # steps read at once


def replay_arrays(replay: FrameReplay) -> Arrays:
    """Everything in the memory, oldest step first; images are compressed."""
    first, size = replay.total - replay.size(), replay.size()
    rows = (first + np.arange(size)) % replay.buffer_size
    blobs: list[bytes] = []
    for seat in range(replay.n_envs):
        for k in range(0, size, SLICE):
            part = rows[k : k + SLICE]
            blobs += frames_store.pack(replay.frames.read(part, np.full(len(part), seat)))
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
    arrays["end_images"] = np.stack([replay.after_end[key][0] for key in ends]) if ends else empty_image
    arrays["end_vectors"] = np.stack([replay.after_end[key][1] for key in ends]) if ends else empty_vector
    arrays["next_images"], arrays["next_vectors"] = replay.expected or (empty_image, empty_vector)
    return {key: np.ascontiguousarray(value) for key, value in arrays.items()}


def restore_replay(replay: FrameReplay, arrays: Arrays) -> None:
    """Put the arrays of `replay_arrays` into an empty memory of the same size. Raises ValueError when they do not fit.

    A resumed run begins a new episode; its first step differs from the expected one, which ends the old chain.
    """
    total, size = (int(value) for value in arrays["total"])
    if size > replay.buffer_size or arrays["vectors"].shape[1:] != replay.vectors.shape[1:]:
        raise ValueError(f"replay holds {arrays['vectors'].shape} vectors; expected at most {replay.vectors.shape}")
    replay.reset()
    rows = (total - size + np.arange(size)) % replay.buffer_size
    for name in PER_STEP:
        getattr(replay, name)[rows] = arrays[name]
    if replay.advice is not None:
        replay.advice.restore(arrays, total - size + np.arange(size))
    _restore_frames(replay, arrays, rows)
    for (index, seat), image, vector in zip(arrays["end_at"], arrays["end_images"], arrays["end_vectors"], strict=True):
        replay.after_end[int(index), int(seat)] = (image, vector)
    for k in np.flatnonzero(replay.terminated[rows].any(axis=1)):
        for seat in np.flatnonzero(replay.terminated[rows[k]]):
            replay.crashes.append((total - size + int(k), int(seat)))
    replay.total, replay.pos, replay.full = total, total % replay.buffer_size, size == replay.buffer_size
    if len(arrays["next_images"]):
        replay.expected = (arrays["next_images"], arrays["next_vectors"])


def _restore_frames(replay: FrameReplay, arrays: Arrays, rows: npt.NDArray[np.int64]) -> None:
    ends = np.cumsum(arrays["blob_bytes"])
    data = arrays["frames"].tobytes()
    blobs = [data[end - length : end] for end, length in zip(ends, arrays["blob_bytes"], strict=True)]
    per_seat = len(blobs) // replay.n_envs
    for seat in range(replay.n_envs):
        at = 0
        for blob in blobs[seat * per_seat : (seat + 1) * per_seat]:
            frames = frames_store.unpack([blob], replay.layout.image_bytes)
            for k, frame in enumerate(frames):
                replay.frames.write(int(rows[at + k]), seat, frame)
            at += len(frames)
