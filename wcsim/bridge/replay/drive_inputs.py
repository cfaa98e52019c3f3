"""What was done in a recorded drive, where it was driven, and who sits in it.

The world asks its seat's user about the way, whoever drives. So a person's drive is the same again only with the same
user beside: another one would arrive elsewhere, and press other buttons.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from wcsim.bridge.replay.made_scene import made_scene_of, town_of_scene, user_of_scene
from wcsim.bridge.world import World
from wcsim.core.reading import escaped
from wcsim.errors import TownError
from wcsim.log.drive import DriveRecording
from wcsim.log.records import Admitted, DriveTick, EpochBegun, Header, Input, Note, changed
from wcsim.towns.scenario.town import Town, content_hash, find_town
from wcsim.types import SeatSpec
from wcsim.users.recorded import RecordedUser
from wcsim.users.user import SimulatedUser


def first_inputs(spec: SeatSpec, seed: int) -> tuple[Input, ...]:
    """What the log of a drive begins with: the chair comes before the world, which begins with it."""
    return Admitted(epoch=0, tick=0, seat=0, spec=spec), EpochBegun(epoch=0, seed=seed)


def drive_inputs(drive: DriveRecording) -> Iterator[Input]:
    """What was done; the user of a generated scene, which its log does not name, sits where the scene was made again.

    Raises TownError for a scene that cannot be made here.
    """
    for record in drive.records:
        if isinstance(record, Admitted) and not record.spec.profile:
            yield changed(record, spec=replace(record.spec, profile=user_of_scene(made_scene_of(drive.about.scene))))
        elif not isinstance(record, Note):
            yield record


def let_wait(world: World, drive: DriveRecording, record: Input) -> None:
    """Before a tick who sits beside a person gets the patience of then."""
    if isinstance(record, DriveTick) and not drive.about.profile:
        set_patience(world.seats[0].user, patient=record.by_person)


def set_patience(user: SimulatedUser | RecordedUser, *, patient: bool) -> None:
    """A person has all the time in the world; a simulated user who drives gives up as its profile says."""
    if isinstance(user, SimulatedUser):
        user.patient = patient


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
