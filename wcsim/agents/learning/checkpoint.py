"""Checkpoints of a learner: weights, target, optimiser, replay, counters and random states, in safetensors and JSON.

Taken between rollouts, where every step is stored. Weights are small and saved often. The replay is large, so most
checkpoints share, as a hard link, the file of the newest one that was saved with its replay. A world cannot be saved:
a resumed run begins a new episode and with it a new exploration offset. All else that the learner holds is restored
exactly. All of a checkpoint is under a hash; one that is damaged in any place is passed over for the one before it,
and the learner is not touched.
"""

from __future__ import annotations

import copy
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from safetensors.numpy import load_file, save_file

from wcsim.agents.learning.checkpoint_file import (
    KEEP,
    MODEL,
    REPLAY,
    State,
    left_behind,
    read_state,
    replay_hash,
    step_folders,
    step_name,
    step_of,
    write_state,
)
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.replay.buffer import FrameReplay
from wcsim.agents.replay.state import check_fit, replay_arrays, restore_replay
from wcsim.core import files
from wcsim.core.reading import escaped
from wcsim.errors import PolicyError

LATEST = "LATEST"

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _PassedOver:
    """A checkpoint that was not used, and why."""

    path: Path
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Loaded:
    """What was restored beside the model, and what was not used for it, newest first."""

    path: Path
    extra: dict[str, int | float | str | bool]
    sealed: bool  # False for a checkpoint of an older version, whose counters have no hash
    passed_over: tuple[_PassedOver, ...]


def save_checkpoint(
    folder: Path,
    model: SeqDQN,
    extra: Mapping[str, int | float | str | bool],
    alive: Callable[[], object] = lambda: None,
    *,
    replay: bool = True,
) -> Path:
    """Write `folder/step-N` in one step, point LATEST to it, drop all but it and the newest ones; returns it.

    `alive` is called now and then while it is being written. Without `replay` it takes that of the newest checkpoint
    along, if there is one.

    Raises:
        DiskFullError: It could not be written; those before are whole.
        SafetensorError: The same, in other words.
    """
    target = folder / step_name(model.num_timesteps)
    held = None if replay else _newest_replay(folder)

    with files.whole_folder(target) as work:
        save_file(_model_arrays(model), work / MODEL)
        if held is None:
            save_file(replay_arrays(_replay(model), alive), work / REPLAY)
        else:
            _link(held[0] / REPLAY, work / REPLAY)
        alive()
        values = {
            "num_timesteps": model.num_timesteps,
            "n_updates": model._n_updates,
            "episodes": model._episode_num,
            "explore_rng": generator_state(model.rng),
            "replay_rng": generator_state(_replay(model).rng),
            "extra": dict(extra),
        }
        write_state(work, values, "" if held is None else held[1])

    files.write_bytes(folder / LATEST, f"{target.name}\n".encode())
    _drop_old(folder, target)
    return target


def _newest_replay(folder: Path) -> tuple[Path, str] | None:
    """The newest checkpoint of a run, and its replay's hash; None where there is none."""
    return next(((path, sha) for path in reversed(step_folders(folder)) if (sha := replay_hash(path))), None)


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # a file system without hard links
        shutil.copyfile(source, target)


def _drop_old(folder: Path, newest: Path) -> None:
    """Remove all checkpoints but `newest`, the last ones and one with another replay, and what is half-written."""
    older = step_folders(folder)
    kept = {newest, *older[-KEEP:]}
    replays = {_replay_inode(path) for path in kept}
    if len(replays) == 1:  # a damaged file must not take all of them
        kept.update([path for path in older if _replay_inode(path) not in replays][-1:])
    for old in (*older, *left_behind(folder)):
        if old not in kept:
            shutil.rmtree(old, ignore_errors=True)


def _replay_inode(checkpoint: Path) -> object:
    """Which file a checkpoint has its replay in: linked ones have the same."""
    try:
        return (checkpoint / REPLAY).stat().st_ino
    except OSError:  # of a kind of run that has none
        return checkpoint


def load_checkpoint(folder: Path, model: SeqDQN, alive: Callable[[], object] = lambda: None) -> Loaded:
    """Restore the newest sound checkpoint of a run into a fresh model built from the same configuration.

    `alive` is called now and then while it is being read.

    Raises:
        PolicyError: None is sound and fits the model, which is as it was then.
    """
    passed: list[_PassedOver] = []
    for path in reversed(step_folders(folder)):
        try:
            state = read_state(path)
            alive()
            _restore(model, state, load_file(path / MODEL), load_file(path / REPLAY), alive)
        except Exception as error:  # whatever is wrong with it, the one before may be sound
            passed.append(passed_over(path, error))
            continue
        return Loaded(path=path, extra=state.extra, sealed=state.sealed, passed_over=tuple(passed))
    raise _none_sound(folder, passed)


def passed_over(path: Path, error: Exception) -> _PassedOver:
    """The message on a checkpoint that could not be used."""
    reason = str(error) if isinstance(error, PolicyError) else f"{type(error).__name__}: {error}"
    return _PassedOver(path=path, reason=escaped(reason, 300))


def _none_sound(folder: Path, passed: Sequence[_PassedOver]) -> PolicyError:
    """What is raised where all checkpoints of a run were passed over, or none found."""
    faults = "; ".join(f"{item.path.name}: {item.reason}" for item in passed) or "none found"
    return PolicyError(f"{folder} holds no intact checkpoint that fits ({faults}); restore one, or start a new run")


def newest_step(folder: Path) -> int:
    """The step of a run's newest checkpoint, sound or not; -1 when none found."""
    return max(map(step_of, step_folders(folder)), default=-1)


def generator_state(rng: np.random.Generator) -> dict[str, Any]:
    """State of a Philox generator as plain values."""
    state = rng.bit_generator.state
    return {
        "counter": [int(v) for v in state["state"]["counter"]],
        "key": [int(v) for v in state["state"]["key"]],
        "buffer": [int(v) for v in state["buffer"]],
        "buffer_pos": int(state["buffer_pos"]),
        "has_uint32": int(state["has_uint32"]),
        "uinteger": int(state["uinteger"]),
    }


def _restored_generator(state: dict[str, Any]) -> np.random.Generator:
    """The generator that `generator_state` described."""
    bits = np.random.Philox()
    bits.state = {
        "bit_generator": "Philox",
        "state": {"counter": np.array(state["counter"], np.uint64), "key": np.array(state["key"], np.uint64)},
        "buffer": np.array(state["buffer"], dtype=np.uint64),
        "buffer_pos": state["buffer_pos"],
        "has_uint32": state["has_uint32"],
        "uinteger": state["uinteger"],
    }
    return np.random.Generator(bits)


def _replay(model: SeqDQN) -> FrameReplay:
    if not isinstance(model.replay_buffer, FrameReplay):
        raise PolicyError(f"replay is {type(model.replay_buffer).__name__}; expected FrameReplay for a checkpoint")
    return model.replay_buffer


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


def _restore(model: SeqDQN, state: State, arrays: Arrays, replay: Arrays, alive: Callable[[], object]) -> None:
    """All of it, or, with an exception, nothing."""
    memory = _replay(model)
    slots = _optimizer_slots(model, arrays)
    _check_same_arrays(model, arrays)
    check_fit(memory, replay)
    nets = [copy.deepcopy(net.state_dict()) for _, net in _nets(model)]
    optimizer = copy.deepcopy(model.policy.optimizer.state_dict())
    torch_rng, memory_rng = torch.get_rng_state(), memory.rng
    try:
        for prefix, net in _nets(model):
            head = f"{prefix}/"
            net.load_state_dict(
                {k.removeprefix(head): torch.from_numpy(v) for k, v in arrays.items() if k.startswith(head)}
            )
        model.policy.optimizer.load_state_dict({"state": slots, "param_groups": optimizer["param_groups"]})
        restore_replay(memory, replay, alive)
        memory.rng, explore_rng = _restored_generator(state.replay_rng), _restored_generator(state.explore_rng)
        torch.set_rng_state(torch.from_numpy(arrays["torch_rng"]))
    except BaseException:
        for (_, net), before in zip(_nets(model), nets, strict=True):
            net.load_state_dict(before)
        model.policy.optimizer.load_state_dict(optimizer)
        memory.reset()
        memory.rng = memory_rng
        torch.set_rng_state(torch_rng)
        raise
    model.rng = explore_rng
    model.num_timesteps, model._n_updates, model._episode_num = state.num_timesteps, state.n_updates, state.episodes


def _check_same_arrays(model: SeqDQN, arrays: Arrays) -> None:
    """Raise PolicyError unless the arrays of the networks have the names, shapes and types that the model's have."""
    expected = {key: value for key, value in _model_arrays(model).items() if not key.startswith("optimizer/")}
    got = {key: value for key, value in arrays.items() if not key.startswith("optimizer/")}
    if set(got) != set(expected):
        other = escaped(sorted(set(got) ^ set(expected)))
        raise PolicyError(f"{MODEL} has other arrays ({other}) than this configuration")
    for key, value in expected.items():
        here, there = (value.dtype, value.shape), (got[key].dtype, got[key].shape)
        if here != there:
            raise PolicyError(f"{MODEL}: {key} is {there[0]} {there[1]}, in this configuration {here[0]} {here[1]}")


def _optimizer_slots(model: SeqDQN, arrays: Arrays) -> dict[int, dict[str, torch.Tensor]]:
    """The optimiser's state by parameter. Raises PolicyError when it is not that of these parameters."""
    sizes = [tuple(value.shape) for group in model.policy.optimizer.param_groups for value in group["params"]]
    slots: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in arrays.items():
        if not key.startswith("optimizer/"):
            continue
        _, index, name = key.split("/")
        number = int(index)
        if not 0 <= number < len(sizes) or (value.size != 1 if name == "step" else value.shape != sizes[number]):
            raise PolicyError(f"{MODEL}: {key} has the shape {value.shape}; it is of another network")
        slots.setdefault(number, {})[name] = torch.from_numpy(value.reshape(()) if name == "step" else value)
    return slots
