"""What a server process begins with: a new world with a new journal, or one that goes on where another died."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from wcsim.bridge.recording.fingerprint import fingerprint
from wcsim.errors import ConfigError, ReplayMismatchError
from wcsim.server.host.made_world import epoch_seed, made_world
from wcsim.server.host.world_host import SeatWorld
from wcsim.server.journal.journal import JOURNAL, JournalWriter, iter_journal, read_header
from wcsim.server.journal.records import (
    Admitted,
    Dismissed,
    Ended,
    EpochBegun,
    JournalHeader,
    JournalRecord,
    Respawned,
    Ticked,
)
from wcsim.server.journal.replay import rebuild_world
from wcsim.server.journal.torn import told_torn
from wcsim.server.launch.event_log import RunLog
from wcsim.server.protocol.barrier import Kept
from wcsim.server.protocol.events import Rules
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldOrder, WorldSpec
from wcsim.towns.scenario.town import find_town, streets_hash
from wcsim.types import SeatSpec

REGATHER_S = 5.0  # how long a server that was restarted waits for all to come back before it goes on with those here


class MakesWorld(Protocol):
    """The class of a stand-in."""

    def __call__(
        self, order: WorldOrder, specs: tuple[SeatSpec | None, ...], seed: int, *, epoch: int = 0
    ) -> SeatWorld:
        """A world with a chair for each of `specs` that is not None."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """A world with its core, and its journal when it keeps one."""

    world: SeatWorld
    core: ServerCore
    journal: JournalWriter | None


def open_server(order: WorldSpec) -> Opened:
    """Make the world of an order, or go on with the journal in its run folder.

    Raises:
        ConfigError: The order cannot be used, or does not fit the journal.
        WcsimError: What the world raises, or the journal.
    """
    if not order.run or not order.journal:
        return Opened(world=_world(order, 0), core=ServerCore(order.rules), journal=None)
    path = Path(order.run) / JOURNAL
    if not path.exists():
        Path(order.run).mkdir(parents=True, exist_ok=True)
        return _begun(order, JournalWriter(path, _header(order)), 0, order.rules)
    _require_same(path, order)
    last = _last_epoch(path)
    gather_s = order.rules.gather_s if last < 0 else min(order.rules.gather_s, REGATHER_S)  # nobody was in yet, or some
    again = replace(order.rules, gather_s=gather_s)
    if last < 0 or order.recovery == "new_epoch":
        return _begun(order, _appended(path), last + 1, again)
    return _gone_on(order, path, again)


def _begun(order: WorldSpec, journal: JournalWriter, epoch: int, rules: Rules) -> Opened:
    """A fresh world, all seats free."""
    try:
        world = _world(order, epoch)
        journal.append(EpochBegun(epoch=epoch, seed=epoch_seed(order.seed, epoch), fresh=True))
    except BaseException:
        journal.close()
        raise
    return Opened(world=world, core=ServerCore(rules, epoch), journal=journal)


def _gone_on(order: WorldSpec, path: Path, rules: Rules) -> Opened:
    """Exactly the world that there was; its clients have to come back."""
    journal = _appended(path)  # cuts a torn record off before anybody reads on
    try:
        world: SeatWorld
        if order.stand_in:
            world = _redone(order, path)
        else:
            world, _ = rebuild_world(path, order.world.place)
        now = world.snapshot
        kept = kept_members(iter_journal(path))
    except BaseException:
        journal.close()
        raise
    return Opened(world=world, core=ServerCore(rules, now.epoch, now.tick, kept), journal=journal)


def _appended(path: Path) -> JournalWriter:
    """A journal to go on with; what was cut off its end is said in the events of its run."""
    journal = JournalWriter.append_to(path)
    if journal.cut_bytes:
        RunLog(path.parent).add("torn", who="world", reason=told_torn(path, journal.cut_bytes))
    return journal


def _world(order: WorldSpec, epoch: int) -> SeatWorld:
    if not order.stand_in:
        return made_world(order.world, epoch)
    make = _stand_in(order.stand_in)
    return make(order.world, (None,) * order.rules.capacity, epoch_seed(order.seed, epoch), epoch=epoch)


def _stand_in(name: str) -> MakesWorld:
    module, _, kind = name.partition(":")
    try:
        found: MakesWorld = getattr(importlib.import_module(module), kind)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"stand-in {name!r}: {error}; expected module:Class") from None
    return found


def kept_members(records: Iterable[JournalRecord]) -> tuple[Kept, ...]:
    """Who is in after the records of a whole journal, in seat order."""
    kept: dict[int, Kept] = {}
    for record in records:
        match record:
            case Admitted():
                claim = bytes.fromhex(record.claim)
                kept[record.seat] = Kept(seat=record.seat, name=record.name, spec=record.spec, life=0, claim=claim)
            case Dismissed():
                kept.pop(record.seat, None)
            case Respawned():
                kept[record.seat] = replace(kept[record.seat], life=kept[record.seat].life + 1)
            case Ticked():
                kept = {seat: replace(item, life=0) if item.life else item for seat, item in kept.items()}
            case EpochBegun():
                kept = {} if record.fresh else {seat: replace(item, life=0) for seat, item in kept.items()}
            case Ended():
                pass
    return tuple(kept[seat] for seat in sorted(kept))


def _redone(order: WorldSpec, path: Path) -> SeatWorld:
    """A stand-in in which the last epoch of a journal was done again."""
    world = _world(order, 0)
    before: list[JournalRecord] = []
    for record in iter_journal(path):
        match record:
            case EpochBegun():
                taken = {} if record.fresh else {item.seat: item.spec for item in kept_members(before)}
                specs = tuple(taken.get(seat) for seat in range(order.rules.capacity))
                world = _stand_in(order.stand_in)(order.world, specs, record.seed, epoch=record.epoch)
            case Admitted():
                world.admit(record.seat, record.spec)
            case Dismissed():
                world.dismiss(record.seat)
            case Respawned():
                world.respawn(record.seat)
            case Ticked():
                world.tick(record.commands)
                _require_hash(world, record)
            case Ended():
                pass
        before.append(record)
    return world


def _require_hash(world: SeatWorld, record: Ticked) -> None:
    if world.snapshot.state_hash != record.state_hash:
        raise ReplayMismatchError(
            f"epoch {record.epoch}, tick {record.tick}: got {world.snapshot.state_hash}, expected {record.state_hash}"
        )


def _header(order: WorldSpec) -> JournalHeader:
    world = order.world
    return JournalHeader(
        name=order.name,
        town=order.town,
        town_sha256="" if order.stand_in else streets_hash(find_town(order.town)),
        config=world.config.model_dump_json(),
        seed=order.seed,
        capacity=order.rules.capacity,
        tick_s=world.config.world.tick_s,
        fingerprint=fingerprint(),
        hook=order.hook,
        recovery=order.recovery,
    )


def _require_same(path: Path, order: WorldSpec) -> None:
    """Raise ConfigError when the journal is of another world."""
    old, new = read_header(path), _header(order)
    for name in ("town_sha256", "config", "seed", "capacity", "hook"):
        if getattr(old, name) != getattr(new, name):
            raise ConfigError(
                f"{path}: is of another world: its {name} is {str(getattr(old, name))[:80]!r}, not "
                f"{str(getattr(new, name))[:80]!r}; go on with the same settings, or choose a new folder"
            )


def _last_epoch(path: Path) -> int:
    begun = (record for record in iter_journal(path, ticks=False) if isinstance(record, EpochBegun))
    return max((record.epoch for record in begun), default=-1)
