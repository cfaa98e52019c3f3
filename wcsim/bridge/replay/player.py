"""Does to a world what its log has recorded; and what such a world with seats must offer."""

from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

from wcsim.errors import WcsimError
from wcsim.log.records import Admitted, Dismissed, Ended, EpochBegun, Input, WorldTick
from wcsim.physics.buffers import ImageSink
from wcsim.types import ClientSnapshot, Command, SeatSpec, Snapshot, StartSpec

Specs = tuple[SeatSpec | None, ...]
"""Of each seat; None for one that is free."""


class SeatWorld(Protocol):
    """A world with seats."""

    snapshot: Snapshot

    def tick(self, commands: Sequence[Command], out: ImageSink | None = None) -> Snapshot:
        """Carry the world from tick n to n + 1."""

    def admit(self, seat: int, spec: SeatSpec, out: ImageSink | None = None) -> ClientSnapshot:
        """Put a chair into the street for a free seat."""

    def dismiss(self, seat: int) -> None:
        """Take a seat's chair out of the street."""

    def respawn(
        self, seat: int, out: ImageSink | None = None, start: StartSpec | None = None
    ) -> ClientSnapshot:
        """Start a seat's next episode, at a start of its own where one is given."""

    def rebuild(self, seed: int, out: ImageSink | None = None) -> Snapshot:
        """A new epoch."""

    def close(self) -> None:
        """End it."""


W_co = TypeVar("W_co", bound=SeatWorld, covariant=True)
MakesEpoch = Callable[[Specs, int, int], W_co]
"""Makes the world of an epoch of its seats, its seed and its number."""
W = TypeVar("W", bound=SeatWorld)


class Seats:
    """The taken seats, by the records of a log."""

    def __init__(self) -> None:
        self.taken: dict[int, Admitted] = {}

    def note(self, record: Input) -> None:
        """Take the next record."""
        match record:
            case Admitted():
                self.taken[record.seat] = record
            case Dismissed():
                self.taken.pop(record.seat, None)
            case EpochBegun() if record.fresh:
                self.taken.clear()

    def specs(self, capacity: int) -> Specs:
        """The seats of a world."""
        taken = map(self.taken.get, range(capacity))
        return tuple(None if record is None else record.spec for record in taken)


class LogPlayer(Generic[W]):
    """Does to a world what a log has recorded; knows the seats also while there is no world."""

    def __init__(self, make: MakesEpoch[W], capacity: int) -> None:
        self.seats = Seats()
        self._make, self._capacity = make, capacity
        self.world: W | None = None  # of now

    def close(self) -> None:
        """End the world, if there is one."""
        if self.world is not None:
            self.world.close()
            self.world = None

    def play(self, record: Input) -> W:
        """Do what a record says; raises WcsimError when it does not follow from those before."""
        self.seats.note(record)
        if isinstance(record, EpochBegun):
            self.close()
            self.world = self._make(self.seats.specs(self._capacity), record.seed, record.epoch)
            return self.world
        if self.world is None:
            raise WcsimError(f"{record} comes before the first epoch; the log is damaged")
        world = self.world
        if isinstance(record, Ended):
            return world
        here, ticks = world.snapshot, isinstance(record, WorldTick)
        if (record.epoch, record.tick - ticks) != (here.epoch, here.tick):
            raise WcsimError(
                f"{type(record).__name__} of epoch {record.epoch}, tick {record.tick} follows "
                f"epoch {here.epoch}, tick {here.tick}; "
                f"expected {'the next tick' if ticks else 'this one'}: the log is damaged"
            )
        if isinstance(record, WorldTick):
            world.tick(record.commands)
        elif isinstance(record, Admitted):
            world.admit(record.seat, record.spec)
        elif isinstance(record, Dismissed):
            world.dismiss(record.seat)
        else:
            world.respawn(record.seat, start=record.start)
        return world
