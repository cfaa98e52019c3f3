"""What the commands that train share: options, towns, run folder, the training, its report."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from wcsim.agents.opening.learner_registry import Q_LEARNING, learner_from_config
from wcsim.agents.runs.run_folder import ResolvedRun, has_results
from wcsim.cli.shared.common import (
    remove_folders_on_failure,
    split_nonempty_list,
    workers_from_options,
    write_json,
)
from wcsim.cli.shared.consoles import StageBar, choose_result_console, print_sumo_overrides, warn
from wcsim.cli.shared.exit_codes import NothingSavedInterrupt
from wcsim.cli.shared.run_config import (
    format_test_command,
    refuse_held_out_users,
    require_matching_learner,
    settings_from_learner,
)
from wcsim.cli.shared.training_options import OutputOptions, QLearningBaseOptions, TrainingOptions
from wcsim.config import LearnConfig, RunConfig, resolve
from wcsim.config.held_out import refuse_held_out
from wcsim.config.load import Layer, is_override_of_key
from wcsim.core import reading
from wcsim.core.reading import SETTINGS, pluralize
from wcsim.errors import (
    ConfigError,
    DiskFullError,
    InterruptedRunError,
    PolicyError,
    TownError,
    WorkersError,
)
from wcsim.server.specs import RunInfo
from wcsim.server.workers.machines import WorkerPoolSettings
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.making.asked_town import refuse_held_out_town, requested_town
from wcsim.towns.scenario.town import Town, by_name, streets_hash

if TYPE_CHECKING:  # these load PyTorch, which --help must not
    from wcsim.agents.learning.callbacks import TrainProgress
    from wcsim.agents.rounds.train_rounds import RoundProgress

# Of [learn]: a preset's own values shrink when --steps asks for a short run.
_SHRINKING: Final = ("phase1_steps", "learning_starts")


def make_q_config_layers(
    options: QLearningBaseOptions,
    network: str = "",
    more: Mapping[str, Any] | None = None,
    file: Path | None = None,
) -> tuple[Layer, ...]:
    """The layers over the preset of Q-learning; `resolve_run_settings` adds the window.

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
            or any(is_override_of_key(text, f"learn.{key}") for text in options.set)
        }
        parts = _shrunk_parts(config.learn, options.steps, own)
        layers = (*layers, {"learn": {"total_steps": options.steps, **parts}})
        config = resolve(options.preset, *layers)
    require_matching_learner(config, Q_LEARNING)
    refuse_held_out_users(config)
    return (*layers, settings_from_learner(config))


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


def choose_towns_and_folder(
    options: TrainingOptions, info: RunInfo, config: RunConfig
) -> tuple[Town, RunInfo, Path]:
    """The run's first town, the run's facts with its other towns, and its folder.

    Raises:
        TownError: A town is kept for tests, or two have one name.
        ConfigError: The world would never change town.
    """
    words = split_nonempty_list("--town", options.town)
    towns = [find_training_town(word, options.allow_test_town) for word in words]
    if len(by_name(towns)) < len(towns):
        raise ConfigError(f"--town {options.town}: a town comes twice; expected each once")
    if len(towns) > 1 and not learner_from_config(config).own_worlds and not config.epoch_ticks:
        raise ConfigError(
            f"--town {options.town}: with world.epoch_ticks=0 the world never changes town; set it "
            "above 0"
        )
    more = {word: streets_hash(town) for word, town in zip(words[1:], towns[1:], strict=True)}
    out = options.out or Path("runs") / f"{towns[0].name}-{options.preset}-{options.seed}"
    return towns[0], replace(info, more_towns=more), out


def find_training_town(name: str, allow_test_town: bool) -> Town:
    """The town to train in. Raises TownError or ConfigError for one that is kept for tests."""
    refuse_held_out("town", (name,), "--town")
    town = requested_town(name)
    refuse_held_out_town(town)
    validate_net(town.net)
    if town.split == "test" and not allow_test_town:
        raise TownError(
            f"{town.name} is a test town; networks trained in it cannot be tested fairly. "
            "Train in a town of split train (wcsim town list), or pass --allow-test-town"
        )
    return town


class _TrainingBar(StageBar):
    """The bar of a training, and what is printed beside it.

    Args:
        town: Name of the town.
        run: The run.
        note: How it learns; "" prints nothing.
        verbose: Whether overrides are printed with their reasons.
    """

    def __init__(self, town: str, run: ResolvedRun, note: str, verbose: bool) -> None:
        super().__init__(learner_from_config(run.config).first_stage)
        self._town = town
        self._run = run
        self._note = note
        self._verbose = verbose
        self._printed = False
        self._show_step = make_progress_callback(self)

    def print_note(self) -> None:
        """Print how the network learns, above the bar."""
        if self._note:
            self.print_line(f"note: {self._note}")

    def show_step(self, now: TrainProgress) -> None:
        """Show the progress of Q-learning; first which options of SUMO the run overrides."""
        if not self._printed:
            self._printed = True
            print_sumo_overrides(
                choose_result_console(self.console),
                self._town,
                self._run.info.overrides,
                (self._note,) if self._note else (),
                verbose=self._verbose,
                in_manifest=True,
            )
        self._show_step(now)

    def show_round(self, now: RoundProgress) -> None:
        """Show a round and its workers; a log gets a line when driving and when learning ends."""
        rows = {}
        for worker in now.workers:
            busy = f"segment {worker.key}, {worker.for_s:.0f} s"
            rows[worker.name] = busy if worker.key else "free"
        self.rows(rows)
        learns = now.learned > 0 or now.segments == now.of
        at = f"update {now.learned}" if learns else f"segment {now.segments} of {now.of}"
        text = f"round {now.round + 1} of {now.rounds}, "
        stage = "learning" if learns else "driving"
        self.show(compute_finished_share(now, self._run.config), text + at, stage)
        if self.is_terminal:
            return
        text += f"{now.segments} of {now.of} segments"
        if now.updates:
            self.print_line(f"{text}, {pluralize(now.updates, 'update')}, loss {now.loss:.4f}")
        elif now.segments == now.of and not now.learned:
            self.print_line(f"{text}: learning")

    def warn(self, text: str) -> None:
        """Print what went wrong without ending the training."""
        warn(text)


def make_progress_callback(bar: StageBar) -> Callable[[TrainProgress], None]:
    """Shows the progress of Q-learning; a log gets a line for each tenth of the run."""
    tenths = 0

    def show(now: TrainProgress) -> None:
        nonlocal tenths
        # The last steps are done together, and may be a few more.
        step = min(now.step, now.total_steps)
        kpi1 = "" if now.kpi1 is None else f", KPI 1 {now.kpi1:.3f}"
        known = f"{pluralize(now.episodes, 'episode')}, {pluralize(now.crashes, 'crash')}{kpi1}"
        text = f"{step}/{now.total_steps} steps, {known}"
        phase = f"phase {now.phase}"
        bar.show(step / now.total_steps, text, phase)
        if not bar.is_terminal and 10 * step // now.total_steps > tenths:
            tenths = 10 * step // now.total_steps
            bar.print_line(f"{phase}: {text}", left=False)

    return show


def compute_finished_share(now: RoundProgress, config: RunConfig) -> float:
    """Which share of a run's work is done, 0 to 1.

    A step that is driven and one in a batch that is learned from cost about the same on two cores.
    From the second round on worlds drive while the network learns, so that a round takes as long as
    the longer of both.
    """
    collect, danger = config.collect, config.danger
    drive = collect.segments * collect.ticks * collect.chairs
    learn = danger.updates * danger.batch
    both = max(drive, learn)
    last = now.rounds - 1
    before = 0 if now.round == 0 else drive + now.round * both
    driven = drive * now.segments / max(1, now.of) if now.round == 0 else 0.0
    learned = 1.0 if now.updates else now.learned / danger.updates
    done = before + driven + learned * (learn if now.round == last else both)
    return done / (drive + last * both + learn)


def train_single_network(
    run: ResolvedRun,
    town: Town,
    *,
    note: str = "",
    verbose: bool = False,
    machines: WorkerPoolSettings | None = None,
) -> Path:
    """Train one network with a progress bar; returns the run folder.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingSavedInterrupt: ... before anything was driven.
        WcsimError: A setting, the folder or a machine cannot be used.
    """
    learner = learner_from_config(run.config)
    machines = machines or workers_from_options("", None, "--worlds")
    with _TrainingBar(town.name, run, note, verbose) as bar:
        try:
            with remove_run_without_results(run.out):
                return learner.train(run, town, machines, bar)
        except InterruptedRunError:
            if run.out.exists():
                raise
            raise NothingSavedInterrupt(
                "stopped before the first segment was driven; nothing is saved"
            ) from None


@contextmanager
def remove_run_without_results(run: Path) -> Iterator[None]:
    """Remove a run folder that the block made, when the block fails without results.

    It stays after a full disk, and when a cluster is lost: wcsim resume continues. For a run of
    several clients `GroupRunFolder.fruitless` judges, which looks at the world's journal, too.
    """
    is_new = not run.exists()
    with remove_folders_on_failure(run.parent):
        try:
            yield
        except (DiskFullError, OSError, WorkersError):
            raise
        except BaseException:
            if is_new and not has_results(run):
                shutil.rmtree(run, ignore_errors=True)
            raise


def print_finished_run(options: OutputOptions, run: ResolvedRun) -> None:
    """Print where a finished run is and how to test it."""
    if not learner_from_config(run.config).own_worlds:  # rounds log no KPI 1
        print_kpi1_limit_steps(run.out)
    trained_in = (run.info.town, *run.info.more_towns)
    command = format_test_command(run.out, run.config.learn.network, trained_in)
    print(f"run folder: {run.out}    test it: {command}")
    write_json(options.json, {"run": str(run.out), "town": run.info.town, "seed": run.info.seed})


def print_kpi1_limit_steps(run: Path) -> None:
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
