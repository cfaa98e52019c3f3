"""`wcsim train-q`: a network learns to assist by Q-learning; and the configuration of whoever learns so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from wcsim.cli.shared.common import Finds, Repeated, SettingsOptions, Steps, parse
from wcsim.cli.shared.run_config import learning, require_head, require_users
from wcsim.cli.training.train import TrainingOptions, trained
from wcsim.config import CONFIG_FILE, LearnConfig, resolve
from wcsim.config.load import Layer, sets_key
from wcsim.core import reading
from wcsim.server.specs import RunInfo
from wcsim.supervisor.rewards import find_reward_term

_PARTS = ("phase1_steps", "learning_starts")  # of [learn], that shrink with the steps


@dataclass(kw_only=True)
class LearnerOptions(SettingsOptions):
    """What everybody takes who learns by Q-learning."""

    preset: str = "dqn"
    """Preset to start from: dqn or paper."""
    reward: Annotated[Repeated, Finds(find_reward_term)] = ()
    """Your own reward term as module:Class, added to the paper's terms."""
    steps: Steps = None
    """Total steps, as --set learn.total_steps=N. A preset's first phase of more than half of them shrinks."""


@dataclass(kw_only=True)
class QOptions(LearnerOptions, TrainingOptions):
    """What every new training by Q-learning takes."""

    hook: str = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""
    tensorboard: bool = False
    """Also log scalars for TensorBoard in the run folder, as --set learn.tensorboard=true."""

    def info(self, command: tuple[str, ...]) -> RunInfo:
        """What is known of a run before its town is."""
        return RunInfo(seed=self.seed, rewards=self.reward, command=command, hook=self.hook)


@dataclass(kw_only=True)
class _Options(QOptions):
    """Train a network by Q-learning, from the reward of every step, as in the paper."""

    network: Annotated[str, arg(metavar="NAME")] = ""
    """Name of a network, or your own as module:Class; same as --set learn.network=..."""


def run(words: list[str]) -> int:
    """Train and leave a run folder."""
    options = parse(_Options, words, "train-q")
    board = {"learn": {"tensorboard": True}} if options.tensorboard else None
    config = resolve(options.preset, *q_layers(options, options.network, board))
    return trained(options, options.info(("wcsim", "train-q", *words)), config)


def q_layers(
    asked: LearnerOptions, network: str = "", more: Mapping[str, Any] | None = None, file: Path | None = None
) -> tuple[Layer, ...]:
    """What is laid over the preset to learn as it was asked for; the window is left to `resolve_run`.

    Args:
        asked: The options.
        network: Laid over what they say; "" for theirs.
        more: Tables of keys that other options stand for.
        file: TOML file laid over all, for one of several clients.

    Raises:
        ConfigError: An option cannot be used, the user is kept for tests, or it is no Q-learning.
    """
    named = {"learn": {"network": network}} if network else None
    layers: tuple[Layer, ...] = (asked.config, asked.set, more, named, file)
    config = resolve(asked.preset, *layers)
    if asked.steps is not None:
        tables = [reading.read_toml(path, CONFIG_FILE).get("learn", {}) for path in (asked.config, file) if path]
        typed = [key for key in _PARTS if any(sets_key(text, f"learn.{key}") for text in asked.set)]
        own = [key for key in _PARTS if key in typed or any(key in table for table in tables)]
        parts = _shrunk_parts(config.learn, asked.steps, own)
        layers = (*layers, {"learn": {"total_steps": asked.steps, **parts}})
        config = resolve(asked.preset, *layers)
    require_head(config, in_rounds=False)
    require_users(config)
    return (*layers, learning(config))


def _shrunk_parts(learn: LearnConfig, steps: int, own: list[str]) -> dict[str, int]:
    """First phase and wait for the first update in a training of so many steps in all.

    A preset's first phase of more than half of them shrinks in proportion, and so does its wait for the first update.
    The keys in `own` are the user's, and stay.

    >>> _shrunk_parts(LearnConfig(), 60, [])
    {'phase1_steps': 15, 'learning_starts': 2}
    """
    parts = {key: getattr(learn, key) for key in _PARTS if key not in own}
    return {
        key: part if part <= steps / 2 else round(steps * min(0.5, part / learn.total_steps))
        for key, part in parts.items()
    }
