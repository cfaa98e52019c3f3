"""What a checkpoint holds of a learner: weights, optimiser, replay, counters and random states.

Taken between rollouts, where every step is stored. Weights are small and saved often; most
checkpoints share the replay of the newest one that was saved with it. A world cannot be saved: a
resumed run starts a new episode and with it a new exploration offset. All else that the learner
holds is restored exactly.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
import zstandard

from wcsim.agents.learning.replay.buffer import FrameReplay
from wcsim.agents.learning.replay.frame_store import ZSTD_LEVEL
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.runs.checkpoint import (
    STATE,
    Alive,
    Arrays,
    Restore,
    find_newest_checkpoint_arrays,
    format_checkpoint_name,
    write_checkpoint,
)
from wcsim.agents.runs.weights import validate_tensors
from wcsim.config import parse
from wcsim.config.run_file import QTrainingCheckpoint, QTrainingProgress
from wcsim.core.reading import JsonObject, decompress_zstd
from wcsim.errors import PolicyError
from wcsim.types import I64

_MODEL: Final = "model.safetensors"
# Arrays of a memory with a row for each step; those of advice only where it is stored.
_PER_STEP: Final = ("vectors", "actions", "rewards", "ended", "terminated", "episode_step")
_OF_ADVICE: Final = ("advice_bits", "advice_known")
_CHUNK_FRAMES: Final = 256  # frames of one blob in a checkpoint


def save_checkpoint(
    folder: Path,
    model: SeqDQN,
    extra: Mapping[str, int | bool],
    alive: Alive = lambda: None,
    *,
    replay: bool = True,
) -> Path:
    """Save a learner by `write_checkpoint`; `extra` is the `QTrainingProgress` beside it.

    Without `replay` it shares that of the newest checkpoint, if there is one.

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
    shared = None if replay else find_newest_checkpoint_arrays(folder, "replay")
    arrays = {
        "model": _model_arrays(model),
        "replay": shared or _replay_arrays(model.replay_buffer, alive),
    }
    return write_checkpoint(
        folder, format_checkpoint_name("step", model.num_timesteps), state, arrays, alive
    )


def make_checkpoint_restorer(model: SeqDQN, alive: Alive) -> Restore[QTrainingProgress]:
    """The function that brings a fresh model, of the same configuration, to a checkpoint.

    What fails on the way leaves a learner that has to be restored from another one. `alive` is
    called now and then.
    """

    def restore(step: int, state: JsonObject, arrays: dict[str, Arrays]) -> QTrainingProgress:
        memory, optimizer = model.replay_buffer, model.policy.optimizer
        # 1. Counters and the memory are checked before the learner is touched.
        file = parse(QTrainingCheckpoint, state, STATE)
        alive()
        _check_fit(memory, arrays["replay"])
        # 2. Both networks, and the optimiser with its moments.
        for prefix, net in _networks(model):
            named = _with_prefix(prefix, arrays["model"])
            tensors = {key: torch.from_numpy(value) for key, value in named.items()}
            own = net.state_dict()
            net.load_state_dict(validate_tensors(_MODEL, tensors, own, "this configuration"))
        slots = _optimizer_slots(model, _with_prefix("optimizer", arrays["model"]))
        optimizer.load_state_dict(
            {"state": slots, "param_groups": optimizer.state_dict()["param_groups"]}
        )
        # 3. The memory.
        _restore_replay(memory, arrays["replay"], alive)
        # 4. Random states and counters.
        memory.rng = _restored_generator(file.replay_rng.model_dump())
        model.rng = _restored_generator(file.explore_rng.model_dump())
        torch.set_rng_state(torch.from_numpy(arrays["model"]["torch_rng"]))
        model._n_updates = file.n_updates
        model._episode_num = file.episodes
        model.num_timesteps = step
        return file.extra

    return restore


def _generator_state(rng: np.random.Generator) -> JsonObject:
    """The state of a Philox generator as plain values."""
    state = dict(rng.bit_generator.state)
    del state["bit_generator"]
    flat = {**state.pop("state"), **state}
    return {
        key: value.tolist() if isinstance(value, np.ndarray) else int(value)
        for key, value in flat.items()
    }


def _restored_generator(state: JsonObject) -> np.random.Generator:
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


def _networks(model: SeqDQN) -> tuple[tuple[str, torch.nn.Module], ...]:
    return ("q_net", model.q_net), ("q_net_target", model.q_net_target)


def _model_arrays(model: SeqDQN) -> Arrays:
    """Weights of both networks, the optimiser's state, and torch's random state."""
    arrays: Arrays = {"torch_rng": torch.get_rng_state().numpy()}
    for prefix, net in _networks(model):
        for key, value in net.state_dict().items():
            arrays[f"{prefix}/{key}"] = value.detach().cpu().numpy()
    for index, slots in model.policy.optimizer.state_dict()["state"].items():
        for key, value in slots.items():
            arrays[f"optimizer/{index}/{key}"] = torch.as_tensor(value).cpu().numpy()
    return {key: np.ascontiguousarray(value) for key, value in arrays.items()}


def _with_prefix(prefix: str, arrays: Arrays) -> Arrays:
    """The arrays of that prefix, by what follows it."""
    return {
        key.removeprefix(f"{prefix}/"): value
        for key, value in arrays.items()
        if key.startswith(f"{prefix}/")
    }


def _optimizer_slots(model: SeqDQN, arrays: Arrays) -> dict[int, dict[str, torch.Tensor]]:
    """The optimiser's state by parameter. Raises PolicyError when it is of other parameters."""
    shapes = [
        tuple(value.shape)
        for group in model.policy.optimizer.param_groups
        for value in group["params"]
    ]
    slots: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in arrays.items():
        index, name = key.split("/")
        number = int(index)
        # `step` is one number, saved with a dimension; the others are moments of the weights.
        is_step = name == "step"
        fits = 0 <= number < len(shapes) and (
            value.size == 1 if is_step else value.shape == shapes[number]
        )
        if not fits:
            raise PolicyError(
                f"{_MODEL}: {key} has the shape {value.shape}; it is of another network"
            )
        slots.setdefault(number, {})[name] = torch.from_numpy(
            value.reshape(()) if is_step else value
        )
    return slots


def _per_step(replay: FrameReplay) -> tuple[str, ...]:
    """Which arrays of a memory have a row for each step."""
    return (*_PER_STEP, *_OF_ADVICE) if replay.advised else _PER_STEP


def _replay_arrays(replay: FrameReplay, alive: Alive = lambda: None) -> Arrays:
    """Everything in the memory, oldest step first.

    Images are compressed, which takes minutes for a large one; `alive` is called now and then.
    """
    # 1. Frames: blobs of one seat after the other.
    first, size = replay.total - replay.size(), replay.size()
    index = first + np.arange(size)
    blobs, packer = list[bytes](), zstandard.ZstdCompressor(level=ZSTD_LEVEL)
    for seat in range(replay.n_envs):
        for k in range(0, size, _CHUNK_FRAMES):
            frames = replay.windows.read_newest(index[k : k + _CHUNK_FRAMES], seat)
            blobs.append(packer.compress(frames.tobytes()))
            alive()
    # 2. What has a row for each step, and the states before groups.
    rows = index % replay.buffer_size
    arrays: Arrays = {name: getattr(replay, name)[rows] for name in _per_step(replay)}
    groups = replay.groups
    if groups is not None:
        states = np.array(list(groups.states.values()), np.float32)
        arrays["state_at"] = np.array(list(groups.states), np.int64).reshape(-1, 2)
        arrays["states"] = states.reshape(len(groups.states), groups.state_size)
    arrays["total"] = np.array([replay.total, size], np.int64)
    arrays["frames"] = np.frombuffer(b"".join(blobs), np.uint8)
    arrays["blob_bytes"] = np.array([len(blob) for blob in blobs], np.int64)
    # 3. Observations after ends of chains.
    empty_image = np.zeros((0, replay.layout.image_bytes), np.uint8)
    empty_vector = np.zeros((0, replay.layout.vector_size), np.float32)
    ends = sorted(replay.after_end)
    after = [replay.observation_after_end(*key) for key in ends]
    arrays["end_at"] = np.array(ends, np.int64).reshape(-1, 2)
    arrays["end_images"] = np.stack([image for image, _ in after]) if ends else empty_image
    arrays["end_vectors"] = np.stack([vector for _, vector in after]) if ends else empty_vector
    # 4. Windows that do not follow from the frames, and the observations that come next.
    arrays["whole_at"] = np.array(_whole_windows(replay), np.int64).reshape(-1, 2)
    arrays["whole_images"] = replay.windows.read(*arrays["whole_at"].T)
    arrays["next_images"], arrays["next_vectors"] = replay.expected or (empty_image, empty_vector)
    return arrays


def _whole_windows(replay: FrameReplay) -> list[tuple[int, int]]:
    """(absolute index, seat) of windows that do not follow from the stored steps."""
    first = replay.total - replay.size()
    # The first ones reach back to frames of steps that are forgotten.
    cut = range(first, min(first + replay.layout.window - 1, replay.total))
    cut_at = {(index, seat) for index in cut for seat in range(replay.n_envs)}
    return sorted(cut_at | set(replay.windows.whole_windows))


def _check_fit(replay: FrameReplay, arrays: Arrays) -> None:
    """Raise ValueError unless the arrays are those of a memory like this one."""
    # 1. Counts.
    counts = arrays["total"]
    if counts.dtype != np.int64 or counts.shape != (2,):
        raise ValueError(f"replay has counts {counts.dtype} {counts.shape}; expected two numbers")
    total, size = counts.tolist()
    if not 0 <= size <= total or size != min(total, replay.buffer_size):
        raise ValueError(
            f"replay holds {size} of {total} steps; expected the last {replay.buffer_size}, or all"
        )
    # 2. Each array's shape and type.
    for name, own in _replay_arrays(replay).items():
        array = arrays[name]
        count = size if name in _per_step(replay) else len(array)
        shape = (count, *own.shape[1:])
        if array.shape != shape or array.dtype != own.dtype:
            raise ValueError(
                f"replay: {name} is {array.dtype} {array.shape}; expected {own.dtype} {shape}"
            )
    # 3. What two arrays must agree on.
    next_counts = {len(arrays["next_images"]), len(arrays["next_vectors"])}
    if next_counts not in ({0}, {replay.n_envs}):
        raise ValueError("replay: its images do not go together")
    lengths = arrays["blob_bytes"]
    if (lengths < 0).any() or int(lengths.sum()) != len(arrays["frames"]):
        raise ValueError("replay: its frames have other lengths than it says")


def _restore_replay(replay: FrameReplay, arrays: Arrays, alive: Alive = lambda: None) -> None:
    """Put the arrays of `_replay_arrays` into a memory of the same size that they fit.

    A resumed run starts a new episode; its first step differs from the expected one, which ends
    the old chain. `alive` is called now and then.

    Raises:
        ValueError: Their frames are not those of their steps; the memory has to be reset then.
    """
    # 1. What has a row for each step.
    total, size = arrays["total"].tolist()
    replay.reset()
    index = total - size + np.arange(size)
    rows = index % replay.buffer_size
    for name in _per_step(replay):
        getattr(replay, name)[rows] = arrays[name]
    # 2. Lists that are made of it: crashes, and steps with advice.
    for k, seat in np.argwhere(replay.terminated[rows]).tolist():
        replay.crashes.append((total - size + k, seat))
    for k, seat in np.argwhere(replay.advice_known[rows]).tolist():
        safe = replay.safe_actions(index[k : k + 1], np.array([seat]))
        replay.list_advice(total - size + k, seat, some_unsafe=not safe.all())
    # 3. States before groups.
    if replay.groups is not None:
        keys = map(tuple, arrays["state_at"].tolist())
        replay.groups.states = dict(zip(keys, arrays["states"], strict=True))
    # 4. Frames, windows that do not follow from them, and observations after ends of chains.
    _restore_frames(replay, arrays, index, alive)
    for (step, seat), window in zip(arrays["whole_at"], arrays["whole_images"], strict=True):
        replay.windows.whole_windows[int(step), int(seat)] = window
    ends = zip(arrays["end_at"], arrays["end_images"], arrays["end_vectors"], strict=True)
    for (step, seat), image, vector in ends:
        replay.store_end(int(step), int(seat), image, vector)
    # 5. Where the ring goes on.
    replay.total = total
    replay.pos = total % replay.buffer_size
    replay.full = size == replay.buffer_size
    if len(arrays["next_images"]):
        replay.expected = (arrays["next_images"], arrays["next_vectors"])


def _restore_frames(replay: FrameReplay, arrays: Arrays, index: I64, alive: Alive) -> None:
    data, lengths = arrays["frames"].tobytes(), arrays["blob_bytes"]
    stops = np.cumsum(lengths)
    blobs = [data[stop - length : stop] for stop, length in zip(stops, lengths, strict=True)]
    # Blobs of one seat after the other; each step needs the frames of all seats.
    each = len(blobs) // replay.n_envs
    by_seat = [blobs[seat * each : (seat + 1) * each] for seat in range(replay.n_envs)]
    restored, size = 0, replay.layout.frame_bytes
    for parts in zip(*by_seat, strict=True):
        raw = [decompress_zstd(blob, _CHUNK_FRAMES * size) for blob in parts]
        frames = np.stack([np.frombuffer(each, np.uint8).reshape(-1, size) for each in raw], axis=1)
        steps = index[restored : restored + len(frames)]
        for step, frame in zip(steps, frames, strict=True):  # frame: (seats, frame_bytes)
            starts = replay.episode_step[step % replay.buffer_size] == 0
            replay.windows.write_newest(int(step), frame, starts)
        restored += len(frames)
        alive()
    if restored != len(index):
        raise ValueError(f"replay has frames of {restored} steps; expected {len(index)}")
