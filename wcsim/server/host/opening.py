"""The world of a server, and its journal: the first epoch, or the next one after an end or a death.

Loads SUMO and PyBullet.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from wcsim.bridge.replay.player import Seats, SeatWorld, Specs
from wcsim.bridge.world import World
from wcsim.core import seeding
from wcsim.errors import ConfigError
from wcsim.log.fingerprint import make_software_fingerprint
from wcsim.log.reader import iter_journal_part_inputs, list_log_parts, read_header, rotate_log
from wcsim.log.records import Ended, EpochBegun, Header
from wcsim.log.writer import JOURNAL, LogWriter, format_truncation_warning
from wcsim.server.launch.event_log import EventLogWriter
from wcsim.server.protocol.events import ServerRules
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldBuildSpec, WorldProcessSpec, town_name_for_epoch
from wcsim.towns.making.asked_town import requested_town
from wcsim.towns.scenario.town import towns_hash
from wcsim.users.recordings.recorded_user import find_user

EPOCH_OVER: Final = "the world generation is over"
"""The reason of a world's end starts so if another process goes on with the next epoch."""
GATHER_AGAIN_S: Final = 60.0  # after an epoch's planned end, for all clients to come back
REGATHER_S: Final = 5.0  # after a world's death: its clients may have died with it

MakeWorld = Callable[[WorldBuildSpec, Specs, int, int], SeatWorld]
"""Makes the world of an order, with a chair for each of the specs that is not None.

The numbers are its seed and its first epoch.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerParts:
    """A world with its core, and its journal when it writes one."""

    world: SeatWorld
    core: ServerCore
    journal: LogWriter | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _LastEpoch:
    epoch: int = -1  # -1 where none was begun
    part: Path | None = None  # of the journal, in which it was begun
    seated: int = 0  # clients in it at its end
    is_over: bool = False  # it ended as planned


def make_street_world(order: WorldBuildSpec, specs: Specs, seed: int, epoch: int = 0) -> World:
    """The world of a town; see `MakeWorld`.

    Raises TownError for a town that does not exist, and what `World` raises.
    """
    town = requested_town(town_name_for_epoch(order.town, order.more_towns, epoch))
    return World(town, order.config, specs, seed, order.place, epoch=epoch, find_user=find_user)


def open_server_parts(order: WorldProcessSpec, make: MakeWorld = make_street_world) -> ServerParts:
    """Make the world of an order: the next epoch where the journal in its run folder has one.

    An epoch whose world died is over, as one that ended as planned. None of its state is needed,
    because no client waits for it.

    Args:
        order: The order.
        make: Makes the worlds; a fake one has no town.

    Raises:
        ConfigError: The order cannot be used, or does not fit the journal.
        WcsimError: What the world raises, or the journal.
    """
    no_clients = (None,) * order.rules.capacity
    if not order.run or not order.journal:
        world = make(order, no_clients, order.seed, 0)
        return ServerParts(world=world, core=ServerCore(order.rules), journal=None)
    # 1. The journal of an earlier process must be of the same world.
    path = Path(order.run) / JOURNAL
    names = (order.town, *order.more_towns) if make is make_street_world else ()
    header = Header(
        name=order.name,
        town=order.town,
        more_towns=order.more_towns,
        town_sha256=towns_hash(tuple(map(requested_town, names))),
        config=order.config.model_dump_json(),
        seed=order.seed,
        seats=order.rules.capacity,
        tick_s=order.config.world.tick_s,
        fingerprint=make_software_fingerprint(),
        hook=order.hook,
    )
    parts = list_log_parts(path)
    if parts:
        _require_same(parts[-1], header)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
    # 2. A part in which an epoch was begun is put aside. Opening it cuts a truncated record off
    #    before anything reads on.
    last = _last_epoch(parts)
    if last.part == path:
        _append_to(path).close()
        rotate_log(path)
    # 3. A part that is there now belongs to a world that ended before its epoch was begun.
    journal = _append_to(path) if path.exists() else LogWriter(path, header)
    # 4. The world of the next epoch, with all seats free.
    epoch = last.epoch + 1
    seed = _epoch_seed(order.seed, epoch)
    try:
        world = make(order, no_clients, seed, epoch)
        journal.append(EpochBegun(epoch=epoch, seed=seed, fresh=True))
    except BaseException:
        journal.close()
        raise
    core = ServerCore(_rules_after(order, last), epoch)
    return ServerParts(world=world, core=core, journal=journal)


def _require_same(path: Path, order: Header) -> None:
    """Raise ConfigError when the journal is of another world."""
    header = read_header(path, "journal")
    for name in ("town_sha256", "config", "seed", "seats", "hook"):
        old, new = getattr(header, name), getattr(order, name)
        if old != new:
            raise ConfigError(
                f"{path}: belongs to another world: its {name} is {str(old)[:80]!r}, "
                f"not {str(new)[:80]!r}; use the same settings, or choose a new folder"
            )


def _last_epoch(parts: Sequence[Path]) -> _LastEpoch:
    """How the last epoch of a journal ended; a part whose world ended while loading has none."""
    for part in reversed(parts):
        seats, epoch, is_over = Seats(), -1, False
        for record in iter_journal_part_inputs(part, ticks=False):
            seats.note(record)
            if isinstance(record, EpochBegun):
                epoch = max(epoch, record.epoch)
            is_over = isinstance(record, Ended) and record.reason.startswith(EPOCH_OVER)
        if epoch >= 0:
            seated = len(seats.taken)
            return _LastEpoch(epoch=epoch, part=part, seated=seated, is_over=is_over)
    return _LastEpoch()


def _append_to(path: Path) -> LogWriter:
    """A journal to go on with; the events of its run say what was cut off its end."""
    journal = LogWriter.append_to(path)
    if journal.cut_bytes:
        EventLogWriter(path.parent).add(
            "torn", who="world", reason=format_truncation_warning(path, journal.cut_bytes)
        )
    return journal


def _epoch_seed(seed: int, epoch: int) -> int:
    """The seed of an epoch: the run's own for the first one."""
    return seed if epoch == 0 else seeding.derive_seed(seed, "epoch", epoch)


def _rules_after(order: WorldProcessSpec, last: _LastEpoch) -> ServerRules:
    """The rules of an order; after an epoch of this launch its clients are waited for."""
    if order.begins or last.epoch < 0:
        return order.rules
    longest_s = GATHER_AGAIN_S if last.is_over else REGATHER_S
    gather_s = min(order.rules.gather_s, longest_s)
    return replace(order.rules, expected=max(1, last.seated), gather_s=gather_s)
