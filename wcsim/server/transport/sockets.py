"""The sockets of a server: one for clients on the same machine, one for others, if it listens.

No peer can make the server wait. Messages to a peer that does not read are dropped, because clients
repeat their requests; a peer that sends more than its share is not read.
"""

import logging
import os
import select
import socket as tcp
import sys
import time
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import zmq
from zmq.auth.thread import ThreadAuthenticator
from zmq.utils.monitor import recv_monitor_message

from wcsim.core.closing import ClosingContextBase
from wcsim.errors import ConfigError
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import Peer
from wcsim.server.transport.keys import ClientKeyLookup, is_loopback, read_server_keys
from wcsim.types.bounds import MOST_SEATS

log = logging.getLogger("wcsim.server.transport.sockets")

# The first byte of a peer's name: the socket that it uses.
LOCAL: Final = b"L"
REMOTE: Final = b"R"
# Unread messages of a peer: 1 MiB at most. For one message that does not end see SECURITY.md.
QUEUE: Final = 128
BATCH: Final = 256  # messages that are received at a time
# Peers with an account: as many as seats at least, or a client of a full world gets no answer.
MAX_PEERS: Final = MOST_SEATS
# A sole master in a world that costs nothing sends 2,500 (measured).
MESSAGES_PER_S: Final = 10_000.0
BURST: Final = 10_000.0
MOST_FAULTS: Final = 20  # messages that are unreadable or too fast, after which a peer is shut out
# Messages to a peer that does not read. Over the network pictures are inside.
_SEND_QUEUE: Final = {LOCAL: 128, REMOTE: 16}
_LINGER_MS: Final = 500
_HANDSHAKE_MS: Final = 5_000  # a connection that has not shown its key by then is closed
_IPC_PATH_BYTES: Final = 107
_CUT_S: Final = 5  # a machine that vanished, or cannot be reached any more, sends nothing
_SILENT_MS: Final = 6_000  # a process that a signal holds sends no heartbeats
_LOOK_S: Final = 1.0
_LAST_DATA_RECEIVED: Final = slice(52, 56)  # in Linux's struct tcp_info, in milliseconds
# Measured: as members of an enum, these take longer to combine than a message takes to send.
_NOW: Final = int(zmq.NOBLOCK)
_MORE: Final = int(zmq.NOBLOCK | zmq.SNDMORE)
_IN: Final = int(zmq.POLLIN)
_EVENTS: Final = int(zmq.EVENTS)


class IncomingMessage(NamedTuple):
    """A message; `key` is the name of the key that its peer has shown.

    It is "" for a key that was withdrawn, None where no key is needed.
    """

    peer: Peer
    data: bytes
    key: str | None


class ServerSockets(ClosingContextBase):
    """Where messages come in and go out; a context manager."""

    def __init__(self, endpoint: str, listen: str = "", keys: str = "") -> None:
        """Open the sockets.

        Args:
            endpoint: ipc://FILE for clients on this machine. Its folder is made so that only its
                owner can enter it.
            listen: tcp://HOST:PORT for others, "" for none.
            keys: Folder of keys, see `server/transport/keys.py`; "" for none.

        Raises:
            ConfigError: An address cannot be used, or others could reach it without keys.
        """
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._wakes = select.epoll()
        self._watched: set[int] = set()
        # The sides (LOCAL, REMOTE) whose sockets were empty when they were last used.
        self._empty: set[bytes] = set()
        self._guard: ThreadAuthenticator | None = None
        # Events of connections of other machines.
        self._monitor: zmq.Socket[bytes] | None = None
        self._open_fds: set[int] = set()  # descriptors of connections
        self._looked_s = time.monotonic()
        self._peers: dict[int, Peer] = {}  # the peers that have used these descriptors
        # Connections that are over, as long as messages of theirs may still be in the queue.
        self._ended: set[Peer] = set()
        self._lost: set[Peer] = set()  # of these, those that `take_lost` has not returned yet
        self._keys: ClientKeyLookup | None = None
        self._sockets: dict[bytes, zmq.Socket[bytes]] = {}
        try:
            self._open(LOCAL, _ipc_address(endpoint), None)
            if listen:
                # An address that is reachable from other machines needs keys.
                is_private = is_loopback(listen)
                if keys:
                    self._keys = ClientKeyLookup(Path(keys))
                    self._guard = self._keys.guard(self._context)
                elif not is_private:
                    raise ConfigError(
                        f"{listen} can be reached from other machines; "
                        "expected a folder of keys for it (--keys), "
                        "or an address of this machine alone, such as tcp://127.0.0.1:5555"
                    )
                self._open(REMOTE, listen, Path(keys) if keys else None)
        except BaseException:
            self.close()
            raise

    @property
    def listening(self) -> str:
        """The address for others, with the port that was found for it; "" without one."""
        socket = self._sockets.get(REMOTE)
        return "" if socket is None else socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def watch(self, fileno: int) -> None:
        """Wake `wait` also when there is something to read from this descriptor."""
        self._wakes.register(fileno, select.EPOLLIN)
        self._watched.add(fileno)

    def wait(self, most_ms: int) -> bool:
        """Wait until something can be read; returns whether a watched descriptor ended the wait.

        False also where there are messages.
        """
        # A ZeroMQ descriptor wakes once for events of any kind. EVENTS says whether there is a
        # message (measured: in a fifth of the time of zmq.Poller, but longer than to receive one).
        for side, socket in self._sockets.items():
            if side not in self._empty and _is_readable(socket):
                return False
        self._empty.clear()
        return any(number in self._watched for number, _ in self._wakes.poll(1e-3 * most_ms))

    def messages(self) -> Iterator[IncomingMessage]:
        """Receive what is there, at most a batch from each socket.

        A message of several parts comes as an empty one.
        """
        for side, socket in self._sockets.items():
            for _ in range(BATCH):
                if not _is_readable(socket):
                    self._empty.add(side)
                    if side == REMOTE:
                        self._ended &= self._lost
                    break
                peer = side + socket.recv(_NOW)
                last = socket.recv(_NOW, copy=False)
                if last.more:
                    socket.recv_multipart(_NOW)
                if side == REMOTE and not self._note_use(peer, int(last.get(zmq.SRCFD))):
                    continue
                key = None
                if self._keys is not None and side == REMOTE:
                    key = self._keys.name(str(last.get("User-Id")))
                yield IncomingMessage(peer, b"" if last.more else last.bytes, key)

    def take_lost(self) -> set[Peer]:
        """Take the peers on other machines whose connections ended since the last call.

        That of a process which a signal holds is ended here: the kernel answers for it, but it
        sends no heartbeats. The server sends none: ZeroMQ 4.3.5 aborts where one is due to a peer
        that has closed its connection while its messages wait.
        """
        now_s = time.monotonic()
        if now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            for number in self._open_fds:
                # It may be closed already, or be that of something else.
                with suppress(OSError), tcp.fromfd(number, tcp.AF_INET, tcp.SOCK_STREAM) as end:
                    info = end.getsockopt(tcp.IPPROTO_TCP, tcp.TCP_INFO, _LAST_DATA_RECEIVED.stop)
                    if int.from_bytes(info[_LAST_DATA_RECEIVED], sys.byteorder) > _SILENT_MS:
                        end.shutdown(tcp.SHUT_RDWR)
        self._note_ends()
        lost, self._lost = self._lost, set()
        return lost

    def send(self, peer: Peer, parts: Sequence[bytes]) -> None:
        """Send messages together, or drop them when the peer is gone or does not read."""
        side = peer[:1]
        socket = self._sockets[side]
        self._empty.discard(side)
        *most, last = peer[1:], *parts
        try:
            for part in most:
                socket.send(part, _MORE)
            socket.send(last, _NOW)
        except zmq.Again:
            log.debug("dropped a message to a client that does not read")

    def close(self) -> None:
        """Close all; the last messages have a moment to go out. A second call does nothing."""
        if self._guard is not None:
            self._guard.stop()
            self._guard = None
        if self._monitor is not None:
            self._sockets[REMOTE].disable_monitor()
            self._monitor.close(0)
            self._monitor = None
        for socket in self._sockets.values():
            socket.close(_LINGER_MS)
        self._sockets.clear()
        self._context.term()
        self._wakes.close()

    def _note_use(self, peer: Peer, number: int) -> bool:
        """Note that a peer uses this descriptor; returns whether its message still counts.

        The message of a peer that `take_lost` has returned does not.
        """
        if peer not in self._ended and self._peers.get(number) != peer:
            self._note_ends()
            # The kernel gives a descriptor to another peer only after its connection has ended.
            before = self._peers.pop(number, None)
            if before is not None:
                self._note_end(before)
            if number in self._open_fds:
                self._peers[number] = peer
            else:  # the event of its end was faster than its message
                self._note_end(peer)
        return peer not in self._ended or peer in self._lost

    def _note_ends(self) -> None:
        while self._monitor is not None and _is_readable(self._monitor):
            event = recv_monitor_message(self._monitor, _NOW)
            number = int(event["value"])
            if event["event"] == zmq.EVENT_ACCEPTED:
                self._open_fds.add(number)
                continue
            self._open_fds.discard(number)
            peer = self._peers.pop(number, None)
            if peer is not None:
                self._note_end(peer)

    def _note_end(self, peer: Peer) -> None:
        self._ended.add(peer)
        self._lost.add(peer)

    def _open(self, side: bytes, address: str, keys: Path | None) -> None:
        socket = self._context.socket(zmq.ROUTER)
        self._sockets[side] = socket
        socket.linger = _LINGER_MS
        socket.maxmsgsize = m.MAX_REQUEST_BYTES
        socket.sndhwm = _SEND_QUEUE[side]
        socket.rcvhwm = QUEUE
        socket.ipv6 = address.startswith("tcp://[")
        if side == REMOTE:
            socket.handshake_ivl = _HANDSHAKE_MS
            self._monitor = open_connection_monitor(
                socket, zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED
            )
            self.watch(self._monitor.fileno())
        if keys is not None:
            socket.curve_server = True
            socket.curve_publickey, socket.curve_secretkey = read_server_keys(keys)
        try:
            socket.bind(address)
        except zmq.ZMQError as error:
            raise ConfigError(
                f"{address}: cannot be opened ({error.strerror}); choose another address"
            ) from None
        self._wakes.register(socket.fileno(), select.EPOLLIN)
        if side == LOCAL:
            Path(address.removeprefix("ipc://")).chmod(0o600)


class PeerLimits:
    """How much each peer may send: a token bucket, and a count of faults that shuts it out.

    An account outlives its connection. A peer that lost its account to another one begins anew,
    without faults.
    """

    def __init__(self) -> None:
        self._accounts: dict[Peer, _Account] = {}

    def admit(
        self, peer: Peer, now_s: float, members: Callable[[], Container[Peer]]
    ) -> bool | None:
        """Charge a peer for a message; returns whether to read it, None to not even answer it.

        Args:
            peer: The sender.
            now_s: The time.
            members: Returns the peers whose accounts stay whatever others send.
        """
        # 1. Find or open the account. Of strangers the one that was silent for longest makes room,
        #    so that a crowd of them cannot keep a client out.
        account = self._accounts.get(peer)
        if account is None:
            if len(self._accounts) >= MAX_PEERS:
                present = members()
                strangers = [other for other in self._accounts if other not in present]
                if not strangers:
                    return None
                del self._accounts[min(strangers, key=lambda other: self._accounts[other].last_s)]
            account = self._accounts[peer] = _Account(tokens=BURST, last_s=now_s)
        # 2. Charge it.
        if account.faults >= MOST_FAULTS:
            return None
        earned = MESSAGES_PER_S * (now_s - account.last_s)
        account.tokens = min(BURST, account.tokens + earned) - 1.0
        account.last_s = now_s
        if account.tokens >= 0.0:
            return True
        account.tokens = 0.0
        account.faults += 1
        return False

    def add_fault(self, peer: Peer) -> None:
        """A message of the peer was unreadable."""
        account = self._accounts.get(peer)
        if account is not None:
            account.faults += 1

    def is_shut_out(self, peer: Peer) -> bool:
        """Whether no message of the peer is read any more."""
        account = self._accounts.get(peer)
        return account is not None and account.faults >= MOST_FAULTS


@dataclass(slots=True)
class _Account:
    tokens: float
    last_s: float  # of the last message
    faults: int = 0


def open_connection_monitor(socket: zmq.Socket[bytes], events: int) -> zmq.Socket[bytes]:
    """A socket for `recv_monitor_message`, with the events of another one's connections.

    To be called before that has any connection. From now on the kernel ends those to machines that
    do not answer.
    """
    socket.tcp_keepalive = 1
    socket.tcp_keepalive_idle = 2
    socket.tcp_keepalive_intvl = 1
    socket.tcp_keepalive_cnt = _CUT_S - 2
    socket.tcp_maxrt = 1000 * _CUT_S
    monitor: zmq.Socket[bytes] = socket.context.socket(zmq.PAIR)
    # No bound: ZeroMQ's thread waits for room for its events, and every connection with it. Its
    # own bound is 2,000.
    monitor.rcvhwm = 0
    address = f"inproc://news-{socket.underlying}"
    socket.monitor(address, events)
    monitor.connect(address)
    return monitor


def _is_readable(socket: zmq.Socket[bytes]) -> bool:
    return bool(int(socket.getsockopt(_EVENTS)) & _IN)


def _ipc_address(endpoint: str) -> str:
    """The address of an endpoint, after its folder was made. Raises ConfigError."""
    path = Path(endpoint.removeprefix("ipc://"))
    is_short = len(os.fsencode(path)) <= _IPC_PATH_BYTES
    if not endpoint.startswith("ipc://") or not path.is_absolute() or not is_short:
        raise ConfigError(
            f"endpoint {endpoint!r}: expected ipc:// and an absolute path of {_IPC_PATH_BYTES} "
            "bytes at most"
        )
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = path.parent.stat()
    except OSError as error:
        raise ConfigError(
            f"{path.parent}: cannot be created ({error.strerror}); choose another folder"
        ) from None
    if status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise ConfigError(
            f"{path.parent}: other users can enter this folder; choose one with mode 700"
        )
    return endpoint
