"""`wcsim train`: learn to assist, in a town."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Annotated, Self

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from wcsim import seeding
from wcsim.cli.common import OutFile, OutFolder, Repeated, check_folder, parse, write_json
from wcsim.cli.overrides import print_overrides
from wcsim.config import RunConfig, load_run_config
from wcsim.errors import ConfigError, TownError
from wcsim.supervisor.profiles import HELD_OUT
from wcsim.towns.netcheck import validate_net
from wcsim.towns.scenario import scenario_overrides
from wcsim.towns.town import Town, find_town, streets_hash


@dataclass
class Options:
    """Train a network: first to follow the user (action driven learning), then when not to (agent driven learning)."""

    town: str = "helsinki"
    """Town to train in; its split must be train."""
    preset: str = "quick"
    """Settings to begin with: quick or paper."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """TOML file laid over the preset."""
    set: Repeated = ()
    """section.key=value, laid over both; may be given several times."""
    network: str = ""
    """Network by name, or your own as module:Class; the same as --set learn.network=..."""
    reward: Repeated = ()
    """Your own reward term as module:Class, added to the paper's; may be given several times."""
    hook: str = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""
    seed: int = 0
    """Seed of everything: equal seeds give equal weights."""
    out: OutFolder = None
    """Run folder; default runs/TOWN-PRESET-SEED."""
    resume: bool = False
    """Continue an interrupted run from its newest checkpoint."""
    allow_test_town: bool = False
    """Train in a town that is meant for tests."""
    json: OutFile = None
    """Write where the run is to this file."""


def run(words: list[str]) -> int:
    """Train and leave a run folder."""
    options = parse(Options, words, "train")
    overrides = options.set + ((f'learn.network="{options.network}"',) if options.network else ())
    config = load_run_config(options.preset, overrides, options.config)
    if config.env.profile in HELD_OUT:
        raise ConfigError(
            f"profile {config.env.profile} is held out of training, so that tests can ask how a network does with a "
            "user it has never met; expected another env.profile"
        )
    town = checked_town(options.town, options.allow_test_town)
    out = options.out if options.out is not None else Path("runs") / f"{town.name}-{options.preset}-{options.seed}"
    command = ("wcsim", "train", *words)
    folder = train_in(
        town,
        config,
        out,
        options.seed,
        rewards=options.reward,
        resume=options.resume,
        command=command,
        hook=options.hook,
    )
    print(f"run folder: {folder}    test it: wcsim test {folder} --town monaco")
    if options.json is not None:
        write_json(options.json, {"run": str(folder), "town": town.name, "seed": options.seed})
    return 0


def checked_town(name: str, allow_test_town: bool) -> Town:
    """The town to train in. Raises TownError for one that is kept for tests."""
    town = find_town(name)
    validate_net(town.net)
    if town.split == "test" and not allow_test_town:
        raise TownError(
            f"{town.name} is a test town; networks that were trained in it cannot be tested honestly. "
            "Train in a town of split train (wcsim town list), or say --allow-test-town"
        )
    return town


def train_in(
    town: Town,
    config: RunConfig,
    out: Path,
    seed: int,
    *,
    rewards: tuple[str, ...] = (),
    resume: bool = False,
    command: tuple[str, ...] = (),
    hook: str = "",
) -> Path:
    """Train with a progress bar; returns the run folder."""
    from wcsim.agents.callbacks import TrainProgress  # torch is loaded here, not for --help
    from wcsim.agents.env import WheelchairEnv
    from wcsim.agents.plugins import find_reward_term
    from wcsim.agents.registry import find_network
    from wcsim.agents.train import train
    from wcsim.bridge.stage import settings_of
    from wcsim.supervisor.recorded import find_user

    check_folder("--out", out)
    find_network(config.learn.network)
    find_user(config.env.profile)
    terms = tuple(find_reward_term(name) for name in rewards)
    overrides = scenario_overrides(town, settings_of(config, seeding.derive(seed, "sumo")))
    aided = config.learn.aid == "oracle"
    learning = config.model_copy(
        update={"env": config.env.model_copy(update={"max_steps": config.learn.episode_steps, "truth": aided})}
    )
    announce = _once(lambda: print_overrides(Console(highlight=False), town.name, overrides))
    with _Bar(config.learn.total_steps) as bar, _gone_if_nothing_came_of_it(out):

        def show(now: TrainProgress) -> None:
            announce()
            kpi1 = "" if now.kpi1 is None else f", KPI 1 {now.kpi1:.3f}"
            says = f"{now.step}/{now.total_steps} steps, {now.episodes} episodes, {now.crashes} crashes{kpi1}"
            bar.show(now.step, f"phase {now.phase}", says)

        return train(
            learning,
            lambda: WheelchairEnv(town.address, config=learning, reward_terms=terms, run=out, hook=hook),
            out,
            seed,
            show,
            town=town.name,
            town_sha256=streets_hash(town),
            rewards=rewards,
            command=command,
            resume=resume,
            hook=hook,
            overrides=overrides,
        )


def _once(call: Callable[[], None]) -> Callable[[], None]:
    """The same, but only the first time."""
    left = [call]
    return lambda: left.pop()() if left else None


@contextmanager
def _gone_if_nothing_came_of_it(run: Path) -> Iterator[None]:
    """Remove a run folder made in the block when it fails before an episode or a checkpoint was saved."""
    fresh = not run.exists()
    try:
        yield
    except BaseException:
        metrics = run / "metrics.csv"
        episodes = len(metrics.read_bytes().splitlines()) - 1 if metrics.is_file() else 0
        saved = any(run.glob("checkpoints/*")) or any(run.glob("policies/*"))
        if fresh and episodes < 1 and not saved:
            shutil.rmtree(run, ignore_errors=True)
        raise


class _Bar:
    """A progress bar on a terminal; elsewhere, as in a log file, a line for each tenth of the way."""

    def __init__(self, total: int) -> None:
        self._console = Console(stderr=True, highlight=False)
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[says]}"))
        silent = not self._console.is_terminal
        self._bar = Progress(*columns, TimeRemainingColumn(), console=self._console, disable=silent)
        self._task = self._bar.add_task("loading the town", total=total, says="")
        self._total, self._tenths = total, 0

    def show(self, step: int, phase: str, says: str) -> None:
        """Say how far it has come."""
        self._bar.update(self._task, completed=step, description=phase, says=says)
        tenths = 10 * step // self._total
        if not self._console.is_terminal and tenths > self._tenths:
            self._tenths = tenths
            self._console.print(f"{phase}: {says}", soft_wrap=True)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self._bar.stop()
