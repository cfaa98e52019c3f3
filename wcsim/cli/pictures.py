"""`wcsim look`, `snapshot` and `video`: pictures and films of a chair in a town, without any training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from wcsim.cli.shared.common import (
    Bounds,
    Keys,
    Repeated,
    SomeTown,
    Writes,
    note_if_made,
    parse,
    result_file,
)
from wcsim.cli.shared.consoles import StageBar
from wcsim.cli.shared.run_config import require_policy, require_user
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.view.filming import Shot

MIN_SECONDS, MAX_SECONDS = 0.1, 3600.0
OF_VIDEO = Keys(
    {"env.profile": "its user is competent; for another, use `wcsim video --profile NAME`"}
)
_LOOK_PX = 640  # width of the camera's picture
_SEARCH_S = 60.0  # of driving, at most, for a moment that shows a street


@dataclass
class _LookOptions:
    """Take pictures of a chair and from its camera, and film it; its user drives alone."""

    town: SomeTown = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    seed: int = 2
    """Seed of the traffic and of the chair's start."""
    out: Annotated[Path, arg(metavar="FOLDER")] = Path("look")
    """Folder for TOWN-street.png, TOWN.png and TOWN.webm."""
    seconds: Annotated[float, Bounds(MIN_SECONDS, MAX_SECONDS)] = 10.0
    """Length of the film. It begins where a road, a kerb, a crossing and somebody are near, within the first minute;
    the pictures show the moment with most of these in which the chair faces its route."""
    set: Annotated[Repeated, OF_VIDEO] = ()
    """section.key=value, over the settings, such as chair.plant=mine.toml; may be given several times."""


def look(words: list[str]) -> int:
    """One drive: it is filmed from where it shows a street on, and its most telling moment is the picture."""
    options = parse(_LookOptions, words, "look")
    town = find_town(options.town)
    street, picture, video = (
        options.out / f"{town.name}{kind}" for kind in ("-street.png", ".png", ".webm")
    )
    Writes().check("--out", video)

    from wcsim.view.filming import BusiestMoment, FilmDriver, FilmedDrive
    from wcsim.view.pictures import write_png
    from wcsim.view.street_pictures import (
        StillPictures,
    )  # these load the simulators, which --help must not

    with (
        note_if_made(video),
        StageBar("filming") as bar,
        FilmedDrive(town, options.seed, _LOOK_PX, FilmDriver(settings=options.set), video) as film,
    ):
        stills = StillPictures(film.world)
        busiest = BusiestMoment(film, stills.on_way)
        seen, frames = stills.draw(), round(options.seconds / film.tick_s)
        before, most = 0, round(_SEARCH_S / film.tick_s)
        while not busiest.shows_all and before < most:
            film.drive()
            before += 1
            bar.show(0.5 * before / most, "looking for a crossing and somebody near")
            if busiest.look(before * film.tick_s, stills.on_way):
                seen = stills.draw()
        with result_file(street) as part:
            write_png(part, seen)  # something to look at while it is filmed
        for done in range(1, frames + 1):
            film.add()
            if busiest.look((before + done) * film.tick_s, stills.on_way):
                seen = stills.draw()
            bar.show(
                0.5 + 0.5 * done / frames, f"second {done * film.tick_s:.0f} of {options.seconds:g}"
            )
    place = f"{options.town}, seed {options.seed}"
    with result_file(street) as part:
        write_png(part, seen)
    print(f"{street}: {place}, the chair from behind")
    _keep_shot(picture, busiest.shot, place)
    print(f"{video}: the chair's camera and a map, {options.seconds:g} s; a browser plays it")
    return 0


@dataclass
class _SnapshotOptions:
    """Take a picture from a chair's camera in a town: colours, classes and depth."""

    town: SomeTown = "helsinki"
    """A town's name, its folder, or a .sumocfg file."""
    seed: int = 0
    """Seed of the traffic and of the chair's start."""
    out: Annotated[Path, arg(metavar="FILE"), Writes(".png")] = Path("snapshot.png")
    """The picture (PNG)."""
    width: int = 640
    """Width of each of the three images, in pixels."""
    seconds: Annotated[float, Bounds(0.0, MAX_SECONDS)] = 20.0
    """Time to drive; the picture shows the moment with most of road, kerb, crossing and road users near in view."""
    set: Annotated[Repeated, OF_VIDEO] = ()
    """section.key=value, over the settings, such as chair.plant=mine.toml; may be given several times."""


def snapshot(words: list[str]) -> int:
    """Take the picture at the most telling moment."""
    options = parse(_SnapshotOptions, words, "snapshot")
    town = find_town(options.town)

    # Loads the simulators, which --help must not.
    from wcsim.view.filming import BusiestMoment, FilmDriver, FilmedDrive

    with FilmedDrive(town, options.seed, options.width, FilmDriver(settings=options.set)) as film:
        busiest = BusiestMoment(film)
        for done in range(1, max(1, round(options.seconds / film.tick_s)) + 1):
            film.drive()
            busiest.look(done * film.tick_s)
    _keep_shot(options.out, busiest.shot, f"{options.town}, seed {options.seed}")
    return 0


def _keep_shot(out: Path, shot: Shot, place: str) -> None:
    """Write a moment as a picture, and say what it shows."""
    from wcsim.view.pictures import write_png

    with result_file(out) as part:
        write_png(part, shot.picture)
    print(
        f"{out}: {place}, after {shot.after_s:.1f} s, {shot.in_view} actor{'s' * (shot.in_view != 1)} near in view"
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
    out: Annotated[Path, arg(metavar="FILE"), Writes(".webm")] = Path("video.webm")
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
    set: Annotated[Repeated, Keys({"env.profile": "expected --profile NAME"})] = ()
    """section.key=value, over those of the policy, such as chair.plant=mine.toml; may be given several times."""


def video(words: list[str]) -> int:
    """Film it."""
    options = parse(_VideoOptions, words, "video")
    profile = options.profile or ("inattentive" if options.policy else "competent")
    if options.policy:
        require_policy(options.policy, options.network, alone=True)
    elif options.network:
        raise ConfigError(
            "--network is for a run that was trained with it; expected --policy RUN, too"
        )
    require_user(profile)
    town = find_town(options.town)
    from wcsim.view.filming import (
        FilmDriver,
        FilmedDrive,
    )  # loads the simulators, which --help must not

    driver = FilmDriver(
        policy=options.policy, network=options.network, profile=profile, settings=options.set
    )
    with (
        note_if_made(options.out),
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
    user = f"the user {profile}"
    who = f"{options.policy} assists {user}" if options.policy else user
    after = f" after {options.start:g} s" if before else ""
    print(
        f"{options.out}: {options.town}, seed {options.seed}, {options.seconds:g} s{after}, {who}"
    )
    return 0
