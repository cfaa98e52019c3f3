"""What was done to the world of a recorded drive, as the inputs that a journal would hold.

The world asks its seat's user about the way, whoever drives. So a person's drive is the same again only with the same
user beside: another one would arrive elsewhere, and press other buttons.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from wcsim.bridge.replay.made_scene import made_scene_of, town_of_scene, user_of_scene
from wcsim.bridge.world import World
from wcsim.core.constants import RECORDED
from wcsim.core.reading import escaped
from wcsim.errors import TownError
from wcsim.log.drive import DriveRecording
from wcsim.log.records import (
    RESPAWN,
    USER,
    Admitted,
    Dismissed,
    DriveTick,
    EpochBegun,
    Header,
    Input,
    Note,
    Respawned,
    Ticked,
    start_of_json,
    ticked,
)
from wcsim.towns.scenario.town import Town, content_hash, find_town
from wcsim.types import Command, SeatSpec
from wcsim.users.profiles import UserProfile, profile_of_json, profile_text
from wcsim.users.recorded import RecordedUser
from wcsim.users.user import SimulatedUser


def drive_inputs(drive: DriveRecording, work: Path) -> Iterator[Input]:
    """What was done in a drive, all in epoch 0 and on seat 0; whoever sits there is written into the folder `work`.

    Raises ConfigError for a user that cannot be used here, JournalError for a start that is none.
    """
    about = drive.about
    spec = SeatSpec(profile=_user_of(drive, work), max_steps=about.max_steps, start=about.start)
    yield Admitted(epoch=0, tick=0, seat=0, spec=spec)  # before the world, which begins with the chair in it
    yield EpochBegun(epoch=0, seed=drive.header.seed)
    asked = deque(event for event in drive.events if event.kind in (RESPAWN, USER))
    for tick in drive.ticks:
        now = tick.tick - 1
        while asked and asked[0].tick <= now:
            yield from _asked(asked.popleft(), now, spec, work)
        yield ticked(0, tick.tick, (Command(seat=0, tick=now, joystick=tick.commanded),), "")


def before_drive(
    drive: DriveRecording, before: Callable[[World | None, Input], object]
) -> Callable[[World | None, Input], object]:
    """Before each tick who sits beside a person has the patience of then; then `before` is asked."""

    def look(world: World | None, record: Input) -> None:
        if world is not None and drive.about.accompanied and isinstance(record, Ticked):
            let_wait(world.seats[0].user, patient=by_person(drive.tick_of(record)))
        before(world, record)

    return look


def let_wait(user: SimulatedUser | RecordedUser, *, patient: bool) -> None:
    """A person has all the time in the world; a simulated user who drives gives up as its profile says."""
    if isinstance(user, SimulatedUser):
        user.patient = patient


def by_person(tick: DriveTick) -> bool:
    """Whether a person drove in a tick: what a simulated user wants is always known."""
    return tick.intent is None


def write_user(folder: Path, user: UserProfile) -> str:
    """The file of a profile, as a seat names it."""
    path = folder / f"{user.name}.toml"
    path.write_text(profile_text(user, {}), encoding="utf-8")
    return str(path)


def town_of_drive(header: Header) -> Town:
    """The town of a drive, by its name or where it lay, or made again where it is a scene.

    Raises TownError when it is gone, or is not what it was.
    """
    refused: TownError | None = None
    scene = "" if header.drive is None else header.drive.scene
    find, places = (_made, (scene,)) if scene else (find_town, (header.town_name, header.town))
    for place in places:
        try:
            town = find(place)
        except TownError as error:
            refused = refused or error
            continue
        here = content_hash(town)
        if here == header.town_sha256:
            return town
        refused = TownError(
            f"the drive was in {escaped(header.town_name, 80)} ({header.town_sha256[:12]}), this is {town.name} "
            f"({here[:12]}); expected the same town: restore its files"
        )
    raise refused or TownError("the drive names no town; record it again")


def _made(scene: str) -> Town:
    return town_of_scene(made_scene_of(scene))


def _user_of(drive: DriveRecording, work: Path) -> str:
    there = drive.about.user or drive.about.beside
    if not there and drive.about.scene:
        return user_of_scene(made_scene_of(drive.about.scene))
    if not there:
        return f"{RECORDED}{drive.name}"
    return write_user(work, profile_of_json(there, "the user in the drive"))


def _asked(event: Note, now: int, spec: SeatSpec, work: Path) -> Iterator[Input]:
    """What the person asked for between two ticks."""
    if event.kind == RESPAWN:
        start = start_of_json(event.detail) if event.detail else None
        yield Respawned(epoch=0, tick=now, seat=0, start=start)
        return
    user = write_user(work, profile_of_json(event.detail, "a change of user in the drive"))
    yield Dismissed(epoch=0, tick=now, seat=0)
    yield Admitted(epoch=0, tick=now, seat=0, spec=replace(spec, profile=user))
