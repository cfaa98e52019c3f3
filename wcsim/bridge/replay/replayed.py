"""The world of a log made again, epoch by epoch: of a journal, or of a recorded drive."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from pathlib import Path

from wcsim.bridge.replay.drive_inputs import drive_inputs, let_wait, town_of_drive
from wcsim.bridge.replay.player import LogPlayer
from wcsim.bridge.replay.seat_world import MakesEpoch
from wcsim.bridge.sumo.run_place import RunPlace
from wcsim.bridge.world import World
from wcsim.config import RunConfig, parse_json
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError, TownError, WcsimError
from wcsim.log.drive import DriveRecording, read_drive
from wcsim.log.reader import iter_inputs, read_header
from wcsim.log.records import Ended, EpochBegun, Header, Input, Ticked, WorldTick
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import Town, towns_hash

Log = Path | DriveRecording
"""What can be made again: the file of a journal, or a drive."""
Replay = Generator[tuple[World, Input], None, None]
"""Each record with the world after it. It holds that world, which ends with it: exhaust it, or close it."""
Before = Callable[[World | None, Input], object]
"""Is shown the world before each record, None where there is none yet."""


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
        hook: The user's own step hook, which must be the log's: that one is code, and not for a file to name.
        before: Hears of each record before it is done.

    Raises:
        TownError: The town is not there, or is not what it was.
        ConfigError: Its settings or its user cannot be used here.
        WcsimError: It is no such log, has no such epoch, or its records do not follow from each other.
    """
    header = read_header(log, "journal") if isinstance(log, Path) else log.header
    player = LogPlayer(worlds_of(header, hook), header.seats)
    inputs = iter_inputs(log) if isinstance(log, Path) else drive_inputs(log)

    def look(world: World | None, record: Input) -> None:
        if world is not None and isinstance(log, DriveRecording):
            let_wait(world, log, record)
        before(world, record)

    try:
        known = yield from _played(player, inputs, epoch, until_tick, look)
    finally:
        player.close()
    _require_epoch(log if isinstance(log, Path) else Path(log.name), epoch, known)


def _played(
    player: LogPlayer[World], inputs: Iterator[Input], epoch: int | None, until_tick: int | None, before: Before
) -> Generator[tuple[World, Input], None, set[int]]:
    """Play the wanted epochs; returns which there are."""
    known: set[int] = set()
    for record in inputs:
        if isinstance(record, Ended):
            continue
        begins, wanted = isinstance(record, EpochBegun), epoch in (None, record.epoch)
        if begins:
            known.add(record.epoch)
        late = isinstance(record, WorldTick) and until_tick is not None and record.tick > until_tick
        if late or not wanted:
            player.close()
        if player.plays or (begins and wanted):
            before(player.world, record)
            yield player.play(record), record
        else:
            player.seats.note(record)
    return known


def _require_epoch(log: Path, epoch: int | None, known: set[int]) -> None:
    if not known:
        raise WcsimError(f"{log}: has no epoch: it is truncated, or its world never started; expected a whole journal")
    if epoch is not None and epoch not in known:
        raise WcsimError(f"{log}: has no epoch {epoch}; expected one of {sorted(known)}")


def worlds_of(header: Header, hook: str = "") -> MakesEpoch[World]:
    """Makes the worlds of a log; `hook` has to be the log's own step hook.

    Raises ConfigError for another hook and for settings that cannot be used, TownError when the town is not there or
    is not what it was.
    """
    require_hook(header, hook)
    towns = _towns(header) if header.drive is None else (town_of_drive(header),)
    config, place = config_of(header), RunPlace(hook=hook)
    return lambda specs, seed, epoch: World(towns[epoch % len(towns)], config, specs, seed, place, epoch=epoch)


def require_hook(header: Header, hook: str) -> None:
    """Raise ConfigError unless this is the step hook of a log."""
    if header.hook != hook:
        raise ConfigError(
            f"the {header.kind} was made with the step hook {escaped(header.hook or 'none', 80)!r}, got "
            f"{hook or 'none'!r}; a hook is code: name it with --hook if you trust it"
        )


def config_of(header: Header) -> RunConfig:
    """The settings of a log's world. Raises ConfigError when they cannot be used."""
    return parse_json(RunConfig, header.config, f"the configuration in the {header.kind}")


def _towns(header: Header) -> tuple[Town, ...]:
    towns = tuple(map(asked_town, (header.town, *header.more_towns)))
    if towns_hash(towns) != header.town_sha256:
        named = ", ".join(town.name for town in towns)
        raise TownError(f"{named}: a net has changed since the journal was made; restore it")
    return towns


def count_ticks(log: Log, epoch: int | None = None) -> int:
    """How many ticks a log has, in one epoch or in all. Raises JournalError when it is neither journal nor drive."""
    if isinstance(log, DriveRecording):
        return len(log.ticks)
    return sum(isinstance(record, Ticked) and epoch in (None, record.epoch) for record in iter_inputs(log))
