"""`wcsim drive TOWN`: a page on which a person drives, with or without a policy beside."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from wcsim.cli.shared.common import OutFile, OutFolder, in_bounds, parse, says
from wcsim.cli.shared.named_policies import require_driver
from wcsim.cli.shared.run_config import require_user
from wcsim.drive.keeping.kept_files import require_new
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads what --help must not
    from wcsim.drive.keeping.open_study import OpenStudy
    from wcsim.drive.starting import DriveStart

_SET_BY_STUDY = ("--profile", "--seed", "--suite", "--block", "--seat", "--record")


@dataclass
class Options:
    """Drive a wheelchair yourself: a page in your browser, with keys, pointer, gamepad or switches.

    The policy helps as it would help its user; it can be switched off, set to a level, and overruled. docs/drive.md
    """

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TOWN]")] = "helsinki"
    """A town's name, its folder, or anybody's .sumocfg."""
    policy: str = "dwa"
    """Who assists: a run, shipped, a baseline, module:Class of your own; follow gives the stick as it is."""
    network: str = ""
    """Your own network as module:Class, for a run that was trained with it."""
    profile: str = "competent"
    """The simulated user who drives where the page says so."""
    seed: int = 21
    """Seed of the traffic and of the chair's place."""
    suite: str = ""
    """Begin with an episode of a suite instead: dev, validation, v1, or a list; the town is then the list's."""
    block: int = 0
    """Which block of it."""
    seat: int = 0
    """Which seat of the block."""
    record: OutFile = None
    """Keep the drive in this file, a new one; another town or world goes on in FILE-2, FILE-3."""
    study: Annotated[str, tyro.conf.arg(metavar="FILE.toml")] = ""
    """Lead a participant through a study instead: assistance (shipped), or a file of your own. docs/studies.md"""
    participant: int | None = None
    """In a study: the number of who takes part, which gives the order; again, it goes on where it was left."""
    out: OutFolder = None
    """In a study: where its table and recordings go; studies/NAME where it is not said."""
    port: int = 8080
    """Where the page is served; 0 takes a free one."""
    host: str = "127.0.0.1"
    """The machine's name or address; any other than the loopback asks for the token in the printed address."""


def run(words: list[str]) -> int:
    """Serve the page until Ctrl-C."""
    if says(words, "--set"):
        raise ConfigError(
            "--set is no option of drive, which takes its settings, the chair among them, from the policy; expected "
            "--policy RUN, a run that was trained with yours: wcsim train --set ... --out RUN"
        )
    options = parse(Options, words, "drive")
    in_bounds("--port", options.port, 0, 65535)
    if options.study:
        _require_alone(options, words)
    else:
        _require_place(options, words)
    print("loading the simulator and the page ...", flush=True)
    from wcsim.drive.runner import DriveOrder
    from wcsim.drive.serving.server import ServeOrder, serve_drive  # loads the simulators, which --help must not

    start, keep = _studied(options, words) if options.study else _started(options, words)
    try:
        serve_drive(
            ServeOrder(
                start=DriveOrder(start=start, keep=keep),
                host=options.host,
                port=options.port,
                say=lambda told: print(told, flush=True),
            )
        )
    except KeyboardInterrupt:
        print("the page is closed")
    return 0


def _require_place(options: Options, words: list[str]) -> None:
    """Refuse what is not there before the simulators are loaded."""
    if options.out is not None or options.participant is not None:
        raise ConfigError("--participant and --out are for a study; expected --study beside them")
    if options.record is not None:
        require_new(options.record, "--record")
    require_driver(options.policy, options.network)
    require_user(options.profile)
    if options.suite:
        if says(words, "--seed"):
            raise ConfigError(f"--seed with --suite {options.suite}: its episodes have their own seeds; leave it out")
        in_bounds("--block", options.block, 0, 1 << 30)
        in_bounds("--seat", options.seat, 0, 1 << 30)
    elif options.block or options.seat:
        raise ConfigError("--block and --seat name an episode of a suite; expected --suite beside them")
    else:
        find_town(options.town)


def _require_alone(options: Options, words: list[str]) -> None:
    given = [word for word in _SET_BY_STUDY if says(words, word)]
    given += ["TOWN"] if options.town != Options.town else []
    if given:
        raise ConfigError(f"--study with {', '.join(given)}; expected it alone: its file says who drives where")


def _started(options: Options, words: list[str]) -> tuple[DriveStart, Path | None]:
    from wcsim.drive.starting import DriveStart, checked, require_kept

    start = DriveStart(
        town=options.town,
        policy=options.policy,
        network=options.network,
        profile="" if options.suite and not says(words, "--profile") else options.profile,
        seed=options.seed,
        suite=options.suite,
        block=options.block,
        seat=options.seat,
    )
    if options.record is not None:
        require_kept(start)
    return checked(start), options.record


def _studied(options: Options, words: list[str]) -> tuple[DriveStart, OpenStudy]:
    from wcsim.drive.keeping.open_study import open_study, start_of

    if options.participant is None:
        raise ConfigError("--study without --participant; expected a number from 1 on, another one for each person")
    named = options.policy if says(words, "--policy") else ""
    study = open_study(options.study, options.participant, options.out, named, options.network)
    return start_of(study.file, study.file.places[0], study.network), study
