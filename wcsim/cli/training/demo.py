"""`wcsim demo`, or `make demo`: train a network, and see what its help is worth in a town that it has never seen."""

from __future__ import annotations

import shlex
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from wcsim.agents.opening.learner_registry import DANGER_ROUNDS
from wcsim.agents.opening.named_policy import RULES
from wcsim.cli.evaluation.judged_suite import JudgeOptions, drive_list, order_of
from wcsim.cli.evaluation.result_tables import show_result
from wcsim.cli.shared.common import OutFolder, Repeated, check_folder, parse
from wcsim.cli.shared.consoles import StageBar, stdout_console
from wcsim.cli.shared.run_config import (
    require_learner,
    require_users,
    resolve_run,
)
from wcsim.cli.shared.training import train_network, training_town
from wcsim.config import RunConfig, resolve
from wcsim.core.files import numbered_names
from wcsim.errors import InterruptedRunError, TownError
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.town import content_hash

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.opening.list_file import Suite

_STANDS = "zero"
_PRESET = "laptop"
_SHORT = (
    "collect.rounds=1",
    "collect.segments=8",
    "collect.made_towns=0",
    "learn.threads=2",
    # A narrow network and many small steps: of what was tried, it knows most after a minute of learning.
    "danger.width=10",
    "danger.learning_rate=0.004",
    "danger.updates=2500",
    "danger.batch=16",
    "danger.threshold=0.1",  # who learned for a minute had better be careful
)
_USUAL = "This takes about 5 minutes on two free cores, half of them for training. The first run takes one minute more."


@dataclass
class _Options:
    """Train a short preset laptop in Helsinki. Then a user drives in another town: alone, and with the network's help.

    This takes about 5 minutes on two free cores. Every stage shows the time left.
    """

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


def _say(text: str, style: str | None = None) -> None:
    stdout_console().print(text, style=style)


def run(words: list[str]) -> int:
    """Do it all, and say where everything is."""
    options = parse(_Options, words, "demo")
    started = time.monotonic()

    # 1. What would be refused later is refused now.
    school = training_town(options.train_town, False)
    out = options.out or next(numbered_names(Path("runs") / "demo"))
    check_folder("--out", out)
    config = resolve(_PRESET, (*_SHORT, *options.set))
    require_learner(config, DANGER_ROUNDS)
    require_users(config, (options.set, None))
    from wcsim.agents.opening.list_file import open_suite

    suite = open_suite(options.suite)
    if content_hash(school) in {town.sha256 for town in suite.file.towns}:
        raise TownError(
            f"{school.name} is a town of the list {options.suite}; expected another --train-town"
        )
    _say(
        f"wcsim demo: a network is trained in {school.name} and helps a user elsewhere, in {suite.episodes} drives."
    )
    if parse(_Options, [], "demo") == replace(options, seed=1, out=None):
        _say(_USUAL)

    # 2. It is trained.
    _say(f"\n1/3 training in {school.name}", "bold")
    _say(DANGER_ROUNDS.describe(config), "dim")
    info = RunInfo(seed=options.seed, command=("wcsim", "demo", *words))
    train_network(resolve_run(config, info, school, out), school)

    # 3. It is tested beside the user alone, and beside a chair that stands still.
    _say(
        f"\n2/3 {suite.episodes} drives: by the user alone, standing still, and with the network",
        "bold",
    )
    rules = tuple(
        text for text in options.set if text.partition(".")[0] in RULES
    )  # as those that it was trained with
    trial = JudgeOptions(
        policies=(_STANDS, str(out)), only=True, jobs=2, out=out / "test", set=rules
    )
    order = order_of(trial, suite, out / "test", suite.file.forks)
    try:
        result = drive_list(order, trial, options.suite)
    except InterruptedRunError:
        again = (
            "test",
            _STANDS,
            str(out),
            "--suite",
            options.suite,
            "--only",
            "--out",
            str(out / "test"),
            "--resume",
        )
        raise InterruptedRunError(f"stopped; go on with: {shlex.join(('wcsim', *again))}") from None
    show_result(stdout_console(), result)

    # 4. A drive in which the help is worth something is filmed, and all of it stands on a page.
    from wcsim.view.report.comparisons import verdict
    from wcsim.view.report.suite_page import write_demo_page
    from wcsim.view.report.twin_film import film_twins, telling_episode

    film = out / "alone_and_with_help.webm"
    _say(f"\n3/3 filming one of these drives twice, alone and with help: {film}", "bold")
    key = telling_episode(result, str(out))
    with StageBar("filming") as bar:
        told, _ = film_twins(film, order, result, str(out), key, bar.show)
    page = write_demo_page(
        out,
        result,
        learned=DANGER_ROUNDS.describe(config),
        film_webm=film.read_bytes(),
        film_says=told,
        key=key,
        trained=_trained_families(config, suite),
        commands=_commands(out, options.suite, key),
    )
    _say("\n" + verdict(result), "bold")
    _say(f"\ndone in {_minutes(time.monotonic() - started)}; open this page: {page}", "bold")
    _say("next:")
    for command, does in _commands(out, options.suite, key):
        _say(f"  {command}\n      {does}")
    _say("SIMULATION ONLY: these figures say nothing about a real street.", "dim")
    return 0


def _trained_families(config: RunConfig, suite: Suite) -> list[str]:
    """The families of the list's generated scenes that the training draws scenes of, too."""
    from wcsim.towns.scene_folders.families import FAMILIES

    drawn = FAMILIES if config.collect.scene_share > 0.0 else ()
    return sorted({block.town for block in suite.file.blocks}.intersection(drawn))


def _commands(out: Path, suite: str, key: tuple[int, int]) -> tuple[tuple[str, str], ...]:
    """What to do next, each with what it does; `key` is block and seat of the filmed drive."""
    run, place = (
        shlex.quote(str(out)),
        f"--suite {shlex.quote(suite)} --block {key[0]} --seat {key[1]}",
    )
    return (
        (
            f"wcsim drive {place} --policy {run}",
            "you drive there yourself, in your browser, assisted by this network",
        ),
        (f"wcsim report {run}/test", "pictures of every crash of these drives"),
        (
            f"wcsim test --suite dev {run} --jobs 2",
            "tests it on 126 drives, in a quarter of an hour",
        ),
        (
            "wcsim train --preset laptop --out runs/laptop",
            "trains a better network, in half an hour",
        ),
    )


def _minutes(spent_s: float) -> str:
    return f"{spent_s:.0f} s" if spent_s < 90.0 else f"{spent_s / 60.0:.0f} min"
