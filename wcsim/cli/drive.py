"""`wcsim drive TOWN`: a page on which a person drives, with or without assistance."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from tyro.conf import arg

from wcsim.cli.shared.common import (
    Bounds,
    OutFolder,
    SomeTown,
    WebPageOptions,
    WritableFile,
    has_option,
    parse_options,
    serve_page,
)
from wcsim.cli.shared.run_config import require_known_users, require_usable_policy
from wcsim.drive.driven import LEAST_SENSITIVITY, LEAST_SPEED, MOST_SENSITIVITY
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town

# The options that a drive starts with; the others are about the page and the recording.
_OF_DRIVE: Final = (
    *("town", "policy", "network", "profile", "seed"),
    *("suite", "block", "seat", "speed", "sensitivity"),
)
_LOADING: Final = "loading the simulator and the page ..."


@dataclass(kw_only=True)
class _AssistedOptions(WebPageOptions):
    """The policy that assists, the user's stick, and the recording."""

    policy: str = "dwa"
    """The policy that assists: a run, shipped, a baseline, or your own module:Class; follow does not assist."""  # noqa: E501
    network: str = ""
    """Your own network as module:Class, for a run that was trained with it."""
    profile: str = ""
    """The simulated user, who drives when you select it on the page; by default that of the episode."""  # noqa: E501
    speed: Annotated[float, Bounds(LEAST_SPEED, 1.0)] = 1.0
    """Speed of your stick, a share of all; on the page you can change it, as the next."""
    sensitivity: Annotated[float, Bounds(LEAST_SENSITIVITY, MOST_SENSITIVITY)] = 1.0
    """Sensitivity of your stick: below 1 it is softer about its middle."""
    record: Annotated[Path | None, arg(metavar="FILE"), WritableFile(new=True)] = None
    """Record the drive in this new file; a further town or world is recorded in FILE-2, FILE-3."""


@dataclass(kw_only=True)
class _Options(_AssistedOptions):
    """Drive a wheelchair yourself: a page in your browser, with keys, pointer, gamepad or switches.

    A policy assists you; on the page you can switch it off, change its level and overrule it. docs/drive.md

    With `--suite LIST` you start with an episode of a list, with `--study FILE` you run a study
    (`wcsim drive --suite dev2 -h`, `wcsim drive --study assistance -h`).
    """  # noqa: E501

    town: SomeTown = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    profile: str = "competent"
    """The simulated user, who drives when you select it on the page."""
    seed: int = 21
    """Seed of the traffic and of the chair's start."""


@dataclass(kw_only=True)
class _EpisodeOptions(_AssistedOptions):
    """Drive an episode of a suite yourself."""

    suite: str
    """The suite: demo, dev, validation, v1, or a list file, which sets the town."""
    block: Annotated[int, Bounds(0)] = 0
    """Block of the suite."""
    seat: Annotated[int, Bounds(0)] = 0
    """Chair of the block."""


@dataclass(kw_only=True)
class _StudyOptions(WebPageOptions):
    """Run a study with a participant."""

    study: Annotated[str, arg(metavar="FILE.toml")]
    """The study: assistance (shipped), or a file of your own. docs/studies.md"""
    participant: int
    """The participant's number from 1, which sets the order; the same number again resumes."""
    out: OutFolder = None
    """Folder of the table and recordings, studies/NAME by default."""
    policy: str = ""
    """The policy that assists, where the study names a run of yours."""
    network: str = ""
    """Your own network as module:Class, for a run that was trained with it."""


def run(words: list[str]) -> int:
    """Serve the page until Ctrl-C."""
    if has_option(words, "--set"):
        raise ConfigError(
            "drive has no option --set: settings and chair come from the policy; expected "
            "--policy RUN, a run that was trained with your settings: wcsim train --set ... --out "
            "RUN"
        )
    if has_option(words, "--study"):
        return _study(parse_options(_StudyOptions, words, "drive"))
    kind: type[_AssistedOptions] = _EpisodeOptions if has_option(words, "--suite") else _Options
    options = parse_options(kind, words, "drive")
    require_usable_policy(options.policy, options.network, alone=True)
    if options.profile:
        require_known_users(options.profile)
    if isinstance(options, _Options):
        find_town(options.town)
    chosen = {name: value for name, value in vars(options).items() if name in _OF_DRIVE}
    print(_LOADING, flush=True)
    from wcsim.drive.runner import DriveOrder  # loads the simulators, which --help must not
    from wcsim.drive.starting import DriveStart, check_recordable, checked

    start = DriveStart(**{"seed": _Options.seed, **chosen})
    if options.record is not None:
        check_recordable(start)
    return serve_page(DriveOrder(start=checked(start), keep=options.record), options)


def _study(options: _StudyOptions) -> int:
    print(_LOADING, flush=True)
    from wcsim.drive.recording.study_lead import open_study, study_start
    from wcsim.drive.runner import DriveOrder

    study = open_study(
        options.study, options.participant, options.out, options.policy, options.network
    )
    start = study_start(study.file, study.file.places[0], study.network)
    return serve_page(DriveOrder(start=start, keep=study), options)
