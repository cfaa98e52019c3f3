"""`wcsim demo`: train in Helsinki, test in Monaco, take a picture; what `make demo` runs."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

from rich.console import Console

from wcsim.cli.evaluation import test
from wcsim.cli.shared.common import OutFolder, Repeated, parse, write_json
from wcsim.cli.shared.run_config import QUICK, learning, learns_in_rounds, resolve_run
from wcsim.cli.training.train import checked_town, train_in
from wcsim.config import RunConfig, load_run_config
from wcsim.errors import InterruptedRunError, TownError
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.town import Town, streets_hash


@dataclass
class Options:
    """Train preset quick in Helsinki, test it in Monaco beside the baselines, and take a picture there."""

    train_town: str = "helsinki"
    """Town to train in."""
    test_town: str = "monaco"
    """Town to test in."""
    out: OutFolder = None
    """Run folder; default runs/demo, runs/demo-2, ..."""
    set: Repeated = ()
    """section.key=value, laid over preset quick; may be given several times."""
    episodes: int = 3
    """Test episodes for each policy."""
    max_steps: int = 600
    """Steps after which a test episode ends well."""
    seed: int = 1
    """Seed of everything."""


def run(words: list[str]) -> int:
    """Do it all, and say where everything is."""
    options = parse(Options, words, "demo")
    console = Console()
    started = time.monotonic()
    trial = test.Options(
        town=options.test_town, episodes=options.episodes, max_steps=options.max_steps, seed=options.seed
    )
    school, tested = _towns(options.train_town, trial)
    stage_town = next(iter(tested.values()))
    out = options.out if options.out is not None else free_folder(Path("runs"), "demo")
    config = learning(load_run_config(QUICK, options.set))
    console.print(f"[bold]1/3[/] training in {school.name} (Ctrl-C ends it early and keeps what was learned)")
    console.print(how_it_learns(config), style="dim", highlight=False)
    info = RunInfo(seed=options.seed, command=("wcsim", "demo", *words))
    try:
        folder = train_in(resolve_run(config, info, school, out), school)
    except InterruptedRunError as stop:
        console.print(f"{stop}", highlight=False)
        folder = out
    console.print(f"[bold]2/3[/] testing in {', '.join(tested)}, which the network has never seen")
    results = test.test_policies(replace(trial, policies=(str(folder),)))
    for result in results:
        console.print(*result.tables(console.width))
    write_json(folder / "test.json", test.as_json(results))
    console.print(f"[bold]3/3[/] a picture from {stage_town.name}")
    picture = folder / f"{stage_town.name}.png"

    from wcsim.view.filming import open_stage  # loads the simulators, which --help must not
    from wcsim.view.pictures import triptych, write_png

    with open_stage(stage_town, options.seed, 640) as stage:
        shot = stage.busiest_moment(15.0)
    write_png(picture, triptych(shot.rgb, shot.class_id, shot.depth_m))
    print(f"run folder: {folder}    table: {folder / 'test.json'}    picture: {picture}")
    console.print(f"done in {time.monotonic() - started:.0f} s; SIMULATION ONLY, no statement about a real street")
    return 0


def how_it_learns(config: RunConfig) -> str:
    """What is done while a configuration is trained, in a sentence; "" where it learns from every step as it drives."""
    collect, danger = config.collect, config.danger
    if not learns_in_rounds(config):
        return ""
    times = "1 round" if collect.rounds == 1 else f"{collect.rounds} rounds"
    return (
        f"{times} of {collect.segments} x {collect.ticks} ticks with {collect.chairs} chairs: simulated users drive, "
        "and an oracle that knows what is about to happen; from this a network learns, in "
        f"{danger.updates} updates a round, which of all joystick positions end badly"
    )


def _towns(train_town: str, trial: test.Options) -> tuple[Town, dict[str, Town]]:
    """The town to train in and those to test in; what would be refused later is refused now."""
    school = checked_town(train_town, False)
    tested, _ = test.check(trial)
    same = [town.name for town in tested.values() if streets_hash(town) == streets_hash(school)]
    if same:
        raise TownError(f"{same[0]} is the town {school.name} itself; expected another --test-town than --train-town")
    return school, tested


def free_folder(parent: Path, name: str) -> Path:
    """The first of name, name-2, name-3, ... that does not exist yet."""
    return next(
        path for n in count(1) if not (path := parent / (name if n == 1 else f"{name}-{n}")).exists()
    )
