"""How a client reaches its wheelchair: one interface, whether the world is in this process or in another one.

A link is for one seat. `act` names the tick it is for, so nothing is ever "the next": an action for another tick than
the seat's own is a ProtocolError. Snapshots are valid until the client's next call.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from wcsim.bridge.stage import RunPlace
from wcsim.bridge.world import World
from wcsim.config import RunConfig
from wcsim.towns.town import find_town
from wcsim.types import ClientSnapshot, Command, Joystick, SeatSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldOrder:
    """Everything that a world with one seat is made from."""

    town: str
    config: RunConfig
    seat: SeatSpec
    seed: int
    run: str = ""  # the run folder, where the outputs of the town's own scenario go
    hook: str = ""  # the user's own step hook, module:Class

    @property
    def place(self) -> RunPlace:
        """The same for a world."""
        return RunPlace(folder=Path(self.run) if self.run else None, hook=self.hook)


class WorldLink(Protocol):
    """One seat of a world."""

    def join(self) -> ClientSnapshot:
        """The frame the seat has now: the first one of its episode when nothing was done yet."""

    def act(self, tick: int, joystick: Joystick) -> ClientSnapshot:
        """Drive through tick `tick` with this joystick; returns the frame of tick + 1."""

    def respawn(self) -> ClientSnapshot:
        """Begin the seat's next episode now, without a tick."""

    def rebuild(self, seed: int) -> ClientSnapshot:
        """Begin the world again with another seed; for a sole client or the master."""

    def close(self) -> None:
        """Leave; a second call does nothing."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None: ...


class LocalLink:
    """A world with one seat in this process; raises WorldInUseError while another one lives here."""

    def __init__(self, order: WorldOrder) -> None:
        self._world = World(find_town(order.town), order.config, (order.seat,), order.seed, order.place)

    def join(self) -> ClientSnapshot:
        """See `WorldLink.join`."""
        return self._world.snapshot.clients[0]

    def act(self, tick: int, joystick: Joystick) -> ClientSnapshot:
        """See `WorldLink.act`."""
        return self._world.tick((Command(seat=0, tick=tick, joystick=joystick),)).clients[0]

    def respawn(self) -> ClientSnapshot:
        """See `WorldLink.respawn`."""
        return self._world.respawn(0)

    def rebuild(self, seed: int) -> ClientSnapshot:
        """See `WorldLink.rebuild`."""
        return self._world.rebuild(seed).clients[0]

    def close(self) -> None:
        """See `WorldLink.close`."""
        self._world.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self.close()
