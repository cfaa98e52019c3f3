"""`wcsim look`, `snapshot` and `video`: pictures and films of a chair in a town."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import arg

from wcsim.cli.shared.common import (
    AllowedSettingKeys,
    Bounds,
    Repeated,
    SomeTown,
    WritableFile,
    parse_options,
    report_created_folder,
    write_result_atomically,
)
from wcsim.cli.shared.consoles import StageBar
from wcsim.cli.shared.run_config import require_known_users, require_usable_policy
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.view.filming import Shot

MIN_SECONDS: Final = 0.1
MAX_SECONDS: Final = 3600.0
_SET_KEYS: Final = AllowedSettingKeys(
    {"env.profile": "its user is competent; for another, use `wcsim video --profile NAME`"}
)
_LOOK_PX: Final = 640  # width of the camera's picture
# Of driving, at most, in search of a moment that shows a street.
_SEARCH_S: Final = 60.0


@dataclass
class _LookOptions:
    """Take pictures of a chair and from its camera, and film it; its user drives alone."""

    town: SomeTown = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    seed: int = 3
    """Seed of the traffic and of the chair's start."""
    out: Annotated[Path, arg(metavar="FOLDER")] = Path("look")
    """Folder for TOWN-street.png, TOWN.png and TOWN.webm."""
    seconds: Annotated[float, Bounds(MIN_SECONDS, MAX_SECONDS)] = 10.0
    """Length of the film. It begins where a road, a kerb, a crossing and somebody are near, within the first minute;
    the pictures show the moment with most of these in which the chair faces its route."""  # noqa: E501
    set: Annotated[Repeated, _SET_KEYS] = ()
    """section.key=value, over the settings, such as chair.plant=mine.toml; may be given several times."""  # noqa: E501


def run_look(words: list[str]) -> int:
    """Drive once: film it from where it shows a street, and picture the moment that shows most."""
    options = parse_options(_LookOptions, words, "look")
    town = find_town(options.town)
    street = options.out / f"{town.name}-street.png"
    picture = options.out / f"{town.name}.png"
    video = options.out / f"{town.name}.webm"
    WritableFile().check("--out", video)

    # These load the simulators, which --help must not.
    from wcsim.view.filming import BusiestMoment, FilmDriver, FilmedDrive
    from wcsim.view.pictures import write_png
    from wcsim.view.street_pictures import StillPictures

    with (
        report_created_folder(video),
        StageBar("filming") as bar,
        FilmedDrive(town, options.seed, _LOOK_PX, FilmDriver(settings=options.set), video) as film,
    ):
        # 1. Drive on to where the film begins; the chair from behind is drawn at busier moments.
        stills = StillPictures(film.world)
        busiest = BusiestMoment(film, stills.on_way)
        seen = stills.draw()
        before, most = 0, round(_SEARCH_S / film.tick_s)
        while not busiest.shows_all and before < most:
            film.drive()
            before += 1
            bar.show(0.5 * before / most, "looking for a crossing and somebody near")
            if busiest.look(before * film.tick_s, stills.on_way):
                seen = stills.draw()
        # Something to look at while it is filmed.
        with write_result_atomically(street) as part:
            write_png(part, seen)
        # 2. Film.
        frames = round(options.seconds / film.tick_s)
        for done in range(1, frames + 1):
            film.add()
            if busiest.look((before + done) * film.tick_s, stills.on_way):
                seen = stills.draw()
            bar.show(
                0.5 + 0.5 * done / frames, f"second {done * film.tick_s:.0f} of {options.seconds:g}"
            )
    # 3. Write the pictures.
    place = f"{options.town}, seed {options.seed}"
    with write_result_atomically(street) as part:
        write_png(part, seen)
    print(f"{street}: {place}, the chair from behind")
    _write_shot(picture, busiest.shot, place)
    print(f"{video}: the chair's camera and a map, {options.seconds:g} s; a browser plays it")
    return 0


@dataclass
class _SnapshotOptions:
    """Take a picture from a chair's camera in a town: colours, classes and depth."""

    town: SomeTown = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    seed: int = 0
    """Seed of the traffic and of the chair's start."""
    out: Annotated[Path, arg(metavar="FILE"), WritableFile(".png")] = Path("snapshot.png")
    """The picture (PNG)."""
    width: int = 640
    """Width of each of the three images, in pixels."""
    seconds: Annotated[float, Bounds(0.0, MAX_SECONDS)] = 20.0
    """Time to drive; the picture shows the moment with most of road, kerb, crossing and road users near in view."""  # noqa: E501
    set: Annotated[Repeated, _SET_KEYS] = ()
    """section.key=value, over the settings, such as chair.plant=mine.toml; may be given several times."""  # noqa: E501


def run_snapshot(words: list[str]) -> int:
    """Take the picture at the moment that shows most."""
    options = parse_options(_SnapshotOptions, words, "snapshot")
    town = find_town(options.town)

    # Loads the simulators, which --help must not.
    from wcsim.view.filming import BusiestMoment, FilmDriver, FilmedDrive

    with FilmedDrive(town, options.seed, options.width, FilmDriver(settings=options.set)) as film:
        busiest = BusiestMoment(film)
        for done in range(1, max(1, round(options.seconds / film.tick_s)) + 1):
            film.drive()
            busiest.look(done * film.tick_s)
    _write_shot(options.out, busiest.shot, f"{options.town}, seed {options.seed}")
    return 0


def _write_shot(out: Path, shot: Shot, place: str) -> None:
    """Write a moment as a picture, and print what it shows."""
    from wcsim.view.pictures import write_png

    with write_result_atomically(out) as part:
        write_png(part, shot.picture)
    print(
        f"{out}: {place}, after {shot.after_s:.1f} s, {shot.in_view} "
        f"actor{'s' * (shot.in_view != 1)} near in view"
    )


@dataclass
class _VideoOptions:
    """Film a chair, driven by its user alone or by a policy: its camera next to a map.

    With --policy the picture shows the user's stick, the driven one, and warnings.
    """

    town: SomeTown = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    seed: int = 0
    """Seed of the traffic and of the chair's start."""
    out: Annotated[Path, arg(metavar="FILE"), WritableFile(".webm")] = Path("video.webm")
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
    set: Annotated[Repeated, AllowedSettingKeys({"env.profile": "expected --profile NAME"})] = ()
    """section.key=value, over those of the policy, such as chair.plant=mine.toml; may be given several times."""  # noqa: E501


def run_video(words: list[str]) -> int:
    """Film it."""
    options = parse_options(_VideoOptions, words, "video")
    profile = options.profile or ("inattentive" if options.policy else "competent")
    if options.policy:
        require_usable_policy(options.policy, options.network, alone=True)
    elif options.network:
        raise ConfigError(
            "--network is for a run that was trained with it; expected --policy RUN, too"
        )
    require_known_users(profile)
    town = find_town(options.town)
    from wcsim.view.filming import FilmDriver, FilmedDrive  # loads the simulators

    driver = FilmDriver(
        policy=options.policy, network=options.network, profile=profile, settings=options.set
    )
    with (
        report_created_folder(options.out),
        StageBar("filming") as bar,
        FilmedDrive(town, options.seed, options.width, driver, options.out) as film,
    ):
        before = round(options.start / film.tick_s)
        ticks = before + round(options.seconds / film.tick_s)
        for done in range(1, ticks + 1):
            if done <= before:
                film.drive()
            else:
                film.add()
            second = f"second {done * film.tick_s:.0f} of {options.start + options.seconds:g}"
            bar.show(done / ticks, second)
    driver_text = f"the user {profile}"
    if options.policy:
        driver_text = f"{options.policy} assists {driver_text}"
    after = f" after {options.start:g} s" if before else ""
    place = f"{options.town}, seed {options.seed}"
    print(f"{options.out}: {place}, {options.seconds:g} s{after}, {driver_text}")
    return 0
