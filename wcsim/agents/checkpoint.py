"""Checkpoints of a learner: weights, target, optimiser, replay, counters and random states, in safetensors and JSON.

Taken between rollouts, where every step is stored. A world cannot be saved, so a resumed run begins a new episode and
with it a new exploration offset; everything else that the learner holds is restored exactly. A damaged checkpoint is
passed over for the one before it.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from wcsim.agents import files
from wcsim.agents.replay import FrameReplay
from wcsim.agents.replay_state import replay_arrays, restore_replay
from wcsim.agents.seqdqn import SeqDQN
from wcsim.errors import PolicyError

KEEP = 3
STATE, MODEL, REPLAY, LATEST = "state.json", "model.safetensors", "replay.safetensors", "LATEST"
SCHEMA = 1

Arrays = dict[str, npt.NDArray[Any]]


def save_checkpoint(
    folder: Path,
    model: SeqDQN,
    extra: Mapping[str, int | float | str | bool],
    alive: Callable[[], object] = lambda: None,
) -> Path:
    """Write `folder/step-N` in one step, point LATEST to it, drop all but the newest three; returns the new one.

    `alive` is called now and then while it is being written.
    """
    name = f"step-{model.num_timesteps:08d}"

    def fill(target: Path) -> None:
        save_file(_model_arrays(model), target / MODEL)
        save_file(replay_arrays(_replay(model), alive), target / REPLAY)
        alive()
        state = {
            "schema_version": SCHEMA,
            "num_timesteps": model.num_timesteps,
            "n_updates": model._n_updates,
            "episodes": model._episode_num,
            "explore_rng": generator_state(model.rng),
            "replay_rng": generator_state(_replay(model).rng),
            "extra": dict(extra),
            "sha256": {file: files.sha256(target / file) for file in (MODEL, REPLAY)},
        }
        files.write_json(target / STATE, state)

    files.write_folder(folder / name, fill)
    files.write_bytes(folder / LATEST, f"{name}\n".encode())
    for old in sorted(folder.glob("step-*"))[:-KEEP]:
        shutil.rmtree(old)
    return folder / name


def load_checkpoint(folder: Path, model: SeqDQN) -> dict[str, Any]:
    """Restore the newest sound checkpoint of a run into a model built from the same configuration; returns `extra`.

    Raises PolicyError when no checkpoint is sound, or it does not fit the model.
    """
    faults: list[str] = []
    for path in sorted(folder.glob("step-*"), reverse=True):
        try:
            state = json.loads((path / STATE).read_text(encoding="utf-8"))
            for file, digest in state["sha256"].items():
                if files.sha256(path / file) != digest:
                    raise ValueError(f"{file} is damaged")
            arrays, replay = load_file(path / MODEL), load_file(path / REPLAY)
        except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
            faults.append(f"{path.name}: {error}")
            continue
        _restore(model, state, arrays, replay, path)
        return dict(state["extra"])
    raise PolicyError(f"{folder} holds no sound checkpoint ({'; '.join(faults) or 'there is none'}); start a new run")


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


def restored_generator(state: dict[str, Any]) -> np.random.Generator:
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


def _model_arrays(model: SeqDQN) -> Arrays:
    arrays: Arrays = {"torch_rng": torch.get_rng_state().numpy()}
    for prefix, net in (("q_net", model.q_net), ("q_net_target", model.q_net_target)):
        for key, value in net.state_dict().items():
            arrays[f"{prefix}/{key}"] = value.detach().cpu().numpy()
    for index, slots in model.policy.optimizer.state_dict()["state"].items():
        for key, value in slots.items():
            arrays[f"optimizer/{index}/{key}"] = np.asarray(torch.as_tensor(value).cpu().numpy())
    return {key: np.ascontiguousarray(value) for key, value in arrays.items()}


def _restore(model: SeqDQN, state: dict[str, Any], arrays: Arrays, replay: Arrays, path: Path) -> None:
    try:
        for prefix, net in (("q_net", model.q_net), ("q_net_target", model.q_net_target)):
            head = f"{prefix}/"
            tensors = {k.removeprefix(head): torch.from_numpy(v) for k, v in arrays.items() if k.startswith(head)}
            net.load_state_dict(tensors)
        _restore_optimizer(model, arrays)
        restore_replay(_replay(model), replay)
        _replay(model).rng = restored_generator(state["replay_rng"])
        model.rng = restored_generator(state["explore_rng"])
        model.num_timesteps, model._n_updates = int(state["num_timesteps"]), int(state["n_updates"])
        model._episode_num = int(state["episodes"])
        torch.set_rng_state(torch.from_numpy(arrays["torch_rng"]))
    except (RuntimeError, KeyError, ValueError, IndexError) as error:
        raise PolicyError(f"{path} does not fit this configuration: {error}; use the run's own config.json") from error


def _restore_optimizer(model: SeqDQN, arrays: Arrays) -> None:
    slots: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in arrays.items():
        if key.startswith("optimizer/"):
            _, index, name = key.split("/")
            slots.setdefault(int(index), {})[name] = torch.from_numpy(value.reshape(()) if name == "step" else value)
    plain = model.policy.optimizer.state_dict()
    model.policy.optimizer.load_state_dict({"state": slots, "param_groups": plain["param_groups"]})
