"""A recorded drive made again: the same town, seed, settings and person, every tick commanded as it was."""

from __future__ import annotations

import math
import tempfile
from collections import deque
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wcsim.bridge.drives.beside import by_person, let_wait
from wcsim.bridge.drives.made_scene import made_scene_of, town_of_scene, user_of_scene
from wcsim.bridge.drives.record_user import write_user
from wcsim.bridge.world import World
from wcsim.config import RunConfig, parse_json
from wcsim.core.constants import RECORDED
from wcsim.core.reading import escaped
from wcsim.errors import TownError
from wcsim.log.drive import DriveRecording
from wcsim.log.records import RESPAWN, USER, DriveTick, Header, Note, start_of_json
from wcsim.towns.scenario.town import Town, content_hash, find_town
from wcsim.types import ClientSnapshot, Command, SeatSpec
from wcsim.users.profiles import profile_of_json


@dataclass(frozen=True, slots=True, kw_only=True)
class _DriveCheck:
    """How a drive compares with the same one made again."""

    ticks: int = 0  # compared
    mismatches: int = 0
    first_tick: int | None = None  # that differs
    farthest_m: float = 0.0  # between the two places of a tick


Remaking = Generator[tuple[DriveTick, ClientSnapshot, ClientSnapshot], None, None]
"""Each tick as recorded, the seat before it and after it; holds a world: exhaust it, or close it."""


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


def config_of_drive(header: Header) -> RunConfig:
    """The settings of a drive. Raises ConfigError when they cannot be used."""
    return parse_json(RunConfig, header.config, "the configuration in the drive")


def remade(
    drive: DriveRecording, before_tick: Callable[[World], object] = lambda world: None, *, blind: bool = True
) -> Remaking:
    """Do again what was done in a drive; `before_tick` is shown the world before every tick.

    Cameras see nothing where it is `blind`.

    Raises:
        TownError: The town is gone, or is not what it was.
        ConfigError: Its settings or its user cannot be used here.
    """
    header, about = drive.header, drive.about
    town, config = town_of_drive(header), config_of_drive(header)
    with tempfile.TemporaryDirectory(prefix="wcsim-user-") as work:
        spec = SeatSpec(profile=_user_of(drive, Path(work)), max_steps=about.max_steps, start=about.start)
        with World(town, config, (spec,), header.seed) as world:
            if blind:
                world.go_blind()
            asked = deque(event for event in drive.events if event.kind in (RESPAWN, USER))
            for tick in drive.ticks:
                while asked and asked[0].tick <= world.snapshot.tick:
                    _do_again(world, asked.popleft(), spec, Path(work))
                if about.accompanied:
                    let_wait(world.seats[0].user, patient=by_person(tick))
                before_tick(world)
                client = world.snapshot.clients[0]
                command = Command(seat=0, tick=world.snapshot.tick, joystick=tick.commanded)
                yield tick, client.first or client, world.tick((command,)).clients[0]


def verify_drive(drive: DriveRecording, progress: Callable[[int], object] = lambda ticks: None) -> _DriveCheck:
    """Compare every tick's place, heading, speed and ends, and the stick of who was simulated.

    Raises what `remade` raises.
    """
    result = _DriveCheck()
    with closing(remade(drive)) as steps:
        for tick, before, after in steps:
            persons = drive.about.accompanied and by_person(tick)
            same = persons or before.user == tick.stick
            if drive.about.user or drive.about.accompanied:
                same = same and _ended_so(tick, after)
            result = _compared(result, tick, same, after)
            progress(result.ticks)
    return result


def _user_of(drive: DriveRecording, work: Path) -> str:
    there = drive.about.user or drive.about.beside
    if not there and drive.about.scene:
        return user_of_scene(made_scene_of(drive.about.scene))
    if not there:
        return f"{RECORDED}{drive.name}"
    return write_user(work, profile_of_json(there, "the user in the drive"))


def _do_again(world: World, event: Note, spec: SeatSpec, work: Path) -> None:
    """What the person asked for between two ticks."""
    if event.kind == RESPAWN:
        world.respawn(0, start=start_of_json(event.detail) if event.detail else None)
        return
    user = write_user(work, profile_of_json(event.detail, "a change of user in the drive"))
    world.dismiss(0)
    world.admit(0, replace(spec, profile=user))


def _ended_so(tick: DriveTick, client: ClientSnapshot) -> bool:
    events = client.events
    now = (events.arrived, events.gave_up, events.crashed, events.truncated)
    return now == (tick.arrived, tick.gave_up, tick.crashed, tick.truncated)


def _compared(so_far: _DriveCheck, tick: DriveTick, same: bool, client: ClientSnapshot) -> _DriveCheck:
    """One tick more, in which stick and ends were the `same`, with the seat at its end."""
    plant = client.plant
    same = same and np.array_equal(plant.p_WB_m, tick.p_WB_m) and client.tick == tick.tick
    same = same and (plant.yaw_rad, float(plant.v_B_mps[0])) == (tick.yaw_rad, tick.speed_mps)
    first = tick.tick if so_far.first_tick is None and not same else so_far.first_tick
    return replace(
        so_far,
        ticks=so_far.ticks + 1,
        mismatches=so_far.mismatches + (not same),
        first_tick=first,
        farthest_m=max(so_far.farthest_m, math.dist(plant.p_WB_m.tolist(), tick.p_WB_m.tolist())),
    )
