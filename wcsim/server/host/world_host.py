"""A server core with a world: carries out what the core wants done, writes the journal, keeps everybody's frame.

The order is always: the world changes, the journal has it, the clients hear of it. So what a client has seen is in the
journal, whatever dies when.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable

from wcsim.bridge.replay.player import SeatWorld
from wcsim.errors import PhysicsError, WcsimError
from wcsim.log.records import Admitted, Dismissed, EpochBegun, Input, Respawned, ticked
from wcsim.server.protocol import events as ev
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.transport.shared_images import RingSink

log = logging.getLogger("wcsim.server.host.world_host")

Post = Callable[[ev.Peer, m.Reply], None]
Keep = Callable[[Input], None]


class WorldHost:
    """A core, its world and its journal; see the module's text."""

    def __init__(
        self,
        core: ServerCore,
        world: SeatWorld,
        post: Post,
        keep: Keep = lambda record: None,
        sink: RingSink | None = None,
        loading: Callable[[], object] = lambda: None,
    ) -> None:
        """Host a world.

        Args:
            core: Its seats fit those that are taken in the world.
            world: The world; the hub does not close it.
            post: Sends a message to a peer; must not block.
            keep: Writes a record of the journal.
            sink: Where pictures go; the world's own buffers without one.
            loading: Told before a world is made anew, which takes its time.
        """
        self.core, self.world = core, world
        self._post, self._keep, self._sink, self._loading = post, keep, sink, loading
        self._frames = {client.seat: client for client in world.snapshot.clients}
        self._refused: set[int] = set()
        self.step_s = 0.0  # what the last step took
        self.ticks = 0  # steps done by this hub

    def feed(self, event: ev.Event, now_s: float) -> None:
        """Let something happen, and do all that follows from it.

        Raises:
            WcsimError: The world failed, or the journal cannot be written; the hub is of no use then.
        """
        todo: deque[ev.Effect] = deque(self.core.handle(event, now_s))
        while todo:
            effect = todo.popleft()
            match effect:
                case ev.Send():
                    self._post(effect.peer, effect.message)
                case ev.SendFrame():
                    self._send_frame(effect)
                case ev.Step():
                    todo.extend(self._step(effect, now_s))
                case ev.Admit():
                    todo.extend(self._admit(effect, now_s))
                case ev.Dismiss():
                    self._dismiss(effect)
                case ev.RespawnSeats():
                    self._respawn(effect)
                case ev.RebuildWorld():
                    self._rebuild(effect)

    # --- the world ---

    def _step(self, step: ev.Step, now_s: float) -> list[ev.Effect]:
        begun_s = time.perf_counter()
        self._turn(step.tick + 1)
        after = self.world.tick(step.commands, self._sink)
        self._keep(ticked(after.epoch, after.tick, step.commands, after.state_hash))
        self._frames = {client.seat: client for client in after.clients}
        self.step_s = time.perf_counter() - begun_s
        self.ticks += 1
        return self.core.handle(ev.Stepped(after.tick, self.step_s), now_s + self.step_s)

    def _admit(self, admit: ev.Admit, now_s: float) -> list[ev.Effect]:
        now = self.world.snapshot
        self._turn(now.tick)
        try:
            client = self.world.admit(admit.seat, admit.spec, self._sink)
        except Exception as error:  # whatever a client asks for, nobody else's world ends of it
            if self.world.snapshot is not now:
                raise
            return self._refuse(admit.seat, _as_refusal(error), now_s)
        self._frames[admit.seat] = client
        self._keep(
            Admitted(
                epoch=now.epoch, tick=now.tick, seat=admit.seat, spec=admit.spec, name=admit.name
            )
        )
        return []

    def _refuse(self, seat: int, error: WcsimError, now_s: float) -> list[ev.Effect]:
        """The world takes no such chair: its client hears why, and the core that it is gone."""
        member = self.core.roll.at(seat)
        if member is None:
            raise error
        self._refused.add(seat)
        self._post(member.peer, m.failure_of(error, member.session))
        return self.core.handle(ev.Lost(member.session, str(error)), now_s)

    def _dismiss(self, dismiss: ev.Dismiss) -> None:
        if dismiss.seat in self._refused:
            self._refused.remove(dismiss.seat)
            return
        now = self.world.snapshot
        self.world.dismiss(dismiss.seat)
        self._frames.pop(dismiss.seat, None)
        self._keep(
            Dismissed(epoch=now.epoch, tick=now.tick, seat=dismiss.seat, reason=dismiss.reason)
        )

    def _respawn(self, respawn: ev.RespawnSeats) -> None:
        now = self.world.snapshot
        self._turn(now.tick)
        for seat in respawn.seats:
            self._frames[seat] = self.world.respawn(seat, self._sink)
            self._keep(Respawned(epoch=now.epoch, tick=now.tick, seat=seat))

    def _rebuild(self, rebuild: ev.RebuildWorld) -> None:
        self._loading()
        self._turn(0)
        after = self.world.rebuild(rebuild.seed, self._sink)
        self._keep(EpochBegun(epoch=rebuild.epoch, seed=rebuild.seed))
        self._frames = {client.seat: client for client in after.clients}

    def _turn(self, tick: int) -> None:
        if self._sink is not None:
            self._sink.turn(tick)

    # --- the clients ---

    def _send_frame(self, wanted: ev.SendFrame) -> None:
        client = self._frames.get(wanted.seat)
        if client is not None:
            slot = -1 if self._sink is None else self._sink.slot(wanted.tick)
            self._post(wanted.peer, m.Frame(wanted.epoch, wanted.tick, wanted.life, client, slot))


def _as_refusal(error: Exception) -> WcsimError:
    """An error as one that a client may see."""
    if isinstance(error, WcsimError):
        return error
    log.error("a client's chair could not be put into the street", exc_info=error)
    return PhysicsError(
        f"this chair does not fit into the world ({type(error).__name__}); choose another start or user"
    )
