"""A server core with a world: carries out what the core requests, and writes the journal.

The order is always: the world changes, the journal has it, the clients get it. So what a client has
seen is in the journal, whichever process dies at what time.
"""

import logging
import time
from collections import deque
from collections.abc import Callable

from wcsim.bridge.replay.player import SeatWorld
from wcsim.errors import PhysicsError, WcsimError
from wcsim.log.records import Admitted, Dismissed, EpochBegun, Input, Respawned, make_ticked_record
from wcsim.server.protocol import events as ev
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.transport.shared_images import SharedImageWriter

log = logging.getLogger("wcsim.server.host.world_host")


class WorldEffectExecutor:
    """A core, its world and its journal; see the module's text."""

    def __init__(
        self,
        core: ServerCore,
        world: SeatWorld,
        post: Callable[[ev.Peer, m.Reply], None],
        write: Callable[[Input], None] = lambda record: None,
        sink: SharedImageWriter | None = None,
        loading: Callable[[], object] = lambda: None,
    ) -> None:
        """Host a world.

        Args:
            core: Its seats fit those that are taken in the world.
            world: The world; the host does not close it.
            post: Sends a message to a peer; must not block.
            write: Writes a record of the journal.
            sink: Where pictures go; without one to the world's own buffers.
            loading: Called before a world is rebuilt, which takes its time.
        """
        self.core, self.world = core, world
        self._post, self._write, self._sink, self._loading = post, write, sink, loading
        self._frames = {client.seat: client for client in world.snapshot.clients}
        self._refused: set[int] = set()
        self.step_s = 0.0  # duration of the last step
        self.ticks = 0  # steps done by this host

    def feed(self, event: ev.Event, now_s: float) -> None:
        """Handle an event, and do all that follows from it.

        Raises:
            WcsimError: The world failed, or the journal cannot be written; the host is unusable.
        """
        todo: deque[ev.Effect] = deque(self.core.handle(event, now_s))
        while todo:
            effect = todo.popleft()
            match effect:
                case ev.SendMessageEffect():
                    self._post(effect.peer, effect.message)
                case ev.SendSensorFrameEffect():
                    client = self._frames.get(effect.seat)
                    if client is not None:
                        slot = -1 if self._sink is None else self._sink.slot(effect.tick)
                        frame = m.Frame(effect.epoch, effect.tick, effect.life, client, slot)
                        self._post(effect.peer, frame)
                case ev.StepWorldEffect():
                    todo.extend(self._step(effect, now_s))
                case ev.AdmitSeatEffect():
                    todo.extend(self._admit(effect, now_s))
                case ev.DismissSeatEffect():
                    self._dismiss(effect)
                case ev.RespawnSeatsEffect():
                    now = self.world.snapshot
                    self._select_slot(now.tick)
                    for seat in effect.seats:
                        self._frames[seat] = self.world.respawn(seat, self._sink)
                        self._write(Respawned(epoch=now.epoch, tick=now.tick, seat=seat))
                case ev.RebuildWorldEffect():
                    self._loading()
                    self._select_slot(0)
                    after = self.world.rebuild(effect.seed, self._sink)
                    self._write(EpochBegun(epoch=effect.epoch, seed=effect.seed))
                    self._frames = {client.seat: client for client in after.clients}

    def _step(self, step: ev.StepWorldEffect, now_s: float) -> list[ev.Effect]:
        start_s = time.perf_counter()
        self._select_slot(step.tick + 1)
        after = self.world.tick(step.commands, self._sink)
        self._write(make_ticked_record(after.epoch, after.tick, step.commands, after.state_hash))
        self._frames = {client.seat: client for client in after.clients}
        self.step_s = time.perf_counter() - start_s
        self.ticks += 1
        return self.core.handle(ev.WorldSteppedEvent(after.tick, self.step_s), now_s + self.step_s)

    def _admit(self, admit: ev.AdmitSeatEffect, now_s: float) -> list[ev.Effect]:
        now = self.world.snapshot
        self._select_slot(now.tick)
        try:
            client = self.world.admit(admit.seat, admit.spec, self._sink)
        except Exception as error:
            # Whatever a client requests, it must not end the world of the others; unless the
            # world has changed already.
            if self.world.snapshot is not now:
                raise
            return self._refuse(admit.seat, _as_refusal(error), now_s)
        self._frames[admit.seat] = client
        self._write(
            Admitted(
                epoch=now.epoch, tick=now.tick, seat=admit.seat, spec=admit.spec, name=admit.name
            )
        )
        return []

    def _refuse(self, seat: int, error: WcsimError, now_s: float) -> list[ev.Effect]:
        """Send a client why the world does not take its chair, and remove it from the core."""
        member = self.core.roster.at(seat)
        if member is None:
            raise error
        self._refused.add(seat)
        self._post(member.peer, m.failure_from_error(error, member.session))
        return self.core.handle(ev.ClientLostEvent(member.session, str(error)), now_s)

    def _dismiss(self, dismiss: ev.DismissSeatEffect) -> None:
        # A refused client has no chair in the world.
        if dismiss.seat in self._refused:
            self._refused.remove(dismiss.seat)
            return
        now = self.world.snapshot
        self.world.dismiss(dismiss.seat)
        self._frames.pop(dismiss.seat, None)
        self._write(
            Dismissed(epoch=now.epoch, tick=now.tick, seat=dismiss.seat, reason=dismiss.reason)
        )

    def _select_slot(self, tick: int) -> None:
        if self._sink is not None:
            self._sink.select_slot(tick)


def _as_refusal(error: Exception) -> WcsimError:
    """An error as one that a client may see."""
    if isinstance(error, WcsimError):
        return error
    log.error("a client's chair could not be put into the street", exc_info=error)
    return PhysicsError(
        f"this chair does not fit into the world ({type(error).__name__}); "
        "choose another start or user"
    )
