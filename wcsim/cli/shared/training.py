"""What the commands that train share: options, towns, run folder, the training, its report."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final

from wcsim.agents.opening.learner_registry import Q_LEARNING, learner_of
from wcsim.agents.runs.data_folder import DATA, SEGMENTS
from wcsim.agents.runs.metrics import logged_rows
from wcsim.agents.runs.run_folder import METRICS, ResolvedRun
from wcsim.cli.shared.common import (
    Finds,
    Flag,
    OutFile,
    OutFolder,
    Repeated,
    SettingsOptions,
    Steps,
    fresh_folders,
    machines_of,
    some_words,
    write_json,
)
from wcsim.cli.shared.consoles import StageBar, beside, print_overrides, warn
from wcsim.cli.shared.exit_codes import NothingSaved
from wcsim.cli.shared.run_config import how_to_test, learning, require_learner, require_users
from wcsim.config import LearnConfig, RunConfig, resolve
from wcsim.config.load import Layer, sets_key
from wcsim.core import reading
from wcsim.core.reading import SETTINGS
from wcsim.errors import (
    ConfigError,
    DiskFullError,
    InterruptedRunError,
    PolicyError,
    TownError,
    WorkersError,
)
from wcsim.server.specs import RunInfo
from wcsim.server.workers.machines import Machines
from wcsim.supervisor.rewards import find_reward_term
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import Town, by_name, streets_hash

# Of [learn]: a preset's own values shrink when --steps asks for a short run.
_SHRINKING: Final = ("phase1_steps", "learning_starts")


@dataclass(kw_only=True)
class OutputOptions:
    """What a training prints, and the file that names its run."""

    verbose: Flag = False
    """Show which SUMO options of the town are overridden, and why."""
    json: OutFile = None
    """Write the path of the run to this file."""


@dataclass(kw_only=True)
class TrainingOptions(SettingsOptions, OutputOptions):
    """Options of every new training."""

    town: str = "helsinki"
    """Training towns, separated by commas: a town's name, its folder, or a .sumocfg file; made:SEED is generated. The
    world changes town after world.epoch_ticks. Test towns need --allow-test-town."""  # noqa: E501 - help text
    seed: int = 0
    """Random seed: equal seeds give equal weights."""
    out: OutFolder = None
    """Run folder; default runs/TOWN-PRESET-SEED."""
    allow_test_town: bool = False
    """Allow training in a test town."""


@dataclass(kw_only=True)
class QLearningOptions(SettingsOptions):
    """Options of every command that learns by Q-learning."""

    preset: str = "dqn"
    """Preset to start from: dqn or paper. Without a name: a table of all."""
    reward: Annotated[Repeated, Finds(find_reward_term)] = ()
    """Your own reward term as module:Class, added to the paper's terms."""
    steps: Steps = None
    """Total steps, as --set learn.total_steps=N. A preset's first phase of more than half of them shrinks."""  # noqa: E501 - help text


@dataclass(kw_only=True)
class QTrainingOptions(QLearningOptions, TrainingOptions):
    """Options of every new training by Q-learning."""

    hook: str = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""  # noqa: E501 - help text
    tensorboard: bool = False
    """Also log scalars for TensorBoard in the run folder, as --set learn.tensorboard=true."""

    def info(self, command: tuple[str, ...]) -> RunInfo:
        """What is known of a run before its town is."""
        return RunInfo(seed=self.seed, rewards=self.reward, command=command, hook=self.hook)


def q_layers(
    options: QLearningOptions,
    network: str = "",
    more: Mapping[str, Any] | None = None,
    file: Path | None = None,
) -> tuple[Layer, ...]:
    """The layers over the preset of a training by Q-learning; `resolve_run` adds the window.

    Args:
        options: The command's options.
        network: A network that overrides theirs; "" for theirs.
        more: Tables of keys that further options stand for.
        file: A TOML file over all others, for one of several clients.

    Raises:
        ConfigError: An option cannot be used, the user is kept for tests, or it is no Q-learning.
    """
    named = {"learn": {"network": network}} if network else None
    layers: tuple[Layer, ...] = (options.config, options.set, more, named, file)
    config = resolve(options.preset, *layers)
    if options.steps is not None:
        files = [path for path in (options.config, file) if path]
        tables = [reading.read_toml(path, SETTINGS).get("learn", {}) for path in files]
        own = {
            key
            for key in _SHRINKING
            if any(key in table for table in tables)
            or any(sets_key(text, f"learn.{key}") for text in options.set)
        }
        parts = _shrunk_parts(config.learn, options.steps, own)
        layers = (*layers, {"learn": {"total_steps": options.steps, **parts}})
        config = resolve(options.preset, *layers)
    require_learner(config, Q_LEARNING)
    require_users(config)
    return (*layers, learning(config))


def _shrunk_parts(learn: LearnConfig, steps: int, own: set[str]) -> dict[str, int]:
    """The first phase, and the steps before the first update, of a training of `steps` in all.

    A preset's first phase of more than half of them shrinks in proportion, and so do the steps
    before the first update. The keys in `own` are the user's, and stay.

    >>> _shrunk_parts(LearnConfig(), 60, set())
    {'phase1_steps': 15, 'learning_starts': 2}
    """
    parts = {key: getattr(learn, key) for key in _SHRINKING if key not in own}
    for key, part in parts.items():
        if part > steps / 2:
            parts[key] = round(steps * min(0.5, part / learn.total_steps))
    return parts


def place_run(
    options: TrainingOptions, info: RunInfo, config: RunConfig
) -> tuple[Town, RunInfo, Path]:
    """The run's first town, the run's facts with its other towns, and its folder.

    Raises:
        TownError: A town is kept for tests, or two have one name.
        ConfigError: The world would never change town.
    """
    words = some_words("--town", options.town)
    towns = [training_town(word, options.allow_test_town) for word in words]
    if len(by_name(towns)) < len(towns):
        raise ConfigError(f"--town {options.town}: a town comes twice; expected each once")
    if len(towns) > 1 and not learner_of(config).own_worlds and not config.epoch_ticks:
        raise ConfigError(
            f"--town {options.town}: with world.epoch_ticks=0 the world never changes town; set it "
            "above 0"
        )
    more = {word: streets_hash(town) for word, town in zip(words[1:], towns[1:], strict=True)}
    out = options.out or Path("runs") / f"{towns[0].name}-{options.preset}-{options.seed}"
    return towns[0], replace(info, more_towns=more), out


def training_town(name: str, allow_test_town: bool) -> Town:
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
            self.print_line(f"note: {self._note}")

    def print_overrides(self) -> None:
        """Print once which options of SUMO the run overrides, and how the network learns."""
        if self._printed:
            return
        self._printed = True
        print_overrides(
            beside(self.console),
            self._town,
            self._overrides,
            (self._note,) if self._note else (),
            verbose=self._verbose,
            in_manifest=True,
        )

    def warn(self, text: str) -> None:
        """Print what went wrong without ending the training."""
        warn(text)


def train_network(
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
        NothingSaved: ... before anything was driven.
        WcsimError: A setting, the folder or a machine cannot be used.
    """
    learner = learner_of(run.config)
    machines = machines or machines_of("", None, "--worlds")
    with TrainingBar(learner.first_stage, town.name, run, note, verbose) as bar:
        try:
            with removed_without_results(run.out):
                return learner.train(run, town, machines, bar)
        except InterruptedRunError:
            if run.out.exists():
                raise
            raise NothingSaved(
                "stopped before the first segment was driven; nothing is saved"
            ) from None


@contextmanager
def removed_without_results(run: Path) -> Iterator[None]:
    """Remove a run folder that the block made, when the block fails without results.

    It stays after a full disk, and when a cluster is lost: wcsim resume continues.
    """
    is_new = not run.exists()
    with fresh_folders(run.parent):
        try:
            yield
        except (DiskFullError, OSError, WorkersError):
            raise
        except BaseException:
            if is_new and not has_results(run):
                shutil.rmtree(run, ignore_errors=True)
            raise


def has_results(run: Path) -> bool:
    """Whether an episode, a segment, a checkpoint or a policy was saved in a run folder."""
    return logged_rows(run / METRICS) > 0 or any(
        any(run.glob(f"{folder}/*")) for folder in ("checkpoints", "policies", f"{DATA}/{SEGMENTS}")
    )


def report_run(options: OutputOptions, run: ResolvedRun) -> None:
    """Print where a finished run is and how to test it."""
    print_crossings(run.out)
    trained_in = (run.info.town, *run.info.more_towns)
    command = how_to_test(run.out, run.config.learn.network, trained_in)
    print(f"run folder: {run.out}    test it: {command}")
    write_json(options.json, {"run": str(run.out), "town": run.info.town, "seed": run.info.seed})


def print_crossings(run: Path) -> None:
    """Print where KPI 1 of each client fell below its limit; runs in rounds log no KPI 1."""
    # Not at the top: the pages' figures take long to load, and --help needs none.
    from wcsim.view.report.learning_curve import crossing, read_training

    try:
        steps = read_training([run]).steps
    except PolicyError as error:
        return warn(str(error))
    for name, rows in steps.items():
        if rows:
            print(f"{name}: {crossing(rows).told()}")
