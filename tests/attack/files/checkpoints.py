"""Attacks on checkpoints: whatever is done to them, a learner is one of those that were saved, or what it was."""

import copy
import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import torch
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import nn

from tests.agents.toy import ToyStreet, load_checkpoint, toy_camera, train_toy
from tests.attack.files.damage import ANY, Damage, bomb, change, edited, flipped
from tests.attack.outcomes import Case
from tests.attack.scenarios.twists import Rng, draws, integer, pick
from wcsim.agents.learning.build import build_q_learner
from wcsim.agents.learning.checkpoint import (
    _generator_state,
    _model_arrays,
    _replay_arrays,
    _restored_generator,
    save_checkpoint,
)
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.runs.checkpoint import STATE, format_checkpoint_name, list_checkpoints
from wcsim.config import LearnConfig, RunConfig
from wcsim.errors import PolicyError

CAMERA = toy_camera(8, 8)
STEPS, EVERY = 120, 40
NAMES = (STATE, "model.safetensors", "replay.safetensors")
Extra = dict[str, int | float | str | bool]


class Tiny(nn.Module):
    """The smallest network that there is."""

    def __init__(self, image_shape: tuple[int, int, int], vector_size: int) -> None:
        super().__init__()
        self.dense = nn.Linear(image_shape[0] + vector_size, 2)

    def forward(self, image: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
        return torch.relu(self.dense(torch.cat([image.mean(dim=(2, 3)), vector], dim=1)))


def config() -> RunConfig:
    """Everything as small as it can be."""
    learn = LearnConfig(
        network=f"{__name__}:Tiny", total_steps=STEPS, phase1_steps=50, learning_starts=8, replay_frames=100,
        batch_size=4, checkpoint_every=EVERY,
    )  # fmt: skip
    return RunConfig(cameras=(CAMERA,), learn=learn)


def street() -> ToyStreet:
    return ToyStreet(CAMERA, max_steps=9)


class Bench:
    """Sound checkpoints, and a learner that is fresh again before each case."""

    def __init__(self, work: Path) -> None:
        self.sound = train_toy(config(), work / "sound", street) / "checkpoints"
        self.model = build_q_learner(config(), DummyVecEnv([street]), 7)
        self._nets = [copy.deepcopy(net.state_dict()) for net in (self.model.q_net, self.model.q_net_target)]
        self._optimizer = copy.deepcopy(self.model.policy.optimizer.state_dict())
        self._rngs = _generator_state(self.model.rng), _generator_state(self.model.replay_buffer.rng)
        self.known: dict[int, str] = {}
        for path in list_checkpoints(self.sound):
            alone = work / "alone"
            shutil.copytree(path, alone / path.name)
            self.fresh()
            loaded = load_checkpoint(alone, self.model)
            self.known[self.model.num_timesteps] = content(self.model, loaded.value.model_dump())
            shutil.rmtree(alone)
        self.fresh()
        self.blank = content(self.model, {})

    def fresh(self) -> None:
        """The learner as it was built."""
        model = self.model
        for net, state in zip((model.q_net, model.q_net_target), self._nets, strict=True):
            net.load_state_dict(state)
        model.policy.optimizer.load_state_dict(copy.deepcopy(self._optimizer))
        model.replay_buffer.reset()
        model.rng, model.replay_buffer.rng = map(_restored_generator, self._rngs)
        model.num_timesteps = model._n_updates = model._episode_num = 0
        torch.manual_seed(1)


def content(model: SeqDQN, extra: Extra) -> str:
    """A hash over everything that a checkpoint keeps of a learner."""
    digest = hashlib.blake2b(digest_size=16)
    for arrays in (_model_arrays(model), _replay_arrays(model.replay_buffer)):
        for key in sorted(arrays):
            digest.update(f"{key} {arrays[key].dtype} {arrays[key].shape}".encode() + arrays[key].tobytes())
    rngs = _generator_state(model.rng), _generator_state(model.replay_buffer.rng)
    counts = model.num_timesteps, model._n_updates, model._episode_num
    digest.update(repr((rngs, counts, sorted(extra.items()))).encode())
    return digest.hexdigest()


def cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """So many attacks."""
    work.mkdir(parents=True, exist_ok=True)
    bench = Bench(work)
    for number, rng in draws(count, seed):
        attack = pick(rng, ATTACKS)
        name = f"{number} {attack.__name__}"
        yield Case(area="checkpoints", name=name, feed=lambda a=attack, r=rng: _feed(bench, a, r, work / "case"))


Attack = Callable[[Path, Rng], set[int]]
"""Does something to a folder of checkpoints; returns the steps whose checkpoints are not what they were."""


def _feed(bench: Bench, attack: Attack, rng: Rng, folder: Path) -> bool:
    shutil.copytree(bench.sound, folder)
    try:
        hurt = attack(folder, rng)
        bench.fresh()
        expected = max((step for step in bench.known if step not in hurt), default=-1)
        strays = _strays(folder)
        try:
            loaded = load_checkpoint(folder, bench.model)
        except PolicyError:
            if content(bench.model, {}) == bench.blank and expected < 0:
                raise
            return False
        step = bench.model.num_timesteps
        right = step >= expected and bench.known.get(step) == content(bench.model, loaded.value.model_dump())
        went_on = right and _goes_on(bench.model, folder, loaded.value.model_dump(), rng)
        return went_on and _strays(folder) | {path.name for path in list_checkpoints(folder)} >= strays
    finally:
        shutil.rmtree(folder)


def _goes_on(model: SeqDQN, folder: Path, extra: Extra, rng: Rng) -> bool:
    """Whether the next checkpoints are there after they were written, and can be loaded."""
    model.num_timesteps = pick(rng, (175, 99_999_999, 100_000_000, 999_999_999, 10**10))
    for _ in range(2):
        model.num_timesteps += 1
        written = save_checkpoint(folder, model, extra)
        if not written.is_dir() or len(list_checkpoints(folder)) > 4:
            return False
    kept = content(model, extra)
    return load_checkpoint(folder, model).path == written and content(model, extra) == kept


def _strays(folder: Path) -> set[str]:
    known = {path.name for path in list_checkpoints(folder)} | {".step-00000090.tmp"}
    return {path.name for path in folder.iterdir()} - known


def _some(folder: Path, rng: Rng) -> list[Path]:
    """One of the checkpoints, more often the newest, or several."""
    paths = list_checkpoints(folder)[::-1]
    count = int(pick(rng, (1, 1, 1, 1, 2, 3)))
    return paths[:count] if rng.random() < 0.7 else [pick(rng, paths)]


def _steps(paths: list[Path]) -> set[int]:
    return {int(path.name[5:]) for path in paths}


def _change(paths: list[Path], name: str, how: Damage, rng: Rng) -> set[int]:
    return _steps([path for path in paths if change(path / name, how, rng)])


def damaged_file(folder: Path, rng: Rng) -> set[int]:
    return _change(_some(folder, rng), pick(rng, NAMES), pick(rng, ANY), rng)


def flipped_state(folder: Path, rng: Rng) -> set[int]:
    return _change(_some(folder, rng), STATE, flipped, rng)


def edited_state(folder: Path, rng: Rng) -> set[int]:
    return _change(_some(folder, rng), STATE, edited, rng)


def bombed_state(folder: Path, rng: Rng) -> set[int]:
    return _change(_some(folder, rng), STATE, lambda _, r: bomb(r), rng)


def moved_file(folder: Path, rng: Rng) -> set[int]:
    """A file of another checkpoint, or none."""
    (one, *_), other, name = _some(folder, rng), pick(rng, list_checkpoints(folder)), pick(rng, NAMES)
    data = (other / name).read_bytes()
    (one / name).unlink()
    if rng.random() < 0.7:
        (one / name).write_bytes(data)
        return set() if one == other else _steps([one])
    return _steps([one])


def odd_file(folder: Path, rng: Rng) -> set[int]:
    """Something that is no regular file."""
    (one, *_), name = _some(folder, rng), pick(rng, NAMES)
    (one / name).unlink()
    what = integer(rng, 5)
    if what == 0:
        os.mkfifo(one / name)
    elif what == 1:
        (one / name).mkdir()
    else:
        (one / name).symlink_to(("/dev/zero", "nowhere", "/proc/self/mem")[what - 2])
    return _steps([one])


def odd_names(folder: Path, rng: Rng) -> set[int]:
    """Names beside the checkpoints that are none."""
    old, new = list_checkpoints(folder)[0], list_checkpoints(folder)[-1]
    names = (
        "step-zzz", f"{old.name}-copy", "step-90", "step-000000090", "step--0000090", "step-", "step-0000009\u0663",
        f"{new.name}.damaged", ".step-00000090.tmp", "step-00000090x", "step-" + "9" * 200,
    )  # fmt: skip
    for name in set(pick(rng, names) for _ in range(3)):
        what = integer(rng, 3)
        if what == 0:
            shutil.copytree(old, folder / name)
        elif what == 1:
            (folder / name).symlink_to(pick(rng, (old.name, "/", "nowhere")))
        else:
            (folder / name).write_bytes(b"x")
    return set()


def odd_folder(folder: Path, rng: Rng) -> set[int]:
    """A checkpoint under the name of another step, or a link, a file or an empty folder in place of one."""
    old, one = (
        list_checkpoints(folder)[0],
        folder / format_checkpoint_name("step", int(pick(rng, (40, 80, 120, 121, 10**8, 10**17)))),
    )
    hurt = _steps([one]) if one.is_dir() else set()
    if one == old:
        return set()
    if one.is_dir():
        shutil.rmtree(one)
    what = integer(rng, 4)
    if what == 0:
        shutil.copytree(old, one)
    elif what == 1:
        one.symlink_to(old.name)
    elif what == 2:
        one.write_bytes(b"x")
    else:
        one.mkdir()
    return hurt


ATTACKS: tuple[Attack, ...] = (
    damaged_file, damaged_file, damaged_file, flipped_state, flipped_state, edited_state, edited_state, edited_state,
    bombed_state, moved_file, odd_file, odd_names, odd_folder,
)  # fmt: skip
