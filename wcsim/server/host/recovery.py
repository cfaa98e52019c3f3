"""The world of a server: made new, or gone on with where another died. Loads SUMO and PyBullet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from wcsim.bridge.recording.fingerprint import fingerprint
from wcsim.bridge.replay.player import LogPlayer, MakesEpoch, Seats, SeatWorld, Specs, W, W_co, require_equal
from wcsim.bridge.world import World
from wcsim.core import seeding
from wcsim.errors import ConfigError, WcsimError
from wcsim.log.reader import inputs_of_part, part_files, put_aside, read_header
from wcsim.log.records import Ended, EpochBegun, Header, Input
from wcsim.log.writer import JOURNAL, LogWriter, told_torn
from wcsim.server.host.epoch_cap import EPOCH_OVER
from wcsim.server.launch.event_log import RunLog
from wcsim.server.protocol.events import Rules
from wcsim.server.protocol.members import Member
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldOrder, WorldSpec, town_of_epoch
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import towns_hash


class MakesWorld(Protocol[W_co]):
    """Makes the worlds of orders."""

    def __call__(self, order: WorldOrder, specs: Specs, seed: int, *, epoch: int = 0) -> W_co:
        """A world with a chair for each of `specs` that is not None; `epoch` is the number of its first epoch."""


def made_world(order: WorldOrder) -> World:
    """A world with free seats."""
    return street_world(order, (None,) * order.seats, order.seed)


def street_world(order: WorldOrder, specs: Specs, seed: int, *, epoch: int = 0) -> World:
    """The world of a town; see `MakesWorld`. Raises TownError for one that is not there, and what `World` raises."""
    town = asked_town(town_of_epoch(order.town, order.more_towns, epoch))
    return World(town, order.config, specs, seed, order.place, epoch=epoch)


def epoch_seed(seed: int, epoch: int) -> int:
    """The seed of an epoch: the run's own for the first one."""
    return seed if epoch == 0 else seeding.derive(seed, "epoch", epoch)


ALIVE_EVERY = 10  # records between two signs of life while a world is made again
GATHER_AGAIN_S = 60.0  # the same at the planned end of an epoch, after which all who were in it come back
REGATHER_S = 5.0  # how long a server that was restarted waits for all to come back before it goes on with those here


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """A world with its core, and its journal when it keeps one."""

    world: SeatWorld
    core: ServerCore
    journal: LogWriter | None


def open_server(
    order: WorldSpec, make: MakesWorld[SeatWorld] = street_world, alive: Callable[[], object] = lambda: None
) -> Opened:
    """Make the world of an order, or go on with the journal in its run folder.

    Args:
        order: The order.
        make: Makes the worlds; a stand-in's have no town.
        alive: Called now and then while a world is made again from its journal.

    Raises:
        ConfigError: The order cannot be used, or does not fit the journal.
        WcsimError: What the world raises, or the journal.
    """
    if not order.run or not order.journal:
        return Opened(world=_fresh(order, make, 0), core=ServerCore(order.rules), journal=None)
    path, header = Path(order.run) / JOURNAL, _header(order, has_town=make is street_world)
    parts = part_files(path)
    if not parts:
        Path(order.run).mkdir(parents=True, exist_ok=True)
        return _begun(order, make, LogWriter(path, header), 0, order.rules)
    _require_same(parts[-1], header)
    last = _last_epoch(parts)
    if last.epoch < 0:
        return _begun(order, make, _opened_part(path, header), 0, order.rules)
    if last.is_over or last.part != path:
        return _next(order, make, path, header, last)
    again = _rules_again(order, REGATHER_S)
    if order.recovery == "new_epoch":
        return _begun(order, make, _appended(path), last.epoch + 1, again)
    return _gone_on(order, make, path, again, alive)


def _next(order: WorldSpec, make: MakesWorld[SeatWorld], path: Path, header: Header, last: _LastEpoch) -> Opened:
    """The epoch after one that ended as planned, in a new part of the journal; all who were in it are waited for."""
    if last.part == path:
        _appended(path).close()
        put_aside(path)
    rules = _rules_again(order, GATHER_AGAIN_S)
    if not order.begins:
        rules = replace(rules, expected=max(1, last.seated))
    return _begun(order, make, _opened_part(path, header), last.epoch + 1, rules)


def _rules_again(order: WorldSpec, most_s: float) -> Rules:
    """The rules of an order, waiting for `most_s` at most where those who come were in a world of this launch."""
    return order.rules if order.begins else replace(order.rules, gather_s=min(order.rules.gather_s, most_s))


def _opened_part(path: Path, header: Header) -> LogWriter:
    """The part to write in: a new one, or one whose world ended before its epoch began."""
    return _appended(path) if path.exists() else LogWriter(path, header)


def _begun(order: WorldSpec, make: MakesWorld[SeatWorld], journal: LogWriter, epoch: int, rules: Rules) -> Opened:
    """A fresh world, all seats free."""
    try:
        world = _fresh(order, make, epoch)
        journal.append(EpochBegun(epoch=epoch, seed=epoch_seed(order.seed, epoch), fresh=True))
    except BaseException:
        journal.close()
        raise
    return Opened(world=world, core=ServerCore(rules, epoch), journal=journal)


def _gone_on(
    order: WorldSpec, make: MakesWorld[SeatWorld], path: Path, rules: Rules, alive: Callable[[], object]
) -> Opened:
    """Exactly the world that there was; its clients have to come back."""
    journal = _appended(path)  # cuts a torn record off before anybody reads on
    try:
        world, kept = rebuild_world(path, lambda specs, seed, epoch: make(order, specs, seed, epoch=epoch), alive)
    except BaseException:
        journal.close()
        raise
    if order.begins:  # those who come back have yet to load what they learn with
        rules = replace(rules, rejoin_s=max(rules.rejoin_s, rules.gather_s))
    now = world.snapshot
    return Opened(world=world, core=ServerCore(rules, now.epoch, now.tick, kept), journal=journal)


def rebuild_world(
    journal: Path, make: MakesEpoch[W], alive: Callable[[], object] = lambda: None
) -> tuple[W, tuple[Member, ...]]:
    """The world exactly as it was after the last record, and who sits in it.

    Args:
        journal: The file.
        make: Makes the world of the last epoch: that of `worlds_of`, or a stand-in's.
        alive: Called now and then, for it takes long.

    Raises:
        ReplayMismatchError: A tick gave another state than the journal says.
        WcsimError: What `make` raises; or it is no journal, or its records do not follow from each other.
    """
    player = LogPlayer(make, read_header(journal, "journal").seats)
    records: list[Input] = []
    for record in inputs_of_part(journal):  # those before it are over
        if isinstance(record, EpochBegun):
            for before in records:
                player.seats.note(before)
            records = []
        records.append(record)
    if not records or not isinstance(records[0], EpochBegun):
        raise WcsimError(f"{journal}: it contains no epoch, so there is no world to recompute")
    try:
        for number, record in enumerate(records):
            world = player.play(record)
            require_equal(world, record)
            if number % ALIVE_EVERY == 0:
                alive()
        return world, kept_of(player.seats)
    except BaseException:
        player.close()
        raise


def kept_of(seats: Seats) -> tuple[Member, ...]:
    """Who is in, in seat order."""
    return tuple(
        Member(seat=seat, name=it.name, spec=it.spec, life=seats.lives[seat], claim=bytes.fromhex(it.claim))
        for seat, it in sorted(seats.taken.items())
    )


def _appended(path: Path) -> LogWriter:
    """A journal to go on with; what was cut off its end is said in the events of its run."""
    journal = LogWriter.append_to(path)
    if journal.cut_bytes:
        RunLog(path.parent).add("torn", who="world", reason=told_torn(path, journal.cut_bytes))
    return journal


def _fresh(order: WorldSpec, make: MakesWorld[SeatWorld], epoch: int) -> SeatWorld:
    return make(order, (None,) * order.rules.capacity, epoch_seed(order.seed, epoch), epoch=epoch)


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
        recovery=order.recovery,
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
