"""A world process: `python -m wcsim.server.host.process FILE`, a `WorldProcessSpec` as JSON.

`main` reads the order, opens sockets, world and journal, and runs `_ServerLoop` in its only thread
until `_StopRequest` has a reason, or an epoch or the parent process has ended. The exit code is
one of `WorldExitCode`.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import sys
import time
from collections.abc import Collection, Container, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import msgspec

from wcsim import errors
from wcsim.core.closing import ClosingContextBase
from wcsim.core.processes import die_with_parent
from wcsim.log.records import Ended
from wcsim.server.host.opening import (
    EPOCH_OVER,
    MakeWorld,
    ServerParts,
    make_street_world,
    open_server_parts,
)
from wcsim.server.host.status import StatusPipeWriter
from wcsim.server.host.world_host import WorldEffectExecutor
from wcsim.server.launch.awake_clock import SuspendSafeClock
from wcsim.server.launch.states import WorldExitCode
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import (
    BarrierState,
    ClientLostEvent,
    Event,
    MessageReceivedEvent,
    Peer,
    StopServerEvent,
    TimePassedEvent,
)
from wcsim.server.protocol.limits import NO_ROOM, explain_resource_limit_error, write_stderr_line
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldProcessSpec, measure_rss_mb, read_spec_file
from wcsim.server.transport.shared_images import SharedImageWriter
from wcsim.server.transport.sockets import LOCAL, REMOTE, IncomingMessage, PeerLimits, ServerSockets

SETTLED_TICKS: Final = 100  # the memory that an epoch starts with is measured after so many ticks
_GROWTH_MB: Final = 1_000.0  # by which a process may grow in an epoch
_WAIT_MS: Final = 50
_CLOCK_S: Final = 0.1
# So long a client that a signal holds may owe its action. A held client of the network loses its
# connection instead: see `ServerSockets.take_lost`.
_HELD_S: Final = 5.0
_PARENT_ENDED: Final = signal.SIGUSR1
_PARENT_ENDED_REASON: Final = "the process that started it is gone"
_ORDER_FAULTS: Final = (errors.ConfigError, errors.TownError, errors.HookError, errors.JournalError)


def main(words: list[str], make: MakeWorld = make_street_world) -> int:
    """Host the world of an order file; returns a code of `WorldExitCode`.

    Benchmarks and tests pass a `make` of their own.
    """
    # 1. Read the order. Until it is read there is no pipe for errors, only standard error.
    try:
        if len(words) != 1:
            raise errors.ConfigError(f"got {len(words)} arguments; expected an order file")
        order = read_spec_file(WorldProcessSpec, Path(words[0]))
    except errors.WcsimError as error:
        return _report_exit(error)
    stop = _StopRequest()
    reporter = StatusPipeWriter(order.status_fd)
    try:
        with ExitStack() as resources:
            # 2. Open everything. The sockets come first, so that an order with a wrong address
            #    fails before its world is loaded. A stop need not wait for the loading.
            with stop.at_once():
                reporter.report_loading()
                sockets = ServerSockets(order.endpoint, order.listen, order.keys)
                resources.enter_context(sockets)
                processes = resources.enter_context(_ProcessWatch(order.status_fd))
                opened = open_server_parts(order, make)
                if opened.journal is not None:
                    resources.enter_context(opened.journal)
                resources.callback(opened.world.close)
                reporter.listening = sockets.listening
                loop = _ServerLoop(order, opened, sockets, processes, reporter)
                # What is loaded now stays. To search it again and again would cost single ticks.
                gc.freeze()
            # 3. Serve the clients.
            reason = loop.run(stop)
            # 4. End: the journal has the reason, and the next process goes on from it.
            if opened.journal is not None:
                opened.journal.append(Ended(reason=reason))
    except Exception as error:
        failure = _as_wcsim_error(error)
        if failure is None:
            raise
        reporter.report_failure(failure)
        return _report_exit(failure, order.quiet)
    if not reason.startswith(EPOCH_OVER):
        return WorldExitCode.DONE
    write_stderr_line(f"wcsim: {reason}")
    return WorldExitCode.EPOCH_OVER


class _StopRequest:
    """Why this process is to end: SIGTERM, or the end of the process that started it."""

    def __init__(self) -> None:
        self.reason = ""
        self._is_immediate = True
        self._parent = os.getppid()
        signal.signal(signal.SIGTERM, lambda *_: self._stop("requested to stop"))
        # Ctrl-C at a terminal reaches the whole process group; the parent decides what it means.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(_PARENT_ENDED, self._on_parent_ended)
        die_with_parent(_PARENT_ENDED)

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """Let a stop raise SystemExit until the block ends; afterwards it only sets `reason`."""
        try:
            yield
        finally:
            self._is_immediate = False

    def _on_parent_ended(self, *_: object) -> None:
        # The kernel also sends this when only the thread that started this process has ended.
        if os.getppid() != self._parent:
            self._stop(_PARENT_ENDED_REASON)

    def _stop(self, reason: str) -> None:
        self.reason = self.reason or reason
        if self._is_immediate:
            raise SystemExit(0)


class _ServerLoop:
    """The loop of a server: messages come in, replies of the `WorldEffectExecutor` go out.

    Replies that one event causes for a client travel as one message of several parts, so that the
    client wakes up once.
    """

    def __init__(
        self,
        order: WorldProcessSpec,
        opened: ServerParts,
        sockets: ServerSockets,
        processes: _ProcessWatch,
        reporter: StatusPipeWriter,
    ) -> None:
        """Nothing is sent or received before `run`. Raises what `SharedImageWriter` raises."""
        self._order = order
        self._core = opened.core
        self._ring = SharedImageWriter(Path(order.ring), order.rules.capacity, order.config.cameras)
        self._sockets = sockets
        self._processes = processes
        self._reporter = reporter
        self._host = WorldEffectExecutor(
            opened.core,
            opened.world,
            self._post,
            # A world without a run folder writes no journal.
            (lambda record: None) if opened.journal is None else opened.journal.append,
            self._ring,
            reporter.report_loading,
        )
        self._clock = SuspendSafeClock(time.monotonic())
        self._peers = PeerLimits()
        # The connection of each session's first join: another one may repeat its messages.
        self._first_peers: dict[bytes, Peer] = {}
        self._outbox: dict[Peer, list[bytes]] = {}
        self._last_reply: m.Reply | None = None
        self._last_bytes = b""  # the encoded `_last_reply`
        self._last_clock_s = 0.0  # of the last TimePassedEvent
        self._is_orphan = False
        self._cap = _EpochCap(order, opened.core)
        sockets.watch(processes.fileno())

    def run(self, stop: _StopRequest) -> str:
        """Serve until a stop is requested, the parent process or the epoch has ended; returns why.

        Clients are not informed of the end of an epoch: they join the process of the next one.

        Raises:
            WcsimError: The world failed or the journal cannot be written; all clients know.
        """
        try:
            reason = stop.reason
            while not reason:
                self._turn()
                orphan = _PARENT_ENDED_REASON if self._is_orphan else ""
                reason = stop.reason or orphan or self._cap.reason
            if not self._cap.reason:
                self._feed(StopServerEvent(reason))
        except errors.WcsimError as error:
            for member in self._core.roster.everyone():
                failure = m.failure_from_error(error, member.session)
                self._sockets.send(member.peer, [m.encode_message(failure)])
            raise
        return reason

    def _turn(self) -> None:
        """Handle what has come in, then clients that ended; about ten times a second the rest."""
        # 1. Wait. Time in which this process was stopped itself does not count.
        is_woken = self._sockets.wait(_WAIT_MS)
        self._clock.look(time.monotonic())
        # 2. Messages.
        for message in self._sockets.messages():
            self._receive(message)
        # 3. Clients whose process or connection has ended.
        is_due = self._clock.now_s - self._last_clock_s >= _CLOCK_S
        if is_woken or is_due:
            ended, self._is_orphan = self._processes.take_ended()
            for session in ended:
                self._feed(ClientLostEvent(session))
            for session in self._sessions_of(self._sockets.take_lost()):
                self._feed(ClientLostEvent(session, "its connection was lost", may_return=True))
        if not is_due:
            return
        self._last_clock_s = now_s = self._clock.now_s
        # 4. Clients that a signal holds while others wait. They may join again when they go on. If
        #    all are late, none waits.
        members = self._core.roster.members
        late = [p for p in members if not p.ready and now_s - p.owes_since_s > _HELD_S]
        if 0 < len(late) < len(members):
            for session in [p.session for p in late if self._processes.is_held(p.session)]:
                self._feed(ClientLostEvent(session, "a signal holds its process", may_return=True))
        # 5. Time: leases end, and clients that wait learn for whom.
        self._feed(TimePassedEvent())
        # 6. Forget sessions that have left.
        present = {p.session for p in self._core.roster.everyone()}
        self._processes.forget_all_but(present)
        self._first_peers = {
            session: peer for session, peer in self._first_peers.items() if session in present
        }
        # 7. Report, and check the size of this process.
        self._reporter.report(self._core, self._host, self._clock.now_s)
        self._cap.check_memory()

    def _receive(self, incoming: IncomingMessage) -> None:
        # 1. A peer that sends too much is refused, and in the end not answered any more.
        peer = incoming.peer
        everyone = self._core.roster.everyone
        is_admitted = self._peers.admit(
            peer, self._clock.now_s, lambda: {p.peer for p in everyone()}
        )
        if is_admitted is None:
            return
        if not is_admitted:
            error = errors.OverloadedError("too many messages per second; wait for the answers")
            self._refuse(peer, error)
            return
        # 2. Decode.
        try:
            if incoming.key == "":
                raise errors.AccessError("the key of this connection was withdrawn; get a new one")
            message = m.decode_request(incoming.data)
            if isinstance(message, m.Join):
                message = _restricted_join(message, peer.startswith(REMOTE), incoming.key)
        except errors.WcsimError as error:
            self._peers.add_fault(peer)
            self._refuse(peer, error)
            return
        # 3. Handle it. The process of a client that has joined on this machine is watched.
        self._feed(MessageReceivedEvent(peer, message))
        if not isinstance(message, m.Join):
            return
        self._first_peers.setdefault(message.session, peer)
        is_in = any(p.session == message.session for p in self._core.roster.everyone())
        if not is_in or message.pid <= 0 or not peer.startswith(LOCAL):
            return
        if not self._processes.watch(message.pid, message.session):
            self._feed(ClientLostEvent(message.session))

    def _refuse(self, peer: Peer, error: errors.WcsimError) -> None:
        """Send a peer why its message is refused; a peer that is shut out loses its sessions."""
        self._sockets.send(peer, [m.encode_message(m.failure_from_error(error))])
        if self._peers.is_shut_out(peer):
            reason = "it sent too many messages, or too many that could not be read"
            for session in self._sessions_of((peer,)):
                self._feed(ClientLostEvent(session, reason))

    def _sessions_of(self, peers: Container[Peer]) -> list[bytes]:
        """The sessions that joined first through these connections."""
        everyone = self._core.roster.everyone()
        return [p.session for p in everyone if self._first_peers.get(p.session) in peers]

    def _feed(self, event: Event) -> None:
        """Have the host handle an event, and send the replies."""
        ticks = self._host.ticks
        try:
            self._host.feed(event, self._clock.now_s)
        finally:
            stepped_s = self._host.step_s if self._host.ticks > ticks else 0.0
            self._clock.look(time.monotonic(), stepped_s)
            for peer, parts in self._outbox.items():
                self._sockets.send(peer, parts)
            self._outbox.clear()
        self._reporter.record_event(self._core, event, self._clock.now_s, stepped_s)

    def _post(self, peer: Peer, message: m.Reply) -> None:
        """Hold a reply until the frame that follows it, or the end of its event."""
        if isinstance(message, m.Frame):
            if peer.startswith(REMOTE):
                message = msgspec.structs.replace(message, slot=-1)
            # At once: while the next frame is packed, this client can already compute its action.
            self._sockets.send(peer, [*self._outbox.pop(peer, ()), m.encode_message(message)])
            return
        # The `TickDone` of a tick is one object for all clients, and is encoded once.
        if message is not self._last_reply:
            self._last_reply = message
            if isinstance(message, m.Welcome):
                message = msgspec.structs.replace(
                    message,
                    ring=str(self._ring.path(message.seat)) if peer.startswith(LOCAL) else "",
                    config_json=self._order.config.model_dump_json(),
                    town=self._order.town,
                )
            self._last_bytes = m.encode_message(message)
        self._outbox.setdefault(peer, []).append(self._last_bytes)


class _EpochCap:
    """When an epoch ends: at a full barrier after its last tick, or when its process has grown.

    At a full barrier all clients have seen the last tick, and none has seen a next one. Without
    growth the end depends on the tick alone, so two runs with equal seeds end their epochs alike.
    """

    def __init__(self, order: WorldProcessSpec, core: ServerCore) -> None:
        """Set the barrier's last tick; without `epoch_ticks` no process would go on, so none."""
        self._core = core
        core.last_tick = order.epoch_ticks or None
        self._start_mb: float | None = None
        self._growth = ""

    def check_memory(self) -> None:
        """End the epoch if this process has grown too much; to be called now and then."""
        core = self._core
        if core.last_tick is None or core.tick < SETTLED_TICKS:
            return
        now_mb = measure_rss_mb()
        if self._start_mb is None:
            self._start_mb = now_mb
        if now_mb - self._start_mb > _GROWTH_MB:
            self._growth = f"its process has grown from {self._start_mb:.0f} to {now_mb:.0f} MB"
            # The next full barrier ends it, also that of a world that is rebuilt meanwhile.
            core.last_tick = 0

    @property
    def reason(self) -> str:
        """Why the epoch is over, "" as long as it is not."""
        if self._core.stage is not BarrierState.EPOCH_OVER:
            return ""
        return f"{EPOCH_OVER}: {self._growth or f'tick {self._core.tick}'}"


class _ProcessWatch(ClosingContextBase):
    """Watches the processes of local clients, and the pipe to the parent; a context manager.

    The kernel reports the end of a process at once, whatever that process was doing.
    """

    def __init__(self, pipe: int = -1) -> None:
        """Watch the writing end of a pipe for the end of its reader; -1 for none."""
        self._epoll = select.epoll()
        self._pipe = pipe
        self._pidfds: dict[int, int] = {}  # by process
        self._sessions: dict[int, set[bytes]] = {}  # by process
        if pipe >= 0:
            self._epoll.register(pipe, 0)  # its errors are always reported

    def fileno(self) -> int:
        """A descriptor that is readable when something has ended."""
        return self._epoll.fileno()

    def watch(self, pid: int, session: bytes) -> bool:
        """Watch the process of a session; False when there is no such process any more."""
        if pid not in self._pidfds:
            try:
                pidfd = os.pidfd_open(pid)
            except (OSError, OverflowError):
                return False
            self._pidfds[pid] = pidfd
            self._sessions[pid] = set()
            self._epoll.register(pidfd, select.EPOLLIN)
        self._sessions[pid].add(session)
        return True

    def take_ended(self) -> tuple[list[bytes], bool]:
        """Sessions whose processes ended since the last call; whether the pipe's reader has."""
        pids = {pidfd: pid for pid, pidfd in self._pidfds.items()}
        ended: list[bytes] = []
        is_orphan = False
        for number, _ in self._epoll.poll(0):
            if number == self._pipe:
                is_orphan = True
                continue
            pid = pids[number]
            ended.extend(sorted(self._sessions[pid]))
            self._forget(pid)
        return ended, is_orphan

    def is_held(self, session: bytes) -> bool:
        """Whether a signal such as SIGSTOP, or Ctrl-Z, holds the watched process of a session."""
        for pid, sessions in self._sessions.items():
            if session in sessions:
                with contextlib.suppress(OSError):
                    status = Path(f"/proc/{pid}/stat")
                    text = status.read_text(encoding="ascii", errors="replace")
                    # The state follows the name, which may have brackets and spaces itself.
                    return text.rpartition(") ")[2].startswith("T")
        return False

    def forget_all_but(self, sessions: Collection[bytes]) -> None:
        """Watch no other sessions than these any more."""
        for pid, own in list(self._sessions.items()):
            own.intersection_update(sessions)
            if not own:
                self._forget(pid)

    def close(self) -> None:
        """Watch nothing any more."""
        for pid in list(self._pidfds):
            self._forget(pid)
        self._epoll.close()

    def _forget(self, pid: int) -> None:
        pidfd = self._pidfds.pop(pid)
        del self._sessions[pid]
        with contextlib.suppress(OSError):
            self._epoll.unregister(pidfd)
        os.close(pidfd)


def _restricted_join(join: m.Join, is_remote: bool, key: str | None) -> m.Join:
    """A join with what its connection allows.

    A client with a key has the key's name, or that with a dot and a word after it (`ann.2`).

    Args:
        join: As the client sent it.
        is_remote: Whether it arrived over the network.
        key: The name of the key that the client has shown; None where no key is needed.

    Raises:
        ProtocolError: It is remote and chooses what only clients on this machine may choose.
    """
    if key and join.name != key and not join.name.startswith(f"{key}."):
        join = msgspec.structs.replace(join, name=key)
    if not is_remote:
        return join
    if join.spec.start is not None:
        raise errors.ProtocolError(
            "only a client on the world's own machine may choose its start; leave it out"
        )
    return msgspec.structs.replace(join, pid=0)


def _as_wcsim_error(error: Exception) -> errors.WcsimError | None:
    """The error to report; None for one that is a fault of the program."""
    if isinstance(error, errors.WcsimError):
        return error
    message = explain_resource_limit_error(error)
    if not message:
        return None
    is_full = getattr(error, "errno", None) in NO_ROOM
    return errors.DiskFullError(message) if is_full else errors.ConfigError(message)


def _report_exit(error: errors.WcsimError, quiet: bool = False) -> int:
    """Write an error to standard error unless `quiet`; returns its exit code."""
    if not quiet:
        write_stderr_line(f"wcsim: {type(error).__name__}: {error}")
    if isinstance(error, errors.DiskFullError):
        return WorldExitCode.DISK_FULL
    return WorldExitCode.USER_ERROR if isinstance(error, _ORDER_FAULTS) else WorldExitCode.FAILED


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
