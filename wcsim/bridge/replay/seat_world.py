"""A world with seats, as servers and replays use it: `bridge.world.World`, or a stand-in of benches and tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from wcsim.physics.buffers import ImageSink
from wcsim.types import ClientSnapshot, Command, SeatSpec, Snapshot, StartSpec


class SeatWorld(Protocol):
    """A world with seats."""

    snapshot: Snapshot

    def tick(self, commands: Sequence[Command], out: ImageSink | None = None) -> Snapshot:
        """Carry the world from tick n to n + 1."""

    def admit(self, seat: int, spec: SeatSpec, out: ImageSink | None = None) -> ClientSnapshot:
        """Put a chair into the street for a free seat."""

    def dismiss(self, seat: int) -> None:
        """Take a seat's chair out of the street."""

    def respawn(self, seat: int, out: ImageSink | None = None, start: StartSpec | None = None) -> ClientSnapshot:
        """Begin a seat's next episode, at a start of its own where one is given."""

    def rebuild(self, seed: int, out: ImageSink | None = None) -> Snapshot:
        """A new epoch."""

    def close(self) -> None:
        """End it."""


W_co = TypeVar("W_co", bound=SeatWorld, covariant=True)
Specs = tuple[SeatSpec | None, ...]
"""Of each seat; None for one that is free."""
MakesEpoch = Callable[[Specs, int, int], W_co]
"""Makes the world of an epoch: given who sits there, its seed and its number."""
