"""The world of a server, and its journal: the first epoch, or the next one where another ended or died.

Loads SUMO and PyBullet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from wcsim.bridge.replay.player import Seats, SeatWorld, Specs
from wcsim.bridge.world import World
from wcsim.core import seeding
from wcsim.errors import ConfigError
from wcsim.log.fingerprint import fingerprint
from wcsim.log.reader import inputs_of_part, part_files, read_header, rotate_log
from wcsim.log.records import Ended, EpochBegun, Header
from wcsim.log.writer import JOURNAL, LogWriter, truncation_message
from wcsim.server.launch.event_log import RunLog
from wcsim.server.protocol.events import Rules
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldOrder, WorldSpec, town_of_epoch
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import towns_hash
from wcsim.users.recordings.recorded_user import find_user

EPOCH_OVER = "the world generation is over"
"""How the reason begins by which a world's process ends for another one to go on with the next epoch."""


MakesWorld = Callable[[WorldOrder, Specs, int, int], SeatWorld]
"""Makes the world of an order, with a chair for each of the specs that is not None; its seed, and its first epoch."""


def street_world(order: WorldOrder, specs: Specs, seed: int, epoch: int = 0) -> World:
    """The world of a town; see `MakesWorld`. Raises TownError for one that is not there, and what `World` raises."""
    town = asked_town(town_of_epoch(order.town, order.more_towns, epoch))
    return World(town, order.config, specs, seed, order.place, epoch=epoch, find_user=find_user)


def _epoch_seed(seed: int, epoch: int) -> int:
    """The seed of an epoch: the run's own for the first one."""
    return seed if epoch == 0 else seeding.derive(seed, "epoch", epoch)


GATHER_AGAIN_S = 60.0  # for all who were in an epoch to come back after its planned end ...
REGATHER_S = 5.0  # ... and after its world died: perhaps not alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """A world with its core, and its journal when it keeps one."""

    world: SeatWorld
    core: ServerCore
    journal: LogWriter | None


def open_server(order: WorldSpec, make: MakesWorld = street_world) -> Opened:
    """Make the world of an order: the next epoch where the journal in its run folder has one.

    An epoch whose world died is over as one that ended as planned: no state of it is needed, as no client waits for it.

    Args:
        order: The order.
        make: Makes the worlds; a stand-in's have no town.

    Raises:
        ConfigError: The order cannot be used, or does not fit the journal.
        WcsimError: What the world raises, or the journal.
    """
    if not order.run or not order.journal:
        return Opened(
            world=make(order, (None,) * order.rules.capacity, order.seed, 0),
            core=ServerCore(order.rules),
            journal=None,
        )
    path, header = Path(order.run) / JOURNAL, _header(order, has_town=make is street_world)
    parts = part_files(path)
    if parts:
        _require_same(parts[-1], header)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
    last = _last_epoch(parts)
    if last.part == path:
        _appended(path).close()  # cuts a torn record off before anybody reads on
        rotate_log(path)
    # A part that is there now is of a world that ended before its epoch began.
    journal = _appended(path) if path.exists() else LogWriter(path, header)
    return _begun(order, make, journal, last.epoch + 1, _rules_after(order, last))


def _rules_after(order: WorldSpec, last: _LastEpoch) -> Rules:
    """The rules of an order; where an epoch of this launch came before, those who were in it are waited for."""
    if order.begins or last.epoch < 0:
        return order.rules
    most_s = GATHER_AGAIN_S if last.is_over else REGATHER_S
    return replace(
        order.rules, expected=max(1, last.seated), gather_s=min(order.rules.gather_s, most_s)
    )


def _begun(
    order: WorldSpec, make: MakesWorld, journal: LogWriter, epoch: int, rules: Rules
) -> Opened:
    """A fresh world, all seats free."""
    seed = _epoch_seed(order.seed, epoch)
    try:
        world = make(order, (None,) * order.rules.capacity, seed, epoch)
        journal.append(EpochBegun(epoch=epoch, seed=seed, fresh=True))
    except BaseException:
        journal.close()
        raise
    return Opened(world=world, core=ServerCore(rules, epoch), journal=journal)


def _appended(path: Path) -> LogWriter:
    """A journal to go on with; what was cut off its end is said in the events of its run."""
    journal = LogWriter.append_to(path)
    if journal.cut_bytes:
        RunLog(path.parent).add(
            "torn", who="world", reason=truncation_message(path, journal.cut_bytes)
        )
    return journal


def _header(order: WorldSpec, has_town: bool) -> Header:
    towns = tuple(map(asked_town, (order.town, *order.more_towns) if has_town else ()))
    return Header(
        name=order.name,
        town=order.town,
        more_towns=order.more_towns,
        town_sha256=towns_hash(towns),
        config=order.config.model_dump_json(),
        seed=order.seed,
        seats=order.rules.capacity,
        tick_s=order.config.world.tick_s,
        fingerprint=fingerprint(),
        hook=order.hook,
    )


def _require_same(path: Path, new: Header) -> None:
    """Raise ConfigError when the journal is of another world."""
    old = read_header(path, "journal")
    for name in ("town_sha256", "config", "seed", "seats", "hook"):
        if getattr(old, name) != getattr(new, name):
            raise ConfigError(
                f"{path}: belongs to another world: its {name} is {str(getattr(old, name))[:80]!r}, not "
                f"{str(getattr(new, name))[:80]!r}; use the same settings, or choose a new folder"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class _LastEpoch:
    epoch: int = -1  # -1 where none was begun
    part: Path | None = None  # of the journal, that it began in
    seated: int = 0  # clients in it at its end
    is_over: bool = False  # it ended as planned


def _last_epoch(parts: Sequence[Path]) -> _LastEpoch:
    """How the last epoch of a journal stands; parts whose world ended while it was made have none."""
    each = map(_epoch_of, reversed(parts))
    return next((found for found in each if found.epoch >= 0), _LastEpoch())


def _epoch_of(part: Path) -> _LastEpoch:
    """How the last epoch in a part of a journal stands."""
    seats, epoch, is_over = Seats(), -1, False
    for record in inputs_of_part(part, ticks=False):
        seats.note(record)
        if isinstance(record, EpochBegun):
            epoch = max(epoch, record.epoch)
        is_over = isinstance(record, Ended) and record.reason.startswith(EPOCH_OVER)
    return _LastEpoch(epoch=epoch, part=part, seated=len(seats.taken), is_over=is_over)
