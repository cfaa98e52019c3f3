"""Make a world again from its journal, record by record, and compare hash by hash."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from wcsim.bridge.recording.fcd import write_steps
from wcsim.bridge.recording.states import chair_box_m, state_of
from wcsim.bridge.sumo.run_place import RunPlace
from wcsim.bridge.town_run import as_recorded
from wcsim.bridge.world import World
from wcsim.config import RunConfig, parse
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError, ReplayMismatchError, TownError, WcsimError
from wcsim.log.reader import inputs_of_part, iter_inputs, read_header
from wcsim.log.records import Admitted, Dismissed, Ended, EpochBegun, Header, Input, Respawned, Ticked, WorldState
from wcsim.server.protocol.barrier import Kept
from wcsim.server.seat_world import MakesEpoch, SeatWorld, Specs
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import towns_hash

T = TypeVar("T")
W = TypeVar("W", bound=SeatWorld)
Progress = Callable[[int], None]  # (ticks done)
ALIVE_EVERY = 10  # records between two signs of life
Iterations = Generator[T, None, None]
"""An iterator that holds a world, which ends with it: exhaust it, or close it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recomputed:
    """What a journal says, and the world's state after the same was done again."""

    record: Input
    state_hash: str

    @property
    def differs(self) -> bool:
        """Whether the journal tells of another state; it does so at ticks only."""
        return isinstance(self.record, Ticked) and self.record.state_hash != self.state_hash


@dataclass(frozen=True, slots=True, kw_only=True)
class _Verified:
    """How a comparison of all ticks ended."""

    ticks: int = 0  # compared
    mismatches: int = 0
    first: Ticked | None = None  # the first record that differs


def recompute(
    journal: Path, epoch: int | None = None, until_tick: int | None = None, hook: str = ""
) -> Iterations[_Recomputed]:
    """Do again what was done to a world: in one epoch, or in all of them, each in a new world.

    Args:
        journal: The file.
        epoch: Which one; all when None.
        until_tick: The last tick of each epoch to do.
        hook: The user's own step hook, which must be the journal's: that one is code, and not for a file to name.

    Raises:
        TownError: The town is not there, or has other streets than it had.
        WcsimError: It is no journal, has no such epoch, or its records do not follow from each other.
    """
    with closing(replayed(journal, epoch, until_tick, hook)) as steps:
        for world, record in steps:
            yield _Recomputed(record=record, state_hash=world.snapshot.state_hash)


def verify(
    journal: Path,
    epoch: int | None,
    first_tick: int,
    last_tick: int | None,
    progress: Progress = lambda ticks: None,
    hook: str = "",
) -> _Verified:
    """Compare the ticks from `first_tick` to `last_tick` of one or all epochs; raises what `recompute` raises."""
    result = _Verified()
    with closing(recompute(journal, epoch, last_tick, hook)) as steps:
        for step in steps:
            record = step.record
            if not isinstance(record, Ticked) or record.tick < first_tick:
                continue
            wrong = result.mismatches + step.differs
            first = record if step.differs and result.first is None else result.first
            result = replace(result, ticks=result.ticks + 1, mismatches=wrong, first=first)
            progress(result.ticks)
    return result


def rebuild_world(
    journal: Path, make: MakesEpoch[W], alive: Callable[[], object] = lambda: None
) -> tuple[W, tuple[Kept, ...]]:
    """The world exactly as it was after the last record, and who sits in it.

    Args:
        journal: The file.
        make: Makes the world of the last epoch: that of `journal_worlds`, or a stand-in's.
        alive: Called now and then, for it takes long.

    Raises:
        ReplayMismatchError: A tick gave another state than the journal says.
        WcsimError: What `make` raises; or it is no journal, or its records do not follow from each other.
    """
    player = JournalPlayer(make, read_header(journal, "journal").seats)
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
        return world, player.seats.kept()
    except BaseException:
        player.close()
        raise


def journal_worlds(header: Header, hook: str = "") -> MakesEpoch[World]:
    """Makes the worlds of a journal; `hook` has to be the journal's own step hook.

    Raises ConfigError for another hook and for settings that cannot be used, TownError when the town is not there or
    has other streets than it had.
    """
    if header.hook != hook:
        raise ConfigError(
            f"the journal was made with the step hook {escaped(header.hook or 'none', 80)!r}, got {hook or 'none'!r}; "
            "a hook is code: name it with --hook if you trust it"
        )
    towns = tuple(map(asked_town, (header.town, *header.more_towns)))
    if towns_hash(towns) != header.town_sha256:
        named = ", ".join(town.name for town in towns)
        raise TownError(f"{named}: a net has changed since the journal was made; restore it")
    config, place = parse(RunConfig, _config_of(header), "the configuration in the journal"), RunPlace(hook=hook)
    return lambda specs, seed, epoch: World(towns[epoch % len(towns)], config, specs, seed, place, epoch=epoch)


def recompute_fcd(journal: Path, out: Path, epoch: int = 0, hook: str = "") -> int:
    """Make an epoch again and write it as an FCD file; returns the number of its time steps.

    Raises:
        ReplayMismatchError: A tick gave another state than the journal says.
        WcsimError: As `recompute` does.
    """
    with closing(replayed(journal, epoch, None, hook)) as steps:
        world, _ = next(steps)
        written = write_steps(_trace_header(read_header(journal, "journal"), world), _ticks(steps), out)
    if not written:
        raise WcsimError(f"{journal}: has no tick of epoch {epoch}; choose another --epoch")
    return written


def count_ticks(journal: Path, epoch: int | None = None) -> int:
    """How many ticks a journal has, in one epoch or in all. Raises JournalError when it is none."""
    return sum(isinstance(record, Ticked) and epoch in (None, record.epoch) for record in iter_inputs(journal))


def _ticks(steps: Iterable[tuple[World, Input]]) -> Iterator[WorldState]:
    for world, record in steps:
        require_equal(world, record)
        if isinstance(record, Ticked):
            yield state_of(world.snapshot, record.commands, as_recorded(world.snapshot, world.everyone()))


def _trace_header(header: Header, world: World) -> Header:
    return Header(
        town=world.town.name,
        seed=header.seed,
        tick_s=header.tick_s,
        seats=header.seats,
        fingerprint=header.fingerprint,
        origin_m=world.town.file.origin_m,
        origin_z_m=world.street.net_origin_m[2],
        chair_box_m=chair_box_m(world.config.chair),
    )


def require_equal(world: SeatWorld, record: Input) -> None:
    """Raise ReplayMismatchError when a tick gave another state than the journal says."""
    if isinstance(record, Ticked) and record.state_hash != world.snapshot.state_hash:
        raise ReplayMismatchError(
            f"epoch {record.epoch}, tick {record.tick}: got state {world.snapshot.state_hash}, expected "
            f"{record.state_hash} as in the journal; use the versions and the kind of machine that it was made with"
        )


def replayed(
    journal: Path,
    epoch: int | None,
    until_tick: int | None,
    hook: str,
    before: Callable[[World | None, Input], object] = lambda world, record: None,
) -> Iterations[tuple[World, Input]]:
    """Each record of the wanted epochs, with the world after it; the world is closed with the iterator.

    Args:
        journal: The file.
        epoch: Which one; all when None.
        until_tick: The last tick of each epoch to do.
        hook: As for `recompute`, which raises the same.
        before: Is shown the world before each record, None where there is none yet.
    """
    header = read_header(journal, "journal")
    player = JournalPlayer(journal_worlds(header, hook), header.seats)
    known: set[int] = set()
    try:
        for record in iter_inputs(journal):
            if isinstance(record, Ended):
                continue
            begins, wanted = isinstance(record, EpochBegun), epoch in (None, record.epoch)
            if begins:
                known.add(record.epoch)
            late = isinstance(record, Ticked) and until_tick is not None and record.tick > until_tick
            if late or not wanted:
                player.close()
            if player.plays or (begins and wanted):
                before(player.world, record)
                yield player.play(record), record
            else:
                player.seats.note(record)
    finally:
        player.close()
    if not known:
        raise WcsimError(
            f"{journal}: has no epoch: it is truncated, or its world never started; expected a whole journal"
        )
    if epoch is not None and epoch not in known:
        raise WcsimError(f"{journal}: has no epoch {epoch}; expected one of {sorted(known)}")


class Seats:
    """Who sits where, by what a journal says."""

    def __init__(self) -> None:
        self._taken: dict[int, Admitted] = {}
        self._lives: Counter[int] = Counter()  # respawns of a seat since the last tick

    def note(self, record: Input) -> None:
        """Hear the next record."""
        match record:
            case Admitted():
                self._taken[record.seat] = record
                del self._lives[record.seat]
            case Dismissed():
                self._taken.pop(record.seat, None)
            case Respawned():
                self._lives[record.seat] += 1
            case Ticked():
                self._lives.clear()
            case EpochBegun():
                self._lives.clear()
                if record.fresh:
                    self._taken.clear()

    def specs(self, capacity: int) -> Specs:
        """The seats of a world."""
        return tuple(taken.spec if (taken := self._taken.get(seat)) else None for seat in range(capacity))

    def kept(self) -> tuple[Kept, ...]:
        """Who is in, in seat order."""
        return tuple(
            Kept(seat=seat, name=it.name, spec=it.spec, life=self._lives[seat], claim=bytes.fromhex(it.claim))
            for seat, it in sorted(self._taken.items())
        )


class JournalPlayer(Generic[W]):
    """Does to a world what a journal says was done, and keeps who sits where while there is no world."""

    def __init__(self, make: MakesEpoch[W], capacity: int) -> None:
        self.seats = Seats()
        self._make, self._capacity = make, capacity
        self._world: W | None = None

    @property
    def world(self) -> W | None:
        """The world of now."""
        return self._world

    @property
    def plays(self) -> bool:
        """Whether there is a world now."""
        return self._world is not None

    def close(self) -> None:
        """End the world, if there is one."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def play(self, record: Input) -> W:
        """Do what a record says; raises WcsimError when it does not follow from those before."""
        self.seats.note(record)
        if isinstance(record, EpochBegun):
            self.close()
            self._world = self._make(self.seats.specs(self._capacity), record.seed, record.epoch)
            return self._world
        if self._world is None:
            raise WcsimError(f"{record} comes before the first epoch; the journal is damaged")
        if not isinstance(record, Ended):
            _require_now(self._world, record)
            _do(self._world, record)
        return self._world


def _do(world: SeatWorld, record: Admitted | Dismissed | Respawned | Ticked) -> None:
    if isinstance(record, Ticked):
        world.tick(record.commands)
    elif isinstance(record, Admitted):
        world.admit(record.seat, record.spec)
    elif isinstance(record, Dismissed):
        world.dismiss(record.seat)
    else:
        world.respawn(record.seat)


def _require_now(world: SeatWorld, record: Admitted | Dismissed | Respawned | Ticked) -> None:
    here, ticks = world.snapshot, isinstance(record, Ticked)
    if (record.epoch, record.tick - ticks) != (here.epoch, here.tick):
        raise WcsimError(
            f"{type(record).__name__} of epoch {record.epoch}, tick {record.tick} follows epoch {here.epoch}, tick "
            f"{here.tick}; expected {'the next tick' if ticks else 'this one'}: the journal is damaged"
        )


def _config_of(header: Header) -> dict[str, object]:
    try:
        config = json.loads(header.config)
    except (ValueError, RecursionError):
        config = None
    if not isinstance(config, dict):
        raise ConfigError("the configuration in the journal is not a JSON object; the journal is damaged")
    return config
