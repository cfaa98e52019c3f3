"""A world in a process of its own: `python -m wcsim.server.host.process ORDER_FILE`, a `WorldSpec` as JSON.

It ends when SIGTERM asks it to, or when whoever started it has gone. It ends with a code of `WorldExit`.

The life of a server process: hear messages, feed the hub, tell what came of it, look after the living.

One thread. What is said to a client at one time travels as one message of several parts, so that it wakes once.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Collection, Container, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import msgspec

from wcsim.core.closing import Closing
from wcsim.core.processes import die_with_parent
from wcsim.errors import (
    AccessError,
    ConfigError,
    DiskFullError,
    HookError,
    JournalError,
    OverloadedError,
    ProtocolError,
    TownError,
    WcsimError,
)
from wcsim.log.records import Ended
from wcsim.server.host.opening import EPOCH_OVER, MakesWorld, Opened, open_server, street_world
from wcsim.server.host.status import Reporter
from wcsim.server.host.world_host import Keep, WorldHost
from wcsim.server.launch.awake_clock import AwakeClock
from wcsim.server.launch.states import WorldExit
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import BarrierState, Clock, Event, Lost, Peer, Received, Stop
from wcsim.server.protocol.limits import NO_ROOM, last_words, told_limit
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldSpec, read_order, rss_mb
from wcsim.server.transport.shared_images import RingSink
from wcsim.server.transport.sockets import LOCAL, REMOTE, Heard, ServerSockets

MAX_PEERS = 64
MESSAGES_PER_S, BURST = (
    10_000.0,
    10_000.0,
)  # a sole master in a world that costs nothing sends 2,500 (measured)
MOST_FAULTS = 20  # messages that could not be read, or came too fast, after which a peer is not heard any more


@dataclass(slots=True)
class _Account:
    tokens: float
    heard_s: float
    faults: int = 0


class _PeerLimits:
    """Accounts of all peers."""

    def __init__(self) -> None:
        self._accounts: dict[Peer, _Account] = {}

    def hears(
        self, peer: Peer, now_s: float, members: Callable[[], Container[Peer]]
    ) -> bool | None:
        """Whether a message of a peer may be read now; None when nothing shall even be answered.

        Args:
            peer: Whose message.
            now_s: The time.
            members: Tells the peers whose accounts are kept whatever comes.
        """
        account = self._accounts.get(peer)
        if account is None:
            account = self._opened(peer, now_s, members)
            if account is None:
                return None
        if account.faults >= MOST_FAULTS:
            return None
        account.tokens = (
            min(BURST, account.tokens + MESSAGES_PER_S * (now_s - account.heard_s)) - 1.0
        )
        account.heard_s = now_s
        if account.tokens < 0.0:
            account.tokens = 0.0
            account.faults += 1
            return False
        return True

    def fault(self, peer: Peer) -> None:
        """A message of the peer could not be read."""
        account = self._accounts.get(peer)
        if account is not None:
            account.faults += 1

    def is_shut_out(self, peer: Peer) -> bool:
        """Whether nothing of the peer is heard any more."""
        account = self._accounts.get(peer)
        return account is not None and account.faults >= MOST_FAULTS

    def _opened(
        self, peer: Peer, now_s: float, members: Callable[[], Container[Peer]]
    ) -> _Account | None:
        if len(self._accounts) >= MAX_PEERS:
            kept = members()
            strangers = [other for other in self._accounts if other not in kept]
            if not strangers:
                return None
            # Whoever was silent for longest goes, so that a crowd of strangers cannot keep a client out.
            del self._accounts[min(strangers, key=lambda other: self._accounts[other].heard_s)]
        self._accounts[peer] = _Account(tokens=BURST, heard_s=now_s)
        return self._accounts[peer]


def _at_the_door(join: m.Join, remote: bool, key: str | None) -> m.Join:
    """A join as the server takes it from this door.

    A client with a key is known by the key's name, or by that with a dot and a word after it (`ann.2`).

    Args:
        join: What the client says.
        remote: Whether it came over the network.
        key: The name of the key that it has shown; None where none is asked for.

    Raises:
        ProtocolError: It asks over the network for what only the world's own machine may choose.
    """
    if key and join.name != key and not join.name.startswith(f"{key}."):
        join = msgspec.structs.replace(join, name=key)
    if not remote:
        return join
    if join.spec.start is not None:
        raise ProtocolError(
            "only a client on the world's own machine may choose its start; leave it out"
        )
    return msgspec.structs.replace(join, pid=0)


class _Lifelines(Closing):
    """Watches the processes of local clients, and the pipe to whoever started this one; a context manager.

    The kernel says at once when one has ended, whatever it was doing.
    """

    def __init__(self, pipe: int = -1) -> None:
        """Watch the writing end of a pipe for the end of its reader; -1 for none."""
        self._epoll = select.epoll()
        self._pipe = pipe
        self._pidfds: dict[int, int] = {}  # by process
        self._sessions: dict[int, set[bytes]] = {}  # by process
        if pipe >= 0:
            self._epoll.register(pipe, 0)  # its error is always told

    def fileno(self) -> int:
        """A descriptor that can be read when there is news."""
        return self._epoll.fileno()

    def watch(self, pid: int, session: bytes) -> bool:
        """Watch the process of a session; False when it is not there any more."""
        if pid not in self._pidfds:
            try:
                number = os.pidfd_open(pid)
            except (OSError, OverflowError):
                return False
            self._pidfds[pid], self._sessions[pid] = number, set()
            self._epoll.register(number, select.EPOLLIN)
        self._sessions[pid].add(session)
        return True

    def news(self) -> tuple[list[bytes], bool]:
        """Sessions whose processes have ended since the last call, and whether the reader of the pipe is gone."""
        lost: list[bytes] = []
        alone = False
        for number, _ in self._epoll.poll(0):
            if number == self._pipe:
                alone = True
                continue
            pid = next(pid for pid, mine in self._pidfds.items() if mine == number)
            lost.extend(sorted(self._sessions[pid]))
            self._forget(pid)
        return lost, alone

    def held(self, session: bytes) -> bool:
        """Whether a signal, as of Ctrl-Z or SIGSTOP, holds the process of a session that is watched."""
        for pid in [pid for pid, mine in self._sessions.items() if session in mine]:
            with contextlib.suppress(OSError):
                after_name = (
                    Path(f"/proc/{pid}/stat")
                    .read_text(encoding="ascii", errors="replace")
                    .rpartition(") ")[2]
                )
                return after_name.startswith("T")
        return False

    def keep(self, sessions: Collection[bytes]) -> None:
        """Forget all sessions but these."""
        for pid, mine in list(self._sessions.items()):
            mine.intersection_update(sessions)
            if not mine:
                self._forget(pid)

    def close(self) -> None:
        """Watch nothing any more."""
        for pid in list(self._pidfds):
            self._forget(pid)
        self._epoll.close()

    def _forget(self, pid: int) -> None:
        number = self._pidfds.pop(pid)
        del self._sessions[pid]
        with contextlib.suppress(OSError):
            self._epoll.unregister(number)
        os.close(number)


_GROWTH_MB = 1_000.0  # what a world's process may grow by in an epoch
SETTLED_TICKS = 100  # after which a world's memory is what it begins an epoch with


class _EpochCap:
    """The end of an epoch: at a full barrier, when everybody has seen the last tick and nobody the next one.

    So it depends on the tick alone, unless memory has grown, and two runs with equal seeds end their epochs alike.
    """

    def __init__(self, order: WorldSpec, core: ServerCore) -> None:
        """Have the barrier end its epoch as the order says; never, where nobody would go on."""
        self._core = core
        core.last_tick = order.epoch_ticks or None
        self._begun_mb: float | None = None
        self._why = ""

    def weigh(self) -> None:
        """Look at how much memory this process has, and end the epoch if it is too much; to be called now and then."""
        core = self._core
        if core.last_tick is None or core.tick < SETTLED_TICKS:
            return
        now_mb = rss_mb()
        self._begun_mb = now_mb if self._begun_mb is None else self._begun_mb
        if now_mb - self._begun_mb > _GROWTH_MB:
            self._why = (
                f"{EPOCH_OVER}: its process has grown from {self._begun_mb:.0f} to {now_mb:.0f} MB"
            )
            core.last_tick = (
                0  # the next full barrier, also of a world that is begun anew meanwhile
            )

    @property
    def reached(self) -> str:
        """Why the epoch is over, "" as long as it is not."""
        if self._core.stage is not BarrierState.EPOCH_OVER:
            return ""
        return self._why or f"{EPOCH_OVER}: tick {self._core.tick}"


_WAIT_MS = 50
_CLOCK_S = 0.1
_HELD_S = 5.0  # a client that a signal holds for so long is no longer waited for; over the network ZeroMQ tells


class _ServerLoop:
    """A hub behind its doors; see the module's text."""

    def __init__(
        self,
        order: WorldSpec,
        opened: Opened,
        doors: ServerSockets,
        lifelines: _Lifelines,
        reporter: Reporter,
    ) -> None:
        """Nothing is said or heard before `run`. Raises what `RingSink` raises."""
        self._order, self._core = order, opened.core
        self._ring = RingSink(Path(order.ring), order.rules.capacity, order.config.cameras)
        self._doors, self._lifelines, self._reporter = doors, lifelines, reporter
        # A world without a run folder keeps no journal.
        keep: Keep = (lambda record: None) if opened.journal is None else opened.journal.append
        self._hub = WorldHost(
            opened.core, opened.world, self._post, keep, self._ring, reporter.loading
        )
        self._clock = AwakeClock(time.monotonic())
        self._peers = _PeerLimits()
        self._homes: dict[
            bytes, Peer
        ] = {}  # where each session joined first: whoever repeats its words is another
        self._out: dict[Peer, list[bytes]] = {}
        self._encoded: tuple[m.Reply | None, bytes] = (None, b"")  # the last one said
        self._clock_s = 0.0  # of the last Clock event
        self._alone = False
        self._cap = _EpochCap(order, opened.core)
        doors.watch(lifelines.fileno())

    def run(self, asked_to_end: Callable[[], str]) -> str:
        """Serve until somebody asks for the end, or whoever started this process is gone; returns why.

        Also until the epoch is over, in a process that is to be replaced then: its clients hear nothing of that, and
        join the next one.

        Raises:
            WcsimError: The world failed or the journal cannot be written; everybody has been told.
        """
        try:
            reason = asked_to_end()
            while not reason:
                self._turn()
                reason = asked_to_end() or (
                    "the process that started it is gone" if self._alone else self._cap.reached
                )
            if not self._cap.reached:
                self._feed(Stop(reason))
        except WcsimError as error:
            self._tell_all(error)
            raise
        return reason

    # --- a turn ---

    def _turn(self) -> None:
        woken = self._doors.wait(_WAIT_MS)
        self._clock.look(time.monotonic())
        for heard in self._doors.messages():
            self._hear(heard)
        due = self._clock.now_s - self._clock_s >= _CLOCK_S
        if woken or due:
            lost, self._alone = self._lifelines.news()
            for session in lost:
                self._feed(Lost(session))
            for session in self._sessions_of(self._doors.lost()):
                self._feed(Lost(session, "its connection was lost", may_return=True))
        if due:
            self._clock_s = self._clock.now_s
            self._let_go_of_held()
            self._feed(Clock())
            here = {p.session for p in self._core.roll.everyone()}
            self._lifelines.keep(here)
            self._homes = {
                session: home for session, home in self._homes.items() if session in here
            }
            self._reporter.report(self._core, self._hub, self._clock.now_s)
            self._cap.weigh()

    def _let_go_of_held(self) -> None:
        """Nobody waits for a client of this machine that a signal holds; once it goes on, it may join again."""
        members = self._core.roll.members
        late = [p for p in members if not p.ready and self._clock.now_s - p.asked_s > _HELD_S]
        if 0 < len(late) < len(members):
            for session in [p.session for p in late if self._lifelines.held(p.session)]:
                self._feed(Lost(session, "a signal holds its process", may_return=True))

    def _hear(self, heard: Heard) -> None:
        peer = heard.peer
        may_speak = self._peers.hears(peer, self._clock.now_s, self._present_peers)
        if not may_speak:
            if may_speak is not None:
                self._refuse(
                    peer, OverloadedError("too many messages per second; wait for the answers")
                )
            return
        try:
            if heard.key == "":
                raise AccessError("the key of this connection was withdrawn; get a new one")
            message = m.decode_request(heard.data)
            if isinstance(message, m.Join):
                message = _at_the_door(message, peer.startswith(REMOTE), heard.key)
        except WcsimError as error:
            self._peers.fault(peer)
            self._refuse(peer, error)
            return
        self._feed(Received(peer, message))
        if isinstance(message, m.Join):
            self._homes.setdefault(message.session, peer)
            if message.pid > 0 and peer.startswith(LOCAL):
                self._watch(message)

    def _sessions_of(self, peers: Container[Peer]) -> list[bytes]:
        """The sessions that began in these connections, which are of no use any more: nobody shall wait for them."""
        return [
            p.session for p in self._core.roll.everyone() if self._homes.get(p.session) in peers
        ]

    def _refuse(self, peer: Peer, error: WcsimError) -> None:
        """Say why a message was not heard. Of whom nothing is heard any more, that one cannot act."""
        self._doors.send(peer, [m.encode(m.failure_of(error))])
        if self._peers.is_shut_out(peer):
            for session in self._sessions_of((peer,)):
                self._feed(
                    Lost(session, "it sent too many messages, or too many that could not be read")
                )

    def _feed(self, event: Event) -> None:
        ticks = self._hub.ticks
        try:
            self._hub.feed(event, self._clock.now_s)
        finally:
            stepped_s = self._hub.step_s if self._hub.ticks > ticks else 0.0
            self._clock.look(time.monotonic(), stepped_s)
            self._flush()
        self._reporter.saw(self._core, event, self._clock.now_s, stepped_s)

    def _watch(self, join: m.Join) -> None:
        roll = self._core.roll
        known = roll.member(join.session) is not None or roll.waiting(join.session) is not None
        if known and not self._lifelines.watch(join.pid, join.session):
            self._feed(Lost(join.session))

    def _present_peers(self) -> set[Peer]:
        return {p.peer for p in self._core.roll.everyone()}

    # --- what is said ---

    def _post(self, peer: Peer, message: m.Reply) -> None:
        """Keep a message until a frame is said, or all that follows from an event is known."""
        if isinstance(message, m.Frame):
            if peer.startswith(REMOTE):
                message = msgspec.structs.replace(message, slot=-1)
            # Off at once: while the next frame is packed, this client can begin to think.
            self._doors.send(peer, [*self._out.pop(peer, ()), m.encode(message)])
            return
        if message is not self._encoded[0]:  # the word of a tick is the same for all
            told = self._welcome(peer, message) if isinstance(message, m.Welcome) else message
            self._encoded = message, m.encode(told)
        self._out.setdefault(peer, []).append(self._encoded[1])

    def _welcome(self, peer: Peer, welcome: m.Welcome) -> m.Welcome:
        ring = str(self._ring.path(welcome.seat)) if peer.startswith(LOCAL) else ""
        order = self._order
        return msgspec.structs.replace(
            welcome, ring=ring, config_json=order.config.model_dump_json(), town=order.town
        )

    def _flush(self) -> None:
        for peer, parts in self._out.items():
            self._doors.send(peer, parts)
        self._out.clear()

    def _tell_all(self, error: WcsimError) -> None:
        for p in self._core.roll.everyone():
            self._doors.send(p.peer, [m.encode(m.failure_of(error, p.session))])


_ORDER_FAULTS = (ConfigError, TownError, HookError, JournalError)
_PARENT_GONE = signal.SIGUSR1


def main(words: list[str], make: MakesWorld = street_world) -> int:
    """Host the world of an order file; returns the exit code. Benches and tests give a `make` of their own."""
    if len(words) != 1:
        return _failed(ConfigError(f"got {len(words)} arguments; expected an order file"))
    try:
        order = read_order(WorldSpec, Path(words[0]))
    except WcsimError as error:
        return _failed(error)
    ends, reporter = _Ends(), Reporter(order.status_fd)
    try:
        with ExitStack() as held:
            with ends.at_once():
                reporter.loading()
                opened, loop = _prepared(order, make, reporter, held)
                gc.freeze()  # what is loaded now stays: looking through it again and again would cost single ticks
            reason = loop.run(ends.asked)
            if opened.journal is not None:
                opened.journal.append(Ended(reason=reason))
    except WcsimError as error:
        reporter.failed(error)
        return _failed(error, order.quiet)
    except Exception as error:
        told = told_limit(error)
        if not told:
            raise
        limit = (
            DiskFullError(told) if getattr(error, "errno", None) in NO_ROOM else ConfigError(told)
        )
        reporter.failed(limit)
        return _failed(limit, order.quiet)
    if not reason.startswith(EPOCH_OVER):
        return WorldExit.DONE
    last_words(f"wcsim: {reason}")
    return WorldExit.EPOCH_OVER


def _prepared(
    order: WorldSpec, make: MakesWorld, reporter: Reporter, held: ExitStack
) -> tuple[Opened, _ServerLoop]:
    """Open the doors first, so that an order that cannot be used fails before the world is loaded."""
    doors = held.enter_context(ServerSockets(order.endpoint, order.listen, order.keys))
    lifelines = held.enter_context(_Lifelines(order.status_fd))
    opened = open_server(order, make)
    if opened.journal is not None:
        held.enter_context(opened.journal)
    held.callback(opened.world.close)
    reporter.listening = doors.listening
    return opened, _ServerLoop(order, opened, doors, lifelines, reporter)


class _Ends:
    """Who asks for the end. Before there is a world it comes at once, later between two ticks."""

    def __init__(self) -> None:
        self._reason, self._now = "", True
        self._parent = os.getppid()
        signal.signal(signal.SIGTERM, self._told)
        # Ctrl-C at a terminal reaches the whole group; what it means is for whoever started this process to say.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(_PARENT_GONE, self._orphaned)
        die_with_parent(_PARENT_GONE)

    def asked(self) -> str:
        """Why the server shall end, "" as long as it shall not."""
        return self._reason

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """While this lasts the end is a SystemExit."""
        self._now = True
        try:
            yield
        finally:
            self._now = False

    def _told(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self._end("requested to stop")

    def _orphaned(self, number: int, frame: FrameType | None) -> None:
        """The kernel sends this also when only the thread that started this process has ended."""
        del number, frame
        if os.getppid() != self._parent:
            self._end("the process that started it is gone")

    def _end(self, reason: str) -> None:
        self._reason = self._reason or reason
        if self._now:
            raise SystemExit(0)


def _failed(error: WcsimError, quiet: bool = False) -> int:
    if not quiet:
        last_words(f"wcsim: {type(error).__name__}: {error}")
    if isinstance(error, DiskFullError):
        return WorldExit.DISK_FULL
    return WorldExit.USER_ERROR if isinstance(error, _ORDER_FAULTS) else WorldExit.FAILED


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
