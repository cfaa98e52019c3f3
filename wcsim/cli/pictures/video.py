"""`wcsim video TOWN --policy NAME --out x.webm`: ten seconds from a chair's camera, next to a map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.cli.shared.common import Bounds, Repeated, check_output, missing_folder, parse, tell_made
from wcsim.cli.shared.named_policies import require_driver
from wcsim.cli.shared.run_config import require_unset, require_user
from wcsim.cli.shared.stage_bar import StageBar
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town

MIN_SECONDS, MAX_SECONDS = 0.1, 3600.0


@dataclass
class Options:
    """Film a chair, driven by its user alone or by a policy: its camera next to a map.

    With --policy the picture shows the user's stick, the driven one, and warnings.
    """

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TOWN]")] = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    seed: int = 0
    """Seed of the traffic and of the chair's start."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("video.webm")
    """The video (WebM)."""
    seconds: Annotated[float, Bounds(MIN_SECONDS, MAX_SECONDS)] = 10.0
    """Length of the film."""
    start: Annotated[float, Bounds(0.0, MAX_SECONDS)] = 0.0
    """Seconds to drive before the film begins; the clock in the picture counts them."""
    width: int = 480
    """Width of the camera image in pixels."""
    policy: str = ""
    """What drives: a run, shipped, a baseline, or your own module:Class; "" is the user alone."""
    network: str = ""
    """Your own network as module:Class, for a run that was trained with it."""
    profile: str = ""
    """The simulated user. (default: inattentive with --policy, competent without)"""
    set: Repeated = ()
    """section.key=value, over those of the policy, such as chair.plant=mine.toml; may be given several times."""


def run(words: list[str]) -> int:
    """Film it."""
    options = _with_user(parse(Options, words, "video"))
    require_unset(options.set, {"env.profile": "expected --profile NAME"})
    check_output("--out", options.out, ".webm")
    if options.policy:
        require_driver(options.policy, options.network)
    elif options.network:
        raise ConfigError("--network is for a run that was trained with it; expected --policy RUN, too")
    require_user(options.profile)
    town = find_town(options.town)
    missing = missing_folder(options.out)
    from wcsim.view.filming import FilmDriver, FilmedDrive  # loads the simulators, which --help must not

    driver = FilmDriver(policy=options.policy, network=options.network, profile=options.profile, settings=options.set)
    with (
        StageBar("filming") as bar,
        FilmedDrive(town, options.seed, options.width, driver, options.out) as film,
    ):
        before, frames = round(options.start / film.tick_s), round(options.seconds / film.tick_s)
        for done in range(1, before + frames + 1):
            if done <= before:
                film.drive()
            else:
                film.add()
            second = f"second {done * film.tick_s:.0f} of {options.start + options.seconds:g}"
            bar.show(done / (before + frames), second)
    tell_made(missing)
    user = f"the user {options.profile}"
    who = f"{options.policy} assists {user}" if options.policy else user
    after = f" after {options.start:g} s" if before else ""
    print(f"{options.out}: {options.town}, seed {options.seed}, {options.seconds:g} s{after}, {who}")
    return 0


def _with_user(options: Options) -> Options:
    """The options with who drives where nobody is named."""
    return replace(options, profile=options.profile or ("inattentive" if options.policy else "competent"))
