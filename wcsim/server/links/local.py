"""A world in this very process: it ticks once all seats have sent their actions.

No other seat can act while one waits, so a wait for another seat is an error at once, not a
deadlock: with several seats, first `send` for all of them, then `receive`.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from wcsim.bridge.world_rollout import rollout
from wcsim.errors import LinkClosedError, ProtocolError, TickTimeoutError
from wcsim.server.host.opening import make_street_world
from wcsim.server.links.base import INTERRUPTED, LinkWaitTimes, SeatLink, SeatLinkGroup
from wcsim.server.specs import WorldBuildSpec
from wcsim.types import ClientSnapshot, Joystick, SeatSpec


class _LocalWorld:
    """A world in this process, with the actions of its seats."""

    def __init__(self, order: WorldBuildSpec) -> None:
        self.world = make_street_world(order, (None,) * order.seats, order.seed)
        self.sticks: dict[int, Joystick] = {}  # of the next tick, by seat
        self.is_broken = False  # an interrupt or an error came while the world changed
        self.waits = LinkWaitTimes()

    def frame(self, seat: int) -> ClientSnapshot | None:
        """The present frame of a seat; None for a free one."""
        return {client.seat: client for client in self.world.snapshot.clients}.get(seat)

    @contextmanager
    def changing(self) -> Iterator[None]:
        """The world is unusable if the block is left by an error."""
        self.is_broken = True
        yield
        self.is_broken = False

    def tick(self) -> None:
        """Advance the world. Raises TickTimeoutError when a seat has not sent its action."""
        late = [str(seat.index) for seat in self.world.seats if seat.index not in self.sticks]
        if late:
            raise TickTimeoutError(
                f"the tick waits for seat {', '.join(late)}; "
                "in one process no other seat can act meanwhile: send for all seats first"
            )
        start_s = time.perf_counter()
        with self.changing():
            drivers = dict.fromkeys(self.sticks, lambda client: self.sticks[client.seat])
            next(rollout(self.world, drivers))
        self.sticks.clear()
        total_s = time.perf_counter() - start_s + self.waits.link_s
        self.waits = LinkWaitTimes(steps=self.waits.steps + 1, simulation_s=total_s, link_s=total_s)


class _LocalSeat(SeatLink):
    """One seat of a world in this process."""

    def __init__(self, home: _LocalWorld, seat: int, spec: SeatSpec) -> None:
        self.seat, self._spec = seat, spec
        self._home = home
        self._closed = False

    def join(self) -> ClientSnapshot:
        """See `SeatLink`."""
        if self._home.frame(self.seat) is None:
            self.request_join()
        return self.receive()

    def request_join(self) -> None:
        """See `SeatLink`."""
        with self._open_world().changing():
            self._home.world.admit(self.seat, self._spec)

    def send(self, tick: int, joystick: Joystick) -> None:
        """See `SeatLink`."""
        home = self._open_world()
        if self.interrupted:
            raise ProtocolError(INTERRUPTED)
        now = home.world.snapshot.tick
        if tick != now:
            raise ProtocolError(f"an action for tick {tick}; the seat is at tick {now}")
        home.sticks[self.seat] = joystick

    def receive(self) -> ClientSnapshot:
        """See `SeatLink`."""
        if self.seat in self._open_world().sticks:
            self._home.tick()
        frame = self._home.frame(self.seat)
        if frame is None:
            raise ProtocolError("nobody sits here; call join() first")
        return frame

    def request_respawn(self) -> None:
        """See `SeatLink`."""
        with self._open_world().changing():
            self._home.world.respawn(self.seat)

    def rebuild(self, seed: int) -> ClientSnapshot:
        """See `SeatLink`."""
        with self._open_world().changing():
            self._home.world.rebuild(seed)
        return self.receive()

    @property
    def interrupted(self) -> bool:
        """See `SeatLink`."""
        return self._home.is_broken or self.seat in self._home.sticks

    @property
    def epoch(self) -> int:
        """See `SeatLink`."""
        return self._home.world.snapshot.epoch

    @property
    def waits(self) -> LinkWaitTimes:
        """See `SeatLink`."""
        return self._home.waits

    def close(self) -> None:
        """Take the chair out of the street; a second call does nothing."""
        if not self._closed and self._home.frame(self.seat) is not None:
            self._home.sticks.pop(self.seat, None)
            self._home.world.dismiss(self.seat)
        self._closed = True

    def _open_world(self) -> _LocalWorld:
        if self._closed:
            raise LinkClosedError("this link is closed; create a new one")
        return self._home


class LocalSeatLinkGroup(SeatLinkGroup):
    """A group whose world is in this process.

    Raises WorldInUseError while another world lives here.
    """

    def __init__(self, order: WorldBuildSpec) -> None:
        self._order = order
        self.home = _LocalWorld(order)
        self._connect()

    def close(self) -> None:
        """See `SeatLinkGroup.close`."""
        self.home.world.close()
        self.links = ()

    def _renew(self, seed: int) -> None:
        self.home.world.rebuild(seed)
        self._connect()

    def _connect(self) -> None:
        self.links = [
            _LocalSeat(self.home, seat, self._order.seat) for seat in range(self._order.seats)
        ]
