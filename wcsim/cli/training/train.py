"""`wcsim train`: a danger network learns to assist, in rounds; `wcsim train-q`: a network does, by Q-learning."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from wcsim.agents.opening.learner_registry import DANGER_ROUNDS, Q_LEARNING, learner_of
from wcsim.agents.runs.data_folder import DATA, SEGMENTS
from wcsim.agents.runs.metrics import logged_rows
from wcsim.agents.runs.run_folder import METRICS, ResolvedRun
from wcsim.cli.shared.common import (
    Cluster,
    Finds,
    Flag,
    OutFile,
    OutFolder,
    Repeated,
    SettingsOptions,
    Steps,
    Worlds,
    fresh_folders,
    machines_of,
    parse,
    some_words,
    write_json,
)
from wcsim.cli.shared.consoles import StageBar, beside, print_overrides, warn
from wcsim.cli.shared.exit_codes import Exit, NothingKept
from wcsim.cli.shared.run_config import (
    how_to_test,
    learning,
    require_learner,
    require_users,
    resolve_run,
)
from wcsim.config import LearnConfig, RunConfig, resolve
from wcsim.config.load import Layer, sets_key
from wcsim.core import reading
from wcsim.core.reading import SETTINGS
from wcsim.errors import ConfigError, DiskFullError, InterruptedRunError, TownError, WorkersError
from wcsim.server.specs import RunInfo
from wcsim.server.workers.machines import Machines
from wcsim.supervisor.rewards import find_reward_term
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import Town, by_name, streets_hash


@dataclass(kw_only=True)
class ToldOptions:
    """What a training says, and where."""

    verbose: Flag = False
    """Show which SUMO options of the town are overridden, and why."""
    json: OutFile = None
    """Write the path of the run to this file."""


@dataclass(kw_only=True)
class _TrainingOptions(SettingsOptions, ToldOptions):
    """What every new training takes."""

    town: str = "helsinki"
    """Training towns, separated by commas: a town's name, its folder, or a .sumocfg file; made:SEED is generated. The
    world changes town after world.epoch_ticks. Test towns need --allow-test-town."""
    seed: int = 0
    """Random seed: equal seeds give equal weights."""
    out: OutFolder = None
    """Run folder; default runs/TOWN-PRESET-SEED."""
    allow_test_town: bool = False
    """Allow training in a test town."""


@dataclass(kw_only=True)
class _RoundsOptions(_TrainingOptions):
    """Train a danger network: users and an oracle drive in rounds, and it learns which positions end badly.

    `wcsim train-q` learns by Q-learning instead.
    """

    preset: str = "quick"
    """Preset to start from: quick, laptop, best or reward. Without a name: a table of all."""
    data: Repeated = ()
    """Data folder of `wcsim collect` that the network also learns from, as collect.data."""
    worlds: Worlds = None
    """Worker processes that drive data. Results do not depend on their number. None: one per core, at most 4."""
    cluster: Cluster = ""
    """HOST:PORT of a Ray cluster that drives data, or `local`. Data and weights stay the same (docs/cluster.md)."""


def run(words: list[str]) -> int:
    """Train and leave a run folder."""
    options = parse(_RoundsOptions, words, "train")
    machines = machines_of(options.cluster, options.worlds, "--worlds")
    data = {"collect": {"data": list(options.data)}} if options.data else None
    config = resolve(options.preset, options.config, options.set, data)
    config = resolve(config, learning(config))
    require_learner(config, DANGER_ROUNDS)
    require_users(config, (options.set, options.config))
    return _trained(
        options, RunInfo(seed=options.seed, command=("wcsim", "train", *words)), config, machines
    )


def _trained(
    options: _TrainingOptions, info: RunInfo, config: RunConfig, machines: Machines | None = None
) -> int:
    """Train one network as it was asked for, and say where it is; raises as `placed`, `resolve_run`, `train_in` do."""
    town, info, out = placed(options, info, config)
    made = resolve_run(config, info, town, out)
    note = learner_of(config).describe(config)
    train_in(made, town, note=note, verbose=options.verbose, machines=machines)
    return told(options, made)


def told(options: ToldOptions, run: ResolvedRun) -> int:
    """Say where a finished run is and how to test it; returns the exit code."""
    from wcsim.cli.training.clients import print_crossings

    print_crossings(run.out)
    trained_in = (run.info.town, *run.info.more_towns)
    print(
        f"run folder: {run.out}    test it: {how_to_test(run.out, run.config.learn.network, trained_in)}"
    )
    write_json(options.json, {"run": str(run.out), "town": run.info.town, "seed": run.info.seed})
    return Exit.DONE


def placed(
    options: _TrainingOptions, info: RunInfo, config: RunConfig
) -> tuple[Town, RunInfo, Path]:
    """The run's own town, what is known of a run with those that take turns with it, and its folder.

    Raises:
        TownError: One is kept for tests, or two have one name.
        ConfigError: The world would never change town.
    """
    typed = some_words("--town", options.town)
    towns = [checked_town(word, options.allow_test_town) for word in typed]
    if len(by_name(towns)) < len(towns):
        raise ConfigError(f"--town {options.town}: a town comes twice; expected each once")
    if len(towns) > 1 and not learner_of(config).own_worlds and not config.epoch_ticks:
        raise ConfigError(
            f"--town {options.town}: with world.epoch_ticks=0 the world never changes town; set it above 0"
        )
    more = {word: streets_hash(town) for word, town in zip(typed[1:], towns[1:], strict=True)}
    out = options.out or Path("runs") / f"{towns[0].name}-{options.preset}-{options.seed}"
    return towns[0], replace(info, more_towns=more), out


def checked_town(name: str, allow_test_town: bool) -> Town:
    """The town to train in. Raises TownError for one that is kept for tests."""
    town = asked_town(name)
    validate_net(town.net)
    if town.split == "test" and not allow_test_town:
        raise TownError(
            f"{town.name} is a test town; networks trained in it cannot be tested fairly. "
            "Train in a town of split train (wcsim town list), or pass --allow-test-town"
        )
    return town


class TrainingBar(StageBar):
    """The bar of a training, and what is printed beside it.

    Args:
        stage: Name of the first stage.
        town: Name of the town.
        run: The run.
        note: How it learns; "" prints nothing.
        verbose: Whether overrides are printed with their reasons.
    """

    def __init__(self, stage: str, town: str, run: ResolvedRun, note: str, verbose: bool) -> None:
        super().__init__(stage)
        self._town = town
        self._overrides = run.info.overrides
        self._note = note
        self._verbose = verbose
        self._printed = False

    def print_note(self) -> None:
        """Print how the network learns, above the bar."""
        if self._note:
            self.say(f"note: {self._note}")

    def print_overrides(self) -> None:
        """Print once which options of SUMO the run overrides, and how the network learns."""
        if self._printed:
            return
        self._printed = True
        notes = (self._note,) if self._note else ()
        print_overrides(
            beside(self.console),
            self._town,
            self._overrides,
            notes,
            verbose=self._verbose,
            kept=True,
        )

    def warn(self, text: str) -> None:
        """Print what went wrong without ending the training."""
        warn(text)


def train_in(
    run: ResolvedRun,
    town: Town,
    *,
    note: str = "",
    verbose: bool = False,
    machines: Machines | None = None,
) -> Path:
    """Train one network with a progress bar; returns the run folder.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingKept: ... before anything was driven.
        WcsimError: A setting, the folder or a machine cannot be used.
    """
    learner = learner_of(run.config)
    machines = machines or machines_of("", None, "--worlds")
    with TrainingBar(learner.first_stage, town.name, run, note, verbose) as bar:
        try:
            with gone_if_nothing_came_of_it(run.out):
                return learner.train(run, town, machines, bar)
        except InterruptedRunError:
            if run.out.exists():
                raise
            raise NothingKept(
                "stopped before the first segment was driven; nothing is saved"
            ) from None


@contextmanager
def gone_if_nothing_came_of_it(run: Path) -> Iterator[None]:
    """Remove a run folder made in the block when it fails before an episode, a segment or a checkpoint was saved.

    It stays after a full disk, and when a cluster is lost: wcsim resume goes on.
    """
    fresh = not run.exists()
    with fresh_folders(run.parent):
        try:
            yield
        except (DiskFullError, OSError, WorkersError):
            raise
        except BaseException:
            if fresh and not came_of(run):
                shutil.rmtree(run, ignore_errors=True)
            raise


def came_of(run: Path) -> bool:
    """Whether an episode, a segment, a checkpoint or a policy was saved in a run folder."""
    return logged_rows(run / METRICS) > 0 or any(
        any(run.glob(f"{kept}/*")) for kept in ("checkpoints", "policies", f"{DATA}/{SEGMENTS}")
    )


_PARTS = ("phase1_steps", "learning_starts")  # of [learn], that shrink with the steps


@dataclass(kw_only=True)
class LearnerOptions(SettingsOptions):
    """What everybody takes who learns by Q-learning."""

    preset: str = "dqn"
    """Preset to start from: dqn or paper. Without a name: a table of all."""
    reward: Annotated[Repeated, Finds(find_reward_term)] = ()
    """Your own reward term as module:Class, added to the paper's terms."""
    steps: Steps = None
    """Total steps, as --set learn.total_steps=N. A preset's first phase of more than half of them shrinks."""


@dataclass(kw_only=True)
class QOptions(LearnerOptions, _TrainingOptions):
    """What every new training by Q-learning takes."""

    hook: str = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""
    tensorboard: bool = False
    """Also log scalars for TensorBoard in the run folder, as --set learn.tensorboard=true."""

    def info(self, command: tuple[str, ...]) -> RunInfo:
        """What is known of a run before its town is."""
        return RunInfo(seed=self.seed, rewards=self.reward, command=command, hook=self.hook)


@dataclass(kw_only=True)
class _QLearningOptions(QOptions):
    """Train a network by Q-learning, from the reward of every step, as in the paper."""

    network: Annotated[str, arg(metavar="NAME")] = ""
    """Name of a network, or your own as module:Class; same as --set learn.network=..."""


def run_q(words: list[str]) -> int:
    """Train by Q-learning, and leave a run folder."""
    options = parse(_QLearningOptions, words, "train-q")
    board = {"learn": {"tensorboard": True}} if options.tensorboard else None
    config = resolve(options.preset, *q_layers(options, options.network, board))
    return _trained(options, options.info(("wcsim", "train-q", *words)), config)


def q_layers(
    asked: LearnerOptions,
    network: str = "",
    more: Mapping[str, Any] | None = None,
    file: Path | None = None,
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
        tables = [
            reading.read_toml(path, SETTINGS).get("learn", {})
            for path in (asked.config, file)
            if path
        ]
        typed = [key for key in _PARTS if any(sets_key(text, f"learn.{key}") for text in asked.set)]
        own = [key for key in _PARTS if key in typed or any(key in table for table in tables)]
        parts = _shrunk_parts(config.learn, asked.steps, own)
        layers = (*layers, {"learn": {"total_steps": asked.steps, **parts}})
        config = resolve(asked.preset, *layers)
    require_learner(config, Q_LEARNING)
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
