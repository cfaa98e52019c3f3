"""A seat in a world process over ZeroMQ: a process on any machine, or a child of this one.

On the same machine the pictures are in shared memory, else inside messages. A child of its own is
for one seat or a group, and is used when a world already lives in this process.

A process that forks after it has opened a link must not use it in the child, because ZeroMQ's
threads are not there. While the caller works, a thread receives for it; the two never use the same
thing at the same time.
"""

import contextlib
import logging
import math
import os
import secrets
import selectors
import threading
import time
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import Final

import msgspec
import zmq
from zmq.utils.monitor import recv_monitor_message

from wcsim.core.own_folder import LockedTempFolder, is_abandoned_folder, world_endpoint_from_folder
from wcsim.core.processes import CommandProcess
from wcsim.errors import AccessError, ConfigError, LinkClosedError, LinkTimeoutError, ProtocolError
from wcsim.server.launch.states import WorldStatusReport
from wcsim.server.ledger import open_ledger_writer
from wcsim.server.links.base import ProcessSeatLink, SeatLinkGroup, make_session_id
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import (
    ClientCore,
    ClientPhase,
    JoinSettings,
    Patience,
    ReceivedFrame,
)
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import (
    WORLD_ARGV,
    SeatRequest,
    WorldBuildSpec,
    WorldProcessSpec,
    decode_json_line,
    encode_json_line,
)
from wcsim.server.transport.keys import read_client_keys, read_server_public_key
from wcsim.server.transport.shared_images import SharedImageReader
from wcsim.server.transport.sockets import open_connection_monitor
from wcsim.types import SeatSpec

log = logging.getLogger("wcsim.server.links.socket")

QUEUE: Final = 64
_IPC: Final = "ipc://"
_POLL_MS: Final = 200
_CUT_S: Final = 12.0  # a world that is replaced as planned is mostly there again by then
_BYE_S: Final = 1.0
_OPTIONS: Final = {
    # A thread sends and answers them, however long the process computes; not where a signal holds
    # it.
    zmq.HEARTBEAT_IVL: 1000,
    zmq.HEARTBEAT_TIMEOUT: 6000,
    zmq.LINGER: 0,
    zmq.MAXMSGSIZE: m.MAX_REPLY_BYTES,
    zmq.SNDHWM: QUEUE,
    zmq.RCVHWM: QUEUE,
    zmq.RCVTIMEO: _POLL_MS,
    zmq.RECONNECT_IVL: 50,
    zmq.RECONNECT_IVL_MAX: 1000,
}
_REFUSED: Final = (
    zmq.EVENT_HANDSHAKE_FAILED_AUTH
    | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
)
_CONNECTED: Final = zmq.EVENT_HANDSHAKE_SUCCEEDED
_DISCONNECTED: Final = zmq.EVENT_DISCONNECTED
# To build a town's mesh for the first time and to warm its traffic up takes minutes.
_OPEN_TIMEOUT_S: Final = 300.0
_END_TIMEOUT_S: Final = 5.0
_NEVER_S: Final = 1e12


class SocketSeatLink(ProcessSeatLink):
    """A link to a seat of a world process, which need not run yet before `join`."""

    def __init__(self, order: SeatRequest) -> None:
        """Open a socket. Raises ConfigError when the endpoint, a key or the ledger is unusable."""
        self._is_local = order.endpoint.startswith(_IPC)
        request = JoinSettings(
            claim=order.claim.encode(),
            name=order.name,
            spec=order.spec,
            seat=order.seat,
            config=order.config,
            pid=os.getpid() if self._is_local else 0,
        )
        self._order = order
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        # Also for a link that is never closed: ZeroMQ would wait at the end of the process.
        self._release = weakref.finalize(self, self._context.destroy, 0)
        self._ring: SharedImageReader | None = None
        self._welcome: m.Welcome | None = None
        # Since when a connection is missing; infinite once the log has that.
        self._cut_s: float | None = None
        self._sent_leave = False
        try:
            self._socket = self._context.socket(zmq.DEALER)
            self._monitor = open_connection_monitor(
                self._socket, _REFUSED | _CONNECTED | _DISCONNECTED
            )
            _connect(self._socket, order)
            ledger = open_ledger_writer(Path(order.ledger), order.name) if order.ledger else None
            super().__init__(ClientCore(request, order.patience, make_session_id), ledger)
        except BaseException:
            self._release()
            raise

    @property
    def welcome(self) -> m.Welcome:
        """The server's description of its world. Raises ProtocolError before the first `join`."""
        if self._welcome is None:
            raise ProtocolError("the server has not described its world yet; call join() first")
        return self._welcome

    def while_waiting(self, work: Callable[[], object]) -> None:
        """See `SeatLink`: a thread receives from the world; it has ended when this returns."""
        start_s = time.perf_counter()
        recalled = threading.Event()
        with ThreadPoolExecutor(1, "wcsim-listener") as listener:
            answered = listener.submit(self._listen, recalled)
            try:
                work()
                worked_s = time.perf_counter()
                answered_s = answered.result()
            except BaseException:  # a failure, or an interrupt
                recalled.set()
                raise
        self._link_s += answered_s - start_s
        self._worked_s += min(worked_s, answered_s) - start_s

    def _listen(self, recalled: threading.Event) -> float:
        """Receive until the answer is there, or the listener is recalled; returns the time."""
        while self.core.waiting and self._error is None:
            if recalled.is_set() or self._waits_no_more:
                break
            self._pump()
        return time.perf_counter()

    def _post(self, message: m.Request) -> None:
        """Send, or drop the message when many others wait to go: requests are repeated anyway."""
        self._sent_leave = self._sent_leave or isinstance(message, m.Leave)
        with contextlib.suppress(zmq.Again):
            self._socket.send(m.encode_message(message), zmq.NOBLOCK)

    def _pump(self) -> None:
        try:
            # Measured: to ask the socket whether there is more takes longer than to receive.
            is_more = True
            while is_more:
                part = self._socket.recv(copy=False)
                is_more = part.more
                self.handle(m.decode_reply(part.bytes, self._ring))
        except zmq.Again:
            self._check_connection()
        self.perform(self.core.clock(self._now_s()))

    def _check_pictures(self, seen: ReceivedFrame) -> None:
        if seen.slot >= 0 and self._ring is None:
            raise ProtocolError(
                f"a frame has pictures in slot {seen.slot}, but the server named no shared memory"
            )

    def _welcomed(self, welcome: m.Welcome) -> None:
        self._welcome = welcome
        if welcome.ring and not self._is_local:
            raise ProtocolError(
                "the server named a file of this machine; over the network it must not"
            )
        self._ring = SharedImageReader(Path(welcome.ring)) if welcome.ring else None

    def _end(self) -> None:
        """Wait a moment for the server's goodbye, so that the seat is free when this returns."""
        deadline_s = time.monotonic() + _BYE_S
        is_awaited = self._sent_leave
        while is_awaited and time.monotonic() < deadline_s:
            with contextlib.suppress(zmq.Again, ProtocolError):
                for part in self._socket.recv_multipart():
                    reply = m.decode_reply(part)
                    sessions = (b"", self.core.session)
                    if isinstance(reply, m.Bye | m.Failure) and reply.session in sessions:
                        is_awaited = False
        self._release()

    def _check_connection(self) -> None:
        """Handle ZeroMQ's events: log a lost connection, and refuse to wait for a refusal.

        Raises:
            AccessError: The server has refused this client's key, or has another one.
        """
        # 1. Read the events. On the same machine there are no keys: a handshake that failed there
        #    was with a world that was dying.
        endpoint = self._order.endpoint
        while self._monitor.poll(0):
            event = recv_monitor_message(self._monitor, zmq.NOBLOCK)
            if event["event"] == _CONNECTED:
                self._cut_s = None
            elif event["event"] == _DISCONNECTED:
                self._cut_s = self._now_s() if self._cut_s is None else self._cut_s
            elif self.core.phase is ClientPhase.JOINING and not self._is_local:
                message = _refusal(endpoint, self._order.keys, event["event"], event["value"])
                raise AccessError(message)
        if self._cut_s is None:
            return
        # 2. The launcher of that world has ended, too, so nothing will start the world again.
        if self._is_local and is_abandoned_folder(Path(endpoint.removeprefix(_IPC)).parent):
            self.wait_less()
        # 3. Log it once.
        if self._welcome is not None and self._now_s() - self._cut_s > _CUT_S:
            self._cut_s = math.inf
            log.warning("wcsim: the connection to %s was lost; trying to join again", endpoint)


class ProcessSeatLinkGroup(SeatLinkGroup):
    """A world process with all its seats; to start again it is replaced by a new one."""

    def __init__(self, order: WorldBuildSpec) -> None:
        """Start the world; raises what opening it in this process would raise."""
        self._order = order
        self._connect(order.seed)

    def close(self) -> None:
        """See `SeatLinkGroup.close`."""
        self.leave()
        self._child.close()
        self.links = ()

    def _renew(self, seed: int) -> None:
        self._child.close()
        self._connect(seed)

    def _connect(self, seed: int) -> None:
        order = self._order
        self._child = _WorldChild(replace(order, seed=seed))
        self.links = [_ChildSeat(self._child, order.seat, seat) for seat in range(order.seats)]


class _WorldChild:
    """A world process that belongs to this one, ready for its clients."""

    def __init__(self, order: WorldBuildSpec) -> None:
        """Start the process and wait for its world; its first tick waits for all seats.

        Raises what opening the world in this process would raise.
        """
        place = LockedTempFolder()
        self.endpoint = world_endpoint_from_folder(place.path)
        self._selector = selectors.DefaultSelector()
        own = {item.name: getattr(order, item.name) for item in fields(order)}
        server = WorldProcessSpec(
            **{**own, "run": order.run and str(Path(order.run).absolute())},
            rules=_private_rules(order.seats, order.seats),
            endpoint=self.endpoint,
            ring=str(place.path / "ring"),
            journal=False,
            quiet=True,
        )
        path = place.path / "order.json"

        def command(status_fd: int) -> tuple[str, ...]:
            path.write_bytes(encode_json_line(replace(server, status_fd=status_fd)))
            return (*WORLD_ARGV, str(path))

        self.process = CommandProcess(command, self._selector)
        self.close = weakref.finalize(self, _end, self.process, self._selector, place)
        try:
            self._await_world()
        except BaseException:
            self.close()
            raise

    def require_alive(self) -> None:
        """Raise LinkClosedError when the process has ended."""
        code = self.process.poll()
        if code is not None:
            raise LinkClosedError(
                f"the world process ended with code {code}; its messages above say why"
            )

    def _await_world(self) -> None:
        deadline_s = time.monotonic() + _OPEN_TIMEOUT_S
        while time.monotonic() < deadline_s:
            self._selector.select(_POLL_MS / 1000.0)
            # Polled before the lines are read, so that no last line is missed.
            has_ended = self.process.poll() is not None
            if any(_is_ready(line) for line in self.process.read_lines()):
                return
            if has_ended:
                self.require_alive()
        raise LinkTimeoutError(
            f"the world process has not loaded its world after {_OPEN_TIMEOUT_S:g} s; "
            "is the machine busy?"
        )


class _ChildSeat(SocketSeatLink):
    """A seat of a world process that belongs to this one, and whose end raises an error."""

    def __init__(self, child: _WorldChild, spec: SeatSpec, seat: int) -> None:
        self._child = child
        super().__init__(
            SeatRequest(
                endpoint=child.endpoint,
                name=f"chair-{seat}",
                claim=secrets.token_hex(),
                spec=spec,
                seat=seat,
                patience=Patience(reconnect_s=_OPEN_TIMEOUT_S),
            )
        )

    def _pump(self) -> None:
        if not self._socket.poll(0):
            self._child.require_alive()
        super()._pump()

    def _end(self) -> None:
        # A process that has ended sends no goodbye.
        self._sent_leave = self._sent_leave and self._child.process.poll() is None
        super()._end()


def _private_rules(capacity: int, expected: int) -> ServerRules:
    """Rules of a world whose clients are all of one process: none can hang or die alone."""
    return ServerRules(
        capacity=capacity,
        expected=expected,
        gather_s=_NEVER_S,
        lease_s=_NEVER_S,
        notice_s=_NEVER_S,
        recordings=None,
    )


def _connect(socket: zmq.Socket[bytes], order: SeatRequest) -> None:
    for option, value in _OPTIONS.items():
        socket.setsockopt(option, value)
    socket.ipv6 = order.endpoint.startswith("tcp://[")
    if order.keys:
        keys = Path(order.keys)
        socket.curve_publickey, socket.curve_secretkey = read_client_keys(keys, order.name)
        socket.curve_serverkey = read_server_public_key(keys)
    try:
        socket.connect(order.endpoint)
    except zmq.ZMQError as error:
        raise ConfigError(
            f"endpoint {order.endpoint!r}: {error.strerror}; expected ipc://FILE or tcp://HOST:PORT"
        ) from None


def _refusal(endpoint: str, keys: str, event: int, code: int) -> str:
    """Why a server refused a connection, by ZeroMQ's event and its number, and what to do."""
    refused = f"{endpoint} refused the connection"
    if event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
        return (
            f"{refused}: the server does not know the public key in {keys}; "
            "use a key made on the server (--make-keys)"
        )
    if not keys:
        return f"{refused}: the server needs a key; get one from its operator and use --keys FOLDER"
    if code == zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH:
        return (
            f"{refused}: the server uses no keys, but --keys {keys} was given; "
            "leave --keys out, or start the server with --keys, too"
        )
    return (
        f"{refused}: the server's public key in {keys} is not that of this server; "
        "copy its current server.public"
    )


def _is_ready(line: bytes) -> bool:
    """Whether a status line reports a world; raises the error that one reports."""
    try:
        return decode_json_line(WorldStatusReport, line).stage != "loading"
    except ConfigError:
        raise m.error_from_failure(msgspec.json.decode(line, type=m.Failure)) from None


def _end(
    process: CommandProcess, selector: selectors.BaseSelector, place: LockedTempFolder
) -> None:
    process.close(_END_TIMEOUT_S)
    selector.close()
    place.close()
