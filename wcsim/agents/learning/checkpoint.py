"""What a checkpoint holds of a learner: weights, target, optimiser, replay, counters and random states.

Taken between rollouts, where every step is stored. Weights are small and saved often; most checkpoints share the replay
of the newest one that was saved with it. A world cannot be saved: a resumed run begins a new episode and with it a new
exploration offset. All else that the learner holds is restored exactly, or the learner is not touched.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.replay.buffer import FrameReplay
from wcsim.agents.replay.state import check_fit, replay_arrays, restore_replay
from wcsim.agents.runs.checkpoint import STATE, Arrays, Restore, newest_arrays, save, tag
from wcsim.config import parse
from wcsim.config.run_file import SeqFile, SittingFile
from wcsim.core.reading import escaped
from wcsim.errors import PolicyError

_MODEL: Final = "model.safetensors"


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
        SafetensorError: The same, in other words.
    """
    state = {
        "n_updates": model._n_updates,
        "episodes": model._episode_num,
        "explore_rng": generator_state(model.rng),
        "replay_rng": generator_state(_replay(model).rng),
        "extra": dict(extra),
    }
    held = None if replay else newest_arrays(folder, "replay")
    arrays = {"model": _model_arrays(model), "replay": held or replay_arrays(_replay(model), alive)}
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


def _restore(model: SeqDQN, state: SeqFile, arrays: Arrays, replay: Arrays, alive: Callable[[], object]) -> None:
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
        memory.rng, explore_rng = (
            _restored_generator(rng.model_dump()) for rng in (state.replay_rng, state.explore_rng)
        )
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
    model._n_updates, model._episode_num = state.n_updates, state.episodes


def _check_same_arrays(model: SeqDQN, arrays: Arrays) -> None:
    """Raise PolicyError unless the arrays of the networks have the names, shapes and types that the model's have."""
    expected = {key: value for key, value in _model_arrays(model).items() if not key.startswith("optimizer/")}
    got = {key: value for key, value in arrays.items() if not key.startswith("optimizer/")}
    if set(got) != set(expected):
        other = escaped(sorted(set(got) ^ set(expected)))
        raise PolicyError(f"{_MODEL} has other arrays ({other}) than this configuration")
    for key, value in expected.items():
        here, there = (value.dtype, value.shape), (got[key].dtype, got[key].shape)
        if here != there:
            raise PolicyError(f"{_MODEL}: {key} is {there[0]} {there[1]}, in this configuration {here[0]} {here[1]}")


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
            raise PolicyError(f"{_MODEL}: {key} has the shape {value.shape}; it is of another network")
        slots.setdefault(number, {})[name] = torch.from_numpy(value.reshape(()) if name == "step" else value)
    return slots
