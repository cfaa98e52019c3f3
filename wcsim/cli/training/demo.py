"""`wcsim demo`, or `make demo`: train a network, and test its help in a town that is new to it."""

from __future__ import annotations

import shlex
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from wcsim.agents.opening.learner_registry import DANGER_ROUNDS
from wcsim.agents.opening.named_policy import RULES
from wcsim.cli.evaluation.judged_suite import SuiteTestOptions, make_suite_order, run_suite_and_save
from wcsim.cli.evaluation.result_tables import print_test_result
from wcsim.cli.shared.common import OutFolder, Repeated, parse_options, require_writable_folder
from wcsim.cli.shared.consoles import StageBar, stdout_console
from wcsim.cli.shared.run_config import (
    refuse_held_out_users,
    require_matching_learner,
    resolve_run_settings,
)
from wcsim.cli.shared.training import find_training_town, train_single_network
from wcsim.config import RunConfig, resolve
from wcsim.core.files import iter_unused_paths
from wcsim.errors import InterruptedRunError, TownError
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.town import Town, content_hash

if TYPE_CHECKING:  # these load the simulators, which --help must not
    from wcsim.agents.evaluation.suite.result_files import TestResult
    from wcsim.agents.evaluation.suite.run import SuiteOrder
    from wcsim.agents.opening.list_file import HashedSuite

_STANDS: Final = "zero"
_PRESET: Final = "laptop"
_SHORT: Final = (
    "collect.rounds=1",
    "collect.segments=8",
    "collect.made_towns=0",
    "learn.threads=2",
    # A narrow network and many small steps: of all settings that were tried, these taught it most
    # in a minute.
    "danger.width=10",
    "danger.learning_rate=0.004",
    "danger.updates=2500",
    "danger.batch=16",
    # A network that learned for a minute has to be careful.
    "danger.threshold=0.1",
)
_USUAL: Final = (
    "This takes about 5 minutes on two free cores, half of them for training. "
    "The first run takes one minute more."
)


@dataclass
class _Options:
    """Train a short preset laptop in Helsinki. Then a user drives in another town: alone, and with the network's help.

    This takes about 5 minutes on two free cores. Every stage shows the time left.
    """  # noqa: E501 - help text

    train_town: str = "helsinki"
    """Training town: a town's name, its folder, or a .sumocfg file."""
    suite: str = "demo"
    """Test drives: a list that comes with wcsim, or a file of `wcsim test --make-suite`."""
    out: OutFolder = None
    """Run folder; default runs/demo, runs/demo-2, ..."""
    set: Repeated = ()
    """Setting as section.key=value; overrides the short preset."""
    seed: int = 1
    """Random seed."""


def run(words: list[str]) -> int:
    """Train, test and film, and print where the page is."""
    options = parse_options(_Options, words, "demo")
    started_s = time.monotonic()

    # 1. Check all options: what would be refused later is refused now.
    town = find_training_town(options.train_town, False)
    out = options.out or next(iter_unused_paths(Path("runs") / "demo"))
    require_writable_folder("--out", out)
    config = resolve(_PRESET, (*_SHORT, *options.set))
    require_matching_learner(config, DANGER_ROUNDS)
    refuse_held_out_users(config, (options.set, None))
    suite = _unseen_suite(options.suite, town)
    _print(
        f"wcsim demo: a network is trained in {town.name} and helps a user elsewhere, in "
        f"{suite.episodes} drives."
    )
    if parse_options(_Options, [], "demo") == replace(options, seed=1, out=None):
        _print(_USUAL)

    # 2. Train.
    _print(f"\n1/3 training in {town.name}", "bold")
    _print(DANGER_ROUNDS.describe(config), "dim")
    info = RunInfo(seed=options.seed, command=("wcsim", "demo", *words))
    train_single_network(resolve_run_settings(config, info, town, out), town)

    # 3. Test beside the user alone, and beside a chair that stands still, by the rules of training.
    _print(
        f"\n2/3 {suite.episodes} drives: by the user alone, standing still, and with the network",
        "bold",
    )
    rules = tuple(text for text in options.set if text.partition(".")[0] in RULES)
    trial = SuiteTestOptions(
        policies=(_STANDS, str(out)), only=True, jobs=2, out=out / "test", set=rules
    )
    order = make_suite_order(trial, suite, out / "test", suite.file.forks)
    try:
        result = run_suite_and_save(order, trial, options.suite)
    except InterruptedRunError:
        again = ["wcsim", "test", _STANDS, str(out), "--suite", options.suite, "--only"]
        again += ["--out", str(out / "test"), "--resume"]
        raise InterruptedRunError(f"stopped; go on with: {shlex.join(again)}") from None
    print_test_result(stdout_console(), result)

    # 4. Film a drive in which the help counts, and write the page.
    from wcsim.view.report.comparisons import verdict

    page, key = _write_page(out, order, result, config, options.suite, suite)
    _print("\n" + verdict(result), "bold")
    spent_s = time.monotonic() - started_s
    spent = f"{spent_s:.0f} s" if spent_s < 90.0 else f"{spent_s / 60.0:.0f} min"
    _print(f"\ndone in {spent}; open this page: {page}", "bold")
    _print("next:")
    for command, purpose in _commands(out, options.suite, key):
        _print(f"  {command}\n      {purpose}")
    _print("SIMULATION ONLY: these figures say nothing about a real street.", "dim")
    return 0


def _print(text: str, style: str | None = None) -> None:
    stdout_console().print(text, style=style)


def _unseen_suite(name: str, town: Town) -> HashedSuite:
    """The list of test drives. Raises TownError when the training town is one of its towns."""
    from wcsim.agents.opening.list_file import open_suite

    suite = open_suite(name)
    if content_hash(town) in {each.sha256 for each in suite.file.towns}:
        raise TownError(f"{town.name} is a town of the list {name}; expected another --train-town")
    return suite


def _write_page(
    out: Path,
    order: SuiteOrder,
    result: TestResult,
    config: RunConfig,
    name: str,
    suite: HashedSuite,
) -> tuple[Path, tuple[int, int]]:
    """Film a drive, alone and with help, and write the page; returns it, and the block and seat."""
    from wcsim.towns.scene_folders.families import TRAINED
    from wcsim.view.report.suite_page import write_demo_page
    from wcsim.view.report.twin_film import film_twins, telling_episode

    film = out / "alone_and_with_help.webm"
    _print(f"\n3/3 filming one of these drives twice, alone and with help: {film}", "bold")
    key = telling_episode(result, str(out))
    with StageBar("filming") as bar:
        caption, _ = film_twins(film, order, result, str(out), key, bar.show)
    # The families of the list's generated scenes that the training draws scenes of, too.
    drawn = TRAINED if config.collect.scene_share > 0.0 else ()
    page = write_demo_page(
        out,
        result,
        learned=DANGER_ROUNDS.describe(config),
        film_webm=film.read_bytes(),
        film_says=caption,
        key=key,
        trained=sorted({block.town for block in suite.file.blocks}.intersection(drawn)),
        commands=_commands(out, name, key),
    )
    return page, key


def _commands(out: Path, suite: str, key: tuple[int, int]) -> tuple[tuple[str, str], ...]:
    """The next commands with their purposes; `key` is block and seat of the filmed drive."""
    run = shlex.quote(str(out))
    place = f"--suite {shlex.quote(suite)} --block {key[0]} --seat {key[1]}"
    return (
        (
            f"wcsim drive {place} --policy {run}",
            "you drive there yourself, in your browser, assisted by this network",
        ),
        (f"wcsim report {run}/test", "pictures of every crash of these drives"),
        (
            f"wcsim test --suite dev2 {run} --jobs 2",
            "tests it on 48 dangers",
        ),
        (
            "wcsim train --preset laptop --out runs/laptop",
            "trains a better network, in half an hour",
        ),
    )
