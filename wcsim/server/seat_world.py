"""A world with seats, as a server uses it: `bridge.world.World`, or a stand-in of benches and tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from wcsim.physics.buffers import ImageSink
from wcsim.server.specs import WorldOrder
from wcsim.types import ClientSnapshot, Command, SeatSpec, Snapshot


class SeatWorld(Protocol):
    """A world with seats."""

    snapshot: Snapshot

    def tick(self, commands: Sequence[Command], out: ImageSink | None = None) -> Snapshot:
        """Carry the world from tick n to n + 1."""

    def admit(self, seat: int, spec: SeatSpec, out: ImageSink | None = None) -> ClientSnapshot:
        """Put a chair into the street for a free seat."""

    def dismiss(self, seat: int) -> None:
        """Take a seat's chair out of the street."""

    def respawn(self, seat: int, out: ImageSink | None = None) -> ClientSnapshot:
        """Begin a seat's next episode."""

    def rebuild(self, seed: int, out: ImageSink | None = None) -> Snapshot:
        """A new epoch."""

    def close(self) -> None:
        """End it."""


W_co = TypeVar("W_co", bound=SeatWorld, covariant=True)
Specs = tuple[SeatSpec | None, ...]
"""Of each seat; None for one that is free."""


class MakesWorld(Protocol[W_co]):
    """Makes the worlds of orders."""

    def __call__(self, order: WorldOrder, specs: Specs, seed: int, *, epoch: int = 0) -> W_co:
        """A world with a chair for each of `specs` that is not None; `epoch` is the number of its first epoch."""


MakesEpoch = Callable[[Specs, int, int], W_co]
"""Makes the world of an epoch: given who sits there, its seed and its number."""
