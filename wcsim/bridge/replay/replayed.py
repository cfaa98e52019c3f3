"""The world of a journal or a recorded drive made again, epoch by epoch, and compared with it.

The world takes the way from its seat's user, whoever drives. So a person's drive is the same again
only with the same user beside: another one would arrive elsewhere, and press other buttons.
"""

import math
import re
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.bridge.replay.player import LogPlayer, MakesEpoch
from wcsim.bridge.world import World
from wcsim.config import RunConfig, parse_json
from wcsim.core.constants import RECORDED
from wcsim.core.reading import escape
from wcsim.errors import ConfigError, TownError, WcsimError
from wcsim.log.drive import DriveRecording, read_drive
from wcsim.log.reader import iter_journal_inputs, read_header
from wcsim.log.records import (
    Admitted,
    DriveTick,
    Ended,
    EpochBegun,
    Header,
    Input,
    Note,
    WorldTick,
    with_fields,
)
from wcsim.towns.cache.folder import cache_folder
from wcsim.towns.making.asked_town import requested_town
from wcsim.towns.scenario.town import Town, content_hash, find_town, towns_hash
from wcsim.towns.scene_folders.build import build_scene, scene_digest
from wcsim.towns.scene_folders.families import FAMILIES, write_scene
from wcsim.types import ClientSnapshot, Joystick, SeatSpec
from wcsim.types.episode import RunPlace
from wcsim.users.recordings.recorded_user import find_user

_NAME: Final = re.compile(r"([a-z-]{1,40}) (\d{1,18}) ([0-9a-f]{64})")
_SCENE, _TOWN, _STICK = "scene", "town", "stick.csv"

Log = Path | DriveRecording
"""What can be made again: the file of a journal, or a drive."""
Replay = Generator[tuple[World, Input], None, None]
"""Each record with the world after it, which ends with it: exhaust it, or close it."""
Before = Callable[[World | None, Input], object]
"""Gets the world before each record, None where there is none yet."""


def town_of_folder(scene: Path) -> Town:
    """The street of a scene's folder. Raises TownError where it cannot be built."""
    name = f"{scene.name}-{scene_digest(scene)[:16]}"
    folder = _cached(name, lambda made: build_scene(scene, made / _TOWN))
    return find_town(str(folder / _TOWN))


def first_inputs(spec: SeatSpec, seed: int) -> tuple[Input, ...]:
    """The first records of a drive's log: the chair, then the world, which starts with it."""
    return Admitted(epoch=0, tick=0, seat=0, spec=spec), EpochBegun(epoch=0, seed=seed)


def town_of_drive(header: Header) -> Town:
    """The town of a drive, by its name or where it lay, or made again where it is a scene.

    Raises:
        TownError: It is not there, or is not what it was.
    """
    refused: TownError | None = None
    scene = "" if header.drive is None else header.drive.scene
    for place in ("",) if scene else (header.town_name, header.town):
        try:
            town = find_town(str(_made_scene(scene) / _TOWN) if scene else place)
        except TownError as error:
            refused = refused or error
            continue
        here = content_hash(town)
        if here == header.town_sha256:
            return town
        refused = TownError(
            f"the drive was in {escape(header.town_name, 80)} ({header.town_sha256[:12]}), "
            f"this is {town.name} ({here[:12]}); expected the same town: restore its files"
        )
    raise refused or TownError("the drive names no town; record it again")


def log_of(path: Path) -> Log:
    """A file as what can be made again of it. Raises JournalError when it is none, or damaged."""
    if read_header(path).kind == "drive":
        return read_drive(path)
    read_header(path, "journal")
    return path


def replayed(
    log: Log,
    epoch: int | None = None,
    until_tick: int | None = None,
    hook: str = "",
    before: Before = lambda world, record: None,
) -> Replay:
    """Do again what was done to a world: in one epoch, or in all of them, each in a new world.

    Args:
        log: A journal or a drive.
        epoch: Which one; all when None.
        until_tick: The last tick of each epoch to do.
        hook: The user's own step hook, which must be the log's: that one is code, and not for a
            file to name.
        before: Is called with each record before it is done.

    Raises:
        TownError: The town is not there, or is not what it was.
        ConfigError: Its settings or its user cannot be used here.
        WcsimError: It is no such log, has no such epoch, or its records do not follow from each
            other.
    """
    header = read_header(log, "journal") if isinstance(log, Path) else log.header
    player = LogPlayer(worlds_of(header, hook), header.seats)
    inputs = iter_journal_inputs(log) if isinstance(log, Path) else _drive_inputs(log)

    def look(world: World | None, record: Input) -> None:
        is_drive = isinstance(log, DriveRecording) and not log.about.profile
        # Beside a person the user never gives up; one that drives does as in its profile.
        if world is not None and is_drive and isinstance(record, DriveTick):
            world.seats[0].user.patient = record.by_person
        before(world, record)

    try:
        known = yield from _played(player, inputs, epoch, until_tick, look)
    finally:
        player.close()
    name = log if isinstance(log, Path) else Path(log.name)
    if not known:
        raise WcsimError(
            f"{name}: has no epoch: it is truncated, or its world never started; "
            "expected a whole journal"
        )
    if epoch is not None and epoch not in known:
        raise WcsimError(f"{name}: has no epoch {epoch}; expected one of {sorted(known)}")


def worlds_of(header: Header, hook: str = "") -> MakesEpoch[World]:
    """Makes the worlds of a log; `hook` has to be the log's own step hook.

    Raises:
        ConfigError: It is another hook, or the settings cannot be used.
        TownError: The town is not there, or is not what it was.
    """
    require_hook(header, hook)
    if header.drive is not None:
        towns: tuple[Town, ...] = (town_of_drive(header),)
    else:
        towns = tuple(map(requested_town, (header.town, *header.more_towns)))
        if towns_hash(towns) != header.town_sha256:
            named = ", ".join(town.name for town in towns)
            raise TownError(f"{named}: a net has changed since the journal was made; restore it")
    config, place = config_of(header), RunPlace(hook=hook)
    return lambda specs, seed, epoch: World(
        towns[epoch % len(towns)], config, specs, seed, place, epoch=epoch, find_user=find_user
    )


def require_hook(header: Header, hook: str) -> None:
    """Raise ConfigError unless this is the step hook of a log."""
    if header.hook != hook:
        raise ConfigError(
            f"the {header.kind} was made with the step hook "
            f"{escape(header.hook or 'none', 80)!r}, got {hook or 'none'!r}; "
            "a hook is code: name it with --hook if you trust it"
        )


def config_of(header: Header) -> RunConfig:
    """The settings of a log's world. Raises ConfigError when they cannot be used."""
    return parse_json(RunConfig, header.config, f"the configuration in the {header.kind}")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Verified:
    """How a comparison of all ticks ended."""

    ticks: int = 0  # compared
    mismatches: int = 0
    first: WorldTick | None = None  # the first record that differs
    farthest_m: float = 0.0  # of a drive: between the two places of a tick


def verify(
    log: Log,
    epoch: int | None = None,
    first_tick: int = 0,
    last_tick: int | None = None,
    progress: Callable[[int], object] = lambda ticks: None,
    hook: str = "",
) -> _Verified:
    """Compare the ticks from `first_tick` to `last_tick` of one or all epochs.

    Raises what `replayed` raises. Of a journal their hashes; of a drive place, heading, speed and
    ends, and the stick of a simulated user. `progress` gets the number of ticks so far.
    """
    result, sticks = _Verified(), list[Joystick]()
    of_person = isinstance(log, DriveRecording) and not log.about.profile

    def before(world: World | None, _: Input) -> None:
        if world is not None:
            sticks[:] = [(client.first or client).user for client in world.snapshot.clients]

    with closing(replayed(log, epoch, last_tick, hook, before)) as steps:
        for world, record in steps:
            if isinstance(record, EpochBegun) and isinstance(log, DriveRecording):
                world.go_blind()
            if not isinstance(record, WorldTick) or record.tick < first_tick:
                continue
            if isinstance(record, DriveTick):
                client = world.snapshot.clients[0]
                stick = None if of_person and record.by_person else sticks[0]
                same = _is_same(record, client, stick)
                gap_m = math.dist(client.plant.p_WB_m.tolist(), record.p_WB_m.tolist())
            else:
                same, gap_m = record.state_hash == world.snapshot.state_hash, 0.0
            result = replace(
                result,
                ticks=result.ticks + 1,
                mismatches=result.mismatches + (not same),
                first=record if result.first is None and not same else result.first,
                farthest_m=max(result.farthest_m, gap_m),
            )
            progress(result.ticks)
    return result


def _made_scene(name: str) -> Path:
    """The folder of a generated scene and its street; `name` is family, seed and hash.

    Raises:
        TownError: This wcsim knows no such scene, or generates another one of that seed.
    """
    found = _NAME.fullmatch(name)
    if found is None or found[1] not in FAMILIES:
        raise TownError(
            f"the drive was in the scene {escape(name, 80)}, which this wcsim does not know; "
            f"expected one of {', '.join(FAMILIES)}, with seed and hash: "
            "use the wcsim that recorded it"
        )
    family, seed, sha256 = found[1], int(found[2]), found[3]

    def make(folder: Path) -> None:
        made = scene_digest(write_scene(family, seed, folder / _SCENE))
        if made != sha256:
            raise TownError(
                f"the drive was in the scene {family} {seed} ({sha256[:12]}), "
                f"this wcsim generates another one ({made[:12]}); "
                "expected the same: use the wcsim that recorded it"
            )
        build_scene(folder / _SCENE, folder / _TOWN)

    return _cached(f"{family}-{seed}-{sha256[:16]}", make)


def _cached(name: str, make: Callable[[Path], object]) -> Path:
    """A scene and its street in the cache, made where they are not there yet."""
    folder = cache_folder() / "drive-scenes" / name
    if folder.is_dir():
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".") as work:  # noqa: TID251 - beside it
            made = Path(work) / "made"
            make(made)
            try:
                made.rename(folder)
            # Another process may have made it meanwhile.
            except OSError:
                if not folder.is_dir():
                    raise
    except OSError as error:
        raise TownError(
            f"{escape(folder)}: cannot be written ({error.strerror}); "
            "free some space, or clear the cache"
        ) from None
    return folder


def _drive_inputs(drive: DriveRecording) -> Iterator[Input]:
    """What was done in a drive; the user of a generated scene is in the folder of the scene.

    Raises:
        TownError: The scene cannot be made here.
    """
    for record in drive.records:
        if isinstance(record, Admitted) and not record.spec.profile:
            stick = _made_scene(drive.about.scene) / _SCENE / _STICK
            yield with_fields(record, spec=replace(record.spec, profile=f"{RECORDED}{stick}"))
        elif not isinstance(record, Note):
            yield record


def _played(
    player: LogPlayer[World],
    inputs: Iterator[Input],
    epoch: int | None,
    until_tick: int | None,
    before: Before,
) -> Generator[tuple[World, Input], None, set[int]]:
    """Play one epoch or all of them; returns which there are."""
    known: set[int] = set()
    for record in inputs:
        if isinstance(record, Ended):
            continue
        starts, chosen = isinstance(record, EpochBegun), epoch in (None, record.epoch)
        if starts:
            known.add(record.epoch)
        late = isinstance(record, WorldTick) and until_tick is not None and record.tick > until_tick
        if late or not chosen:
            player.close()
        if player.world is not None or (starts and chosen):
            before(player.world, record)
            yield player.play(record), record
        else:
            player.seats.note(record)
    return known


def _is_same(tick: DriveTick, client: ClientSnapshot, stick: Joystick | None) -> bool:
    """Whether a drive's tick left the seat as recorded; `stick` is that of a simulated user."""
    plant, events = client.plant, client.events
    ends = (events.arrived, events.gave_up, events.crashed, events.truncated)
    return (
        stick in (None, tick.stick)
        and ends == (tick.arrived, tick.gave_up, tick.crashed, tick.truncated)
        and np.array_equal(plant.p_WB_m, tick.p_WB_m)
        and (plant.yaw_rad, float(plant.v_B_mps[0])) == (tick.yaw_rad, tick.speed_mps)
    )
