"""What a checkpoint holds of a learner: weights, target, optimiser, replay, counters and random states.

Taken between rollouts, where every step is stored. Weights are small and saved often; most checkpoints share the replay
of the newest one that was saved with it. A world cannot be saved: a resumed run begins a new episode and with it a new
exploration offset. All else that the learner holds is restored exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
import zstandard

from wcsim.agents.learning.replay.buffer import FrameReplay
from wcsim.agents.learning.replay.frame_store import LEVEL
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.runs.checkpoint import STATE, Arrays, Restore, newest_arrays, save, tag
from wcsim.agents.runs.weights import checked_tensors
from wcsim.config import parse
from wcsim.config.run_file import SeqFile, SittingFile
from wcsim.core.reading import unzstd
from wcsim.errors import PolicyError
from wcsim.types import I64, U8

_MODEL: Final = "model.safetensors"
_PER_STEP = ("vectors", "actions", "rewards", "ended", "terminated", "episode_step")
_OF_ADVICE = ("advice_bits", "advice_known")
_CHUNK_FRAMES = 256  # frames of one blob in a checkpoint


def save_checkpoint(
    folder: Path,
    model: SeqDQN,
    extra: Mapping[str, int | bool],
    alive: Callable[[], object] = lambda: None,
    *,
    replay: bool = True,
) -> Path:
    """Save a learner, see `checkpoint.save`; `extra` is the `SittingFile` beside it.

    Without `replay` it takes that of the newest checkpoint along, if there is one.

    Raises:
        DiskFullError: It could not be written; those before are whole.
    """
    state = {
        "n_updates": model._n_updates,
        "episodes": model._episode_num,
        "explore_rng": _generator_state(model.rng),
        "replay_rng": _generator_state(model.replay_buffer.rng),
        "extra": dict(extra),
    }
    held = None if replay else newest_arrays(folder, "replay")
    arrays = {
        "model": _model_arrays(model),
        "replay": held or _replay_arrays(model.replay_buffer, alive),
    }
    return save(folder, tag("step", model.num_timesteps), state, arrays, alive)


def restoring(model: SeqDQN, alive: Callable[[], object] = lambda: None) -> Restore[SittingFile]:
    """Brings a fresh model, built from the same configuration, to a checkpoint; `alive` is called now and then."""

    def restore(step: int, state: dict[str, Any], arrays: dict[str, Arrays]) -> SittingFile:
        said = parse(SeqFile, state, STATE)
        alive()
        _restore(model, said, arrays["model"], arrays["replay"], alive)
        model.num_timesteps = step
        return said.extra

    return restore


def _generator_state(rng: np.random.Generator) -> dict[str, Any]:
    """State of a Philox generator as plain values."""
    state = dict(rng.bit_generator.state)
    del state["bit_generator"]
    flat = {**state.pop("state"), **state}
    return {
        key: value.tolist() if isinstance(value, np.ndarray) else int(value)
        for key, value in flat.items()
    }


def _restored_generator(state: dict[str, Any]) -> np.random.Generator:
    """The generator that `_generator_state` described."""
    bits = np.random.Philox()
    counter, key, buffer = (
        np.array(state[name], np.uint64) for name in ("counter", "key", "buffer")
    )
    whole: Any = {
        **state,
        "bit_generator": "Philox",
        "state": {"counter": counter, "key": key},
        "buffer": buffer,
    }
    bits.state = whole
    return np.random.Generator(bits)


def _nets(model: SeqDQN) -> tuple[tuple[str, torch.nn.Module], ...]:
    return ("q_net", model.q_net), ("q_net_target", model.q_net_target)


def _model_arrays(model: SeqDQN) -> Arrays:
    arrays: Arrays = {"torch_rng": torch.get_rng_state().numpy()}
    for prefix, net in _nets(model):
        for key, value in net.state_dict().items():
            arrays[f"{prefix}/{key}"] = value.detach().cpu().numpy()
    for index, slots in model.policy.optimizer.state_dict()["state"].items():
        for key, value in slots.items():
            arrays[f"optimizer/{index}/{key}"] = np.asarray(torch.as_tensor(value).cpu().numpy())
    return {key: np.ascontiguousarray(value) for key, value in arrays.items()}


def _restore(
    model: SeqDQN, state: SeqFile, arrays: Arrays, replay: Arrays, alive: Callable[[], object]
) -> None:
    """All of it. What fails on the way leaves a learner that has to be restored from another checkpoint."""
    memory, optimizer = model.replay_buffer, model.policy.optimizer
    _check_fit(memory, replay)
    for prefix, net in _nets(model):
        held = {key: torch.from_numpy(value) for key, value in _below(prefix, arrays).items()}
        net.load_state_dict(checked_tensors(_MODEL, held, net.state_dict(), "this configuration"))
    slots = _optimizer_slots(model, _below("optimizer", arrays))
    optimizer.load_state_dict(
        {"state": slots, "param_groups": optimizer.state_dict()["param_groups"]}
    )
    _restore_replay(memory, replay, alive)
    memory.rng, model.rng = (
        _restored_generator(rng.model_dump()) for rng in (state.replay_rng, state.explore_rng)
    )
    torch.set_rng_state(torch.from_numpy(arrays["torch_rng"]))
    model._n_updates, model._episode_num = state.n_updates, state.episodes


def _below(prefix: str, arrays: Arrays) -> Arrays:
    """The arrays of that prefix, by what follows it."""
    return {
        key.removeprefix(f"{prefix}/"): value
        for key, value in arrays.items()
        if key.startswith(f"{prefix}/")
    }


def _optimizer_slots(model: SeqDQN, arrays: Arrays) -> dict[int, dict[str, torch.Tensor]]:
    """The optimiser's state by parameter. Raises PolicyError when it is not that of these parameters."""
    sizes = [
        tuple(value.shape)
        for group in model.policy.optimizer.param_groups
        for value in group["params"]
    ]
    slots: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in arrays.items():
        index, name = key.split("/")
        number = int(index)
        if not 0 <= number < len(sizes) or (
            value.size != 1 if name == "step" else value.shape != sizes[number]
        ):
            raise PolicyError(
                f"{_MODEL}: {key} has the shape {value.shape}; it is of another network"
            )
        slots.setdefault(number, {})[name] = torch.from_numpy(
            value.reshape(()) if name == "step" else value
        )
    return slots


def _per_step(replay: FrameReplay) -> tuple[str, ...]:
    """Which arrays of a memory have a row for each step."""
    return (*_PER_STEP, *(_OF_ADVICE if replay.advised else ()))


def _replay_arrays(replay: FrameReplay, alive: Callable[[], object] = lambda: None) -> Arrays:
    """Everything in the memory, oldest step first; images are compressed, which takes minutes for a large one.

    `alive` is called now and then.
    """
    first, size = replay.total - replay.size(), replay.size()
    index = first + np.arange(size)
    rows = index % replay.buffer_size
    blobs, packer = list[bytes](), zstandard.ZstdCompressor(level=LEVEL)
    for seat in range(replay.n_envs):
        for k in range(0, size, _CHUNK_FRAMES):
            frames = replay.windows.read_newest(index[k : k + _CHUNK_FRAMES], seat)
            blobs.append(packer.compress(frames.tobytes()))
            alive()
    ends, groups = sorted(replay.after_end), replay.groups
    arrays: Arrays = {name: getattr(replay, name)[rows] for name in _per_step(replay)}
    if groups is not None:
        states = np.array(list(groups.states.values()), dtype=np.float32)
        arrays["state_at"] = np.array(list(groups.states), dtype=np.int64).reshape(-1, 2)
        arrays["states"] = states.reshape(len(groups.states), groups.state_size)
    arrays["total"] = np.array([replay.total, size], dtype=np.int64)
    arrays["frames"] = np.frombuffer(b"".join(blobs), dtype=np.uint8)
    arrays["blob_bytes"] = np.array([len(blob) for blob in blobs], dtype=np.int64)
    arrays["end_at"] = np.array(ends, dtype=np.int64).reshape(-1, 2)
    empty_image = np.zeros((0, replay.layout.image_bytes), dtype=np.uint8)
    empty_vector = np.zeros((0, replay.layout.vector_size), dtype=np.float32)
    after = [replay.observation_after_end(*key) for key in ends]
    arrays["end_images"] = np.stack([image for image, _ in after]) if ends else empty_image
    arrays["end_vectors"] = np.stack([vector for _, vector in after]) if ends else empty_vector
    arrays["whole_at"] = np.array(_whole(replay), dtype=np.int64).reshape(-1, 2)
    arrays["whole_images"] = replay.windows.read(*arrays["whole_at"].T)
    arrays["next_images"], arrays["next_vectors"] = replay.expected or (empty_image, empty_vector)
    return {key: np.ascontiguousarray(value) for key, value in arrays.items()}


def _whole(replay: FrameReplay) -> list[tuple[int, int]]:
    """Where the window of a step does not follow from the stored steps: (absolute index, seat)."""
    first = replay.total - replay.size()
    cut = range(
        first, min(first + replay.layout.window - 1, replay.total)
    )  # frames of steps that are forgotten
    return sorted(
        {(index, seat) for index in cut for seat in range(replay.n_envs)}
        | set(replay.windows.whole)
    )


def _check_fit(replay: FrameReplay, arrays: Arrays) -> None:
    """Raise ValueError unless the arrays are those of a memory like this one, each of its shape and type."""
    size = _stored_steps(replay, arrays["total"])
    for name, own in _replay_arrays(replay).items():
        got, count = arrays[name], size if name in _per_step(replay) else len(arrays[name])
        shape = (count, *own.shape[1:])
        if got.shape != shape or got.dtype != own.dtype:
            raise ValueError(
                f"replay: {name} is {got.dtype} {got.shape}; expected {own.dtype} {shape}"
            )
    lengths, coming = (
        arrays["blob_bytes"],
        {len(arrays["next_images"]), len(arrays["next_vectors"])},
    )
    if coming not in ({0}, {replay.n_envs}):
        raise ValueError("replay: its images do not go together")
    if (lengths < 0).any() or int(lengths.sum()) != len(arrays["frames"]):
        raise ValueError("replay: its frames have other lengths than it says")


def _stored_steps(replay: FrameReplay, counts: npt.NDArray[Any]) -> int:
    if counts.dtype != np.int64 or counts.shape != (2,):
        raise ValueError(f"replay has counts {counts.dtype} {counts.shape}; expected two numbers")
    total, size = counts.tolist()
    if not 0 <= size <= total or size != min(total, replay.buffer_size):
        raise ValueError(
            f"replay holds {size} of {total} steps; expected the last {replay.buffer_size}, or all"
        )
    return int(size)


def _restore_replay(
    replay: FrameReplay, arrays: Arrays, alive: Callable[[], object] = lambda: None
) -> None:
    """Put the arrays of `_replay_arrays` into an empty memory of the same size, that they fit (`_check_fit`).

    A resumed run begins a new episode; its first step differs from the expected one, which ends the old chain.
    `alive` is called now and then.

    Raises:
        ValueError: Their frames are not those of their steps; the memory has to be reset then.
    """
    total, size = arrays["total"].tolist()
    replay.reset()
    index = total - size + np.arange(size)
    rows = index % replay.buffer_size
    for name in _per_step(replay):
        getattr(replay, name)[rows] = arrays[name]
    for k, seat in np.argwhere(replay.terminated[rows]).tolist():
        replay.crashes.append((total - size + k, seat))
    for k, seat in np.argwhere(replay.advice_known[rows]).tolist():
        safe = replay.safe(index[k : k + 1], np.array([seat]))
        replay.list_advice(total - size + k, seat, tight=not safe.all())
    if replay.groups is not None:
        keys = map(tuple, arrays["state_at"].tolist())
        replay.groups.states = dict(zip(keys, arrays["states"], strict=True))
    _restore_frames(replay, arrays, index, alive)
    for (step, seat), window in zip(arrays["whole_at"], arrays["whole_images"], strict=True):
        replay.windows.whole[int(step), int(seat)] = window
    for (step, seat), image, vector in zip(
        arrays["end_at"], arrays["end_images"], arrays["end_vectors"], strict=True
    ):
        replay.store_end(int(step), int(seat), image, vector)
    replay.total, replay.pos, replay.full = (
        total,
        total % replay.buffer_size,
        size == replay.buffer_size,
    )
    if len(arrays["next_images"]):
        replay.expected = (arrays["next_images"], arrays["next_vectors"])


def _restore_frames(
    replay: FrameReplay, arrays: Arrays, index: I64, alive: Callable[[], object]
) -> None:
    ends = np.cumsum(arrays["blob_bytes"])
    data = arrays["frames"].tobytes()
    blobs = [
        data[end - length : end] for end, length in zip(ends, arrays["blob_bytes"], strict=True)
    ]
    each = len(blobs) // replay.n_envs  # one seat after the other
    at = 0
    for parts in zip(
        *(blobs[seat * each : (seat + 1) * each] for seat in range(replay.n_envs)), strict=True
    ):
        frames = np.stack([_unpacked(blob, replay.layout.frame_bytes) for blob in parts], axis=1)
        for step, frame in zip(
            index[at : at + len(frames)], frames, strict=True
        ):  # (seats, frame_bytes)
            fresh = replay.episode_step[step % replay.buffer_size] == 0
            replay.windows.write_newest(int(step), frame, fresh)
        at += len(frames)
        alive()
    if at != len(index):
        raise ValueError(f"replay has frames of {at} steps; expected {len(index)}")


def _unpacked(blob: bytes, size: int) -> U8:
    """The frames (K, size) of a blob."""
    return np.frombuffer(unzstd(blob, _CHUNK_FRAMES * size), dtype=np.uint8).reshape(-1, size)
