"""`wcsim demo`: train in Helsinki, test in Monaco, film it there; what `make demo` runs."""

from __future__ import annotations

import shlex
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from wcsim.agents.opening.named_policy import RULES
from wcsim.cli.evaluation import test
from wcsim.cli.evaluation.result_tables import show_result
from wcsim.cli.shared.common import Keys, OutFolder, Repeated, check_folder, parse
from wcsim.cli.shared.consoles import StageBar, stdout_console
from wcsim.cli.shared.run_config import (
    how_it_learns,
    learning,
    require_head,
    require_users,
    resolve_run,
)
from wcsim.cli.training.train import checked_town, train_in
from wcsim.config import RunConfig, resolve
from wcsim.core.files import numbered_names
from wcsim.errors import InterruptedRunError, TownError
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.town import Town, streets_hash

if TYPE_CHECKING:  # loads torch, which --help must not
    from wcsim.agents.evaluation.suite.result_files import TestResult

_FILM_WIDTH_PX, _FILM_S = 480, 10.0
_USUAL = "This takes about 4 minutes on two free cores, half of them for training. The first run takes one minute more."


@dataclass
class _Options:
    """Train preset quick in Helsinki, then test and film it in Monaco.

    This takes about 4 minutes on two free cores. Every stage shows the time left.
    """

    train_town: str = "helsinki"
    """Training town: a town's name, its folder, or a .sumocfg file."""
    test_town: str = "monaco"
    """Test town: a town's name, its folder, or a .sumocfg file."""
    out: OutFolder = None
    """Run folder; default runs/demo, runs/demo-2, ..."""
    set: Annotated[Repeated, Keys({"env.max_steps": "expected --max-steps N"})] = ()
    """Setting as section.key=value; overrides preset quick."""
    episodes: test.Episodes = 3
    """Test episodes per policy."""
    max_steps: test.MaxSteps = 600
    """Steps after which a test episode is truncated."""
    seed: int = 1
    """Random seed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Demo:
    """What is done."""

    options: _Options
    trial: test.Options
    town: Town  # the first to test in
    out: Path


def _say(text: str, style: str | None = None) -> None:
    stdout_console().print(text, style=style)


def run(words: list[str]) -> int:
    """Do it all, and say where everything is."""
    options = parse(_Options, words, "demo")
    started = time.monotonic()
    trial = test.Options(
        town=options.test_town,
        episodes=options.episodes,
        max_steps=options.max_steps,
        seed=options.seed,
        # A network is tested under the rules that it was trained with.
        set=tuple(text for text in options.set if text.partition(".")[0] in RULES),
    )
    school, tested = _towns(options.train_town, trial)
    out = options.out or next(numbered_names(Path("runs") / "demo"))
    check_folder("--out", out)
    town = next(iter(tested.values()))
    demo = _Demo(options=options, trial=trial, town=town, out=out)
    config = resolve("quick", options.set)
    config = resolve(config, learning(config))
    require_head(config, in_rounds=True)
    require_users(config, (options.set, None))
    _say(f"wcsim demo: a network is trained in {school.name} and tested in {', '.join(tested)}.")
    if parse(_Options, [], "demo") == replace(options, seed=1, out=None):
        _say(_USUAL)
    _train(demo, config, school, words)
    result = _test(demo, ", ".join(tested))
    still = _film(demo)
    page = _page(demo, config, result, still)
    _say(f"\ndone in {_minutes(time.monotonic() - started)}; open this page: {page}", "bold")
    _say("next:")
    for command, does in _commands(demo):
        _say(f"  {command}\n      {does}")
    _say("SIMULATION ONLY: these figures say nothing about a real street.", "dim")
    return 0


def _train(demo: _Demo, config: RunConfig, school: Town, words: list[str]) -> None:
    """The first stage; what was learned until Ctrl-C is enough for the others."""
    _say(f"\n1/3 training in {school.name}; Ctrl-C ends it early and keeps the policy so far", "bold")
    _say(how_it_learns(config), "dim")
    info = RunInfo(seed=demo.options.seed, command=("wcsim", "demo", *words))
    try:
        train_in(resolve_run(config, info, school, demo.out), school)
    except InterruptedRunError as stop:
        _say(f"{stop}")


def _test(demo: _Demo, towns: str) -> TestResult:
    """The second: the network beside the baselines, who meet the same world."""
    _say(f"\n2/3 testing in {towns}, a new town for it, next to seven baselines", "bold")
    result = test.test_policies(replace(demo.trial, policies=(str(demo.out),), out=demo.out / "test"))
    show_result(stdout_console(), result)
    return result


def _film(demo: _Demo) -> Path:
    """The third: ten seconds of it, and the picture in which it differs most from its user."""
    import numpy as np

    from wcsim.view.filming import FilmDriver, FilmedDrive  # loads the simulators, which --help must not
    from wcsim.view.pictures import write_png

    _say(f"\n3/3 filming {_FILM_S:g} s of it in {demo.town.name}", "bold")
    path = demo.out / f"{demo.town.name}.webm"
    driver = FilmDriver(policy=str(demo.out), profile=demo.trial.profile)
    best, best_m = None, -1.0
    with (
        StageBar("filming") as bar,
        FilmedDrive(demo.town, demo.options.seed, _FILM_WIDTH_PX, driver, path) as film,
    ):
        frames = round(_FILM_S / film.tick_s)
        for done in range(frames):
            frame = film.add()
            bar.show((done + 1) / frames, f"second {done * film.tick_s:.0f} of {_FILM_S:g}")
            if film.taken_over > best_m:
                best, best_m = np.array(frame), film.taken_over
    still = path.with_suffix(".png")
    if best is not None:
        write_png(still, best)
    _say(f"{path}, {still.name}")
    return still


def _page(demo: _Demo, config: RunConfig, result: TestResult, still: Path) -> Path:
    from wcsim.view.report.suite_page import write_demo_page

    return write_demo_page(
        demo.out,
        result,
        learned=how_it_learns(config),
        film=still.with_suffix(".webm").name,
        film_says=f"The network assists a simulated user ({demo.trial.profile}) in {demo.town.name}: the chair's "
        "camera, the map, the user's stick (blue) and the driven one (orange). Click the picture to play the film.",
        still_png=still.read_bytes(),
        commands=_commands(demo),
    )


def _commands(demo: _Demo) -> tuple[tuple[str, str], ...]:
    """What to do next, each with what it does."""
    run, town = shlex.quote(str(demo.out)), shlex.quote(str(demo.options.test_town.split(",")[0].strip()))
    return (
        (f"wcsim drive {town} --policy {run}", "you drive on a page in your browser, assisted by this network"),
        (f"wcsim look {town}", "pictures and ten seconds of film, without a network"),
        (f"wcsim test --suite dev {run} --jobs 2", "tests it on a fixed list of episodes, in a quarter of an hour"),
        ("wcsim train --preset laptop --out runs/laptop", "trains a better network, in half an hour"),
    )


def _minutes(spent_s: float) -> str:
    return f"{spent_s:.0f} s" if spent_s < 90.0 else f"{spent_s / 60.0:.0f} min"


def _towns(train_town: str, trial: test.Options) -> tuple[Town, dict[str, Town]]:
    """The town to train in and those to test in; what would be refused later is refused now."""
    school = checked_town(train_town, False)
    tested, _ = test.tested(trial)
    same = [town.name for town in tested.values() if streets_hash(town) == streets_hash(school)]
    if same:
        raise TownError(f"{same[0]} is the training town {school.name} itself; expected another --test-town")
    return school, tested
