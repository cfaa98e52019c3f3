"""`wcsim drive TOWN`: a page on which a person drives, with or without assistance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from wcsim.cli.recordings.film_page import PageOptions, serve_page
from wcsim.cli.shared.common import Bounds, OutFile, OutFolder, parse, says
from wcsim.cli.shared.named_policies import require_driver
from wcsim.cli.shared.run_config import require_user
from wcsim.core.files import check_new_file
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads what --help must not
    from wcsim.drive.recording.open_study import OpenStudy
    from wcsim.drive.starting import DriveStart

_SET_BY_STUDY = ("--profile", "--seed", "--suite", "--block", "--seat", "--record")


@dataclass(kw_only=True)
class Options(PageOptions):
    """Drive a wheelchair yourself: a page in your browser, with keys, pointer, gamepad or switches.

    A policy assists you; on the page you can switch it off, change its level and overrule it. docs/drive.md
    """

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TOWN]")] = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    policy: str = "dwa"
    """The policy that assists: a run, shipped, a baseline, or your own module:Class; follow does not assist."""
    network: str = ""
    """Your own network as module:Class, for a run that was trained with it."""
    profile: str = "competent"
    """The simulated user, who drives when you select it on the page."""
    seed: int = 21
    """Seed of the traffic and of the chair's start."""
    suite: str = ""
    """Start with an episode of a suite instead: dev, validation, v1, or a list file, which sets the town."""
    block: Annotated[int, Bounds(0)] = 0
    """Block of the suite."""
    seat: Annotated[int, Bounds(0)] = 0
    """Chair of the block."""
    record: OutFile = None
    """Record the drive in this new file; a further town or world is recorded in FILE-2, FILE-3."""
    study: Annotated[str, tyro.conf.arg(metavar="FILE.toml")] = ""
    """Run a study with a participant instead: assistance (shipped), or a file of your own. docs/studies.md"""
    participant: int | None = None
    """In a study: the participant's number, which sets the order; the same number again resumes."""
    out: OutFolder = None
    """In a study: folder of the table and recordings, studies/NAME by default."""


def run(words: list[str]) -> int:
    """Serve the page until Ctrl-C."""
    if says(words, "--set"):
        raise ConfigError(
            "drive has no option --set: settings and chair come from the policy; expected --policy RUN, a run that was "
            "trained with your settings: wcsim train --set ... --out RUN"
        )
    options = parse(Options, words, "drive")
    if options.study:
        _require_alone(options, words)
    else:
        _require_place(options, words)
    print("loading the simulator and the page ...", flush=True)
    from wcsim.drive.runner import DriveOrder  # loads the simulators, which --help must not

    start, keep = _studied(options, words) if options.study else _started(options, words)
    return serve_page(DriveOrder(start=start, keep=keep), options)


def _require_place(options: Options, words: list[str]) -> None:
    """Refuse what is not there before the simulators are loaded."""
    if options.out is not None or options.participant is not None:
        raise ConfigError("--participant and --out are for a study; expected --study with them")
    if options.record is not None:
        check_new_file(options.record, "--record")
    require_driver(options.policy, options.network)
    require_user(options.profile)
    if options.suite:
        if says(words, "--seed"):
            raise ConfigError(f"--seed with --suite {options.suite}: episodes have their own seeds; leave --seed out")
    elif options.block or options.seat:
        raise ConfigError("--block and --seat name an episode of a suite; expected --suite with them")
    else:
        find_town(options.town)


def _require_alone(options: Options, words: list[str]) -> None:
    given = [word for word in _SET_BY_STUDY if says(words, word)]
    given += ["TOWN"] if options.town != Options.town else []
    if given:
        raise ConfigError(f"--study with {', '.join(given)}; the study file sets these; leave them out")


def _started(options: Options, words: list[str]) -> tuple[DriveStart, Path | None]:
    from wcsim.drive.starting import DriveStart, check_recordable, checked

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
        check_recordable(start)
    return checked(start), options.record


def _studied(options: Options, words: list[str]) -> tuple[DriveStart, OpenStudy]:
    from wcsim.drive.recording.open_study import open_study, study_start

    if options.participant is None:
        raise ConfigError("--study without --participant; expected a number from 1, a different one for each person")
    named = options.policy if says(words, "--policy") else ""
    study = open_study(options.study, options.participant, options.out, named, options.network)
    return study_start(study.file, study.file.places[0], study.network), study
