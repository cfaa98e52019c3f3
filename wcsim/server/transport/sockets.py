"""The sockets of a server: one for clients on the same machine, one for others when it listens for them.

Nobody on the other side can make the server wait: messages to a peer that does not read are dropped (clients ask
again), and a peer that sends more than its share is not read.
"""

from __future__ import annotations

import logging
import os
import select
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import zmq
from zmq.auth.thread import ThreadAuthenticator
from zmq.utils.monitor import recv_monitor_message

from wcsim.core.closing import Closing
from wcsim.errors import ConfigError
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import Peer
from wcsim.server.transport.keys import KnownKeys, is_loopback, server_keys

log = logging.getLogger("wcsim.server.transport.sockets")

LOCAL, REMOTE = b"L", b"R"  # first byte of a peer's name: which door it came through
QUEUE = 128  # whole messages of a peer that are not read yet: 1 MiB at most; of one that does not end, see SECURITY.md
_SEND_QUEUE = {
    LOCAL: 128,
    REMOTE: 16,
}  # to a peer that does not read; over the network pictures are inside
_LINGER_MS = 500
BATCH = 256  # messages that are taken in at a time
_HANDSHAKE_MS = 5_000  # a connection that has not shown its key by then is closed
_IPC_PATH_BYTES = 107
_CUT_S = 5  # a machine that vanished, or cannot be reached any more, says nothing
_HEARTBEAT_S = 6  # a process that a signal holds does not answer
# Measured: as members of an enum, these take longer to combine than a message takes to send.
_NOW, _MORE, _IN, _EVENTS = (
    int(zmq.NOBLOCK),
    int(zmq.NOBLOCK | zmq.SNDMORE),
    int(zmq.POLLIN),
    int(zmq.EVENTS),
)


class Heard(NamedTuple):
    """A message; `key` names the one that its peer has shown: "" for one that was taken back, None without keys."""

    peer: Peer
    data: bytes
    key: str | None


class ServerSockets(Closing):
    """Where messages come in and go out; a context manager."""

    def __init__(self, endpoint: str, listen: str = "", keys: str = "") -> None:
        """Open the doors.

        Args:
            endpoint: ipc://FILE for clients on this machine; its folder is made so that only its owner can enter it.
            listen: tcp://HOST:PORT for others, "" for none.
            keys: Folder of keys, see `server/transport/keys.py`; "" for none.

        Raises:
            ConfigError: An address cannot be used, or others could reach it without keys.
        """
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._wakes = select.epoll()
        self._watched: set[int] = set()
        self._empty: set[bytes] = set()  # doors that had no news when they were last touched
        self._guard: ThreadAuthenticator | None = None
        self._monitor: zmq.Socket[bytes] | None = (
            None  # tells of connections of other machines that have ended
        )
        self._numbers: set[int] = set()  # descriptors of connections
        self._connected: dict[int, Peer] = {}  # who speaks through them
        self._ended: set[Peer] = (
            set()
        )  # connections that are over, as long as words of theirs may be on the way
        self._lost: set[Peer] = set()  # of these, those that were not told yet
        self._keys: KnownKeys | None = None
        self._sockets: dict[bytes, zmq.Socket[bytes]] = {}
        try:
            self._open(LOCAL, _ipc(endpoint), None)
            if listen:
                self._listen(listen, keys)
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
        """Until something has come, not longer than that; returns whether it came from a watched descriptor."""
        # A ZeroMQ descriptor wakes once for news of any kind; whether there is a message, EVENTS says (measured: this
        # takes a fifth of the time of zmq.Poller). To ask for it takes longer than to receive a message.
        for door, socket in self._sockets.items():
            if door not in self._empty and _has_news(socket):
                return False
        self._empty.clear()
        return any(number in self._watched for number, _ in self._wakes.poll(1e-3 * most_ms))

    def messages(self) -> Iterator[Heard]:
        """What has come, not more than a batch of each door; what has not one part is empty."""
        for door, socket in self._sockets.items():
            for _ in range(BATCH):
                if not _has_news(socket):
                    self._empty.add(door)
                    if door == REMOTE:
                        self._ended &= self._lost
                    break
                peer, last = socket.recv(_NOW), socket.recv(_NOW, copy=False)
                if last.more:
                    socket.recv_multipart(_NOW)
                if door == REMOTE and not self._is_heard(door + peer, int(last.get(zmq.SRCFD))):
                    continue
                key = (
                    None
                    if self._keys is None or door == LOCAL
                    else self._keys.name(str(last.get("User-Id")))
                )
                yield Heard(door + peer, b"" if last.more else last.bytes, key)

    def lost(self) -> set[Peer]:
        """Peers on other machines whose connections have ended since the last call."""
        self._note_ends()
        lost, self._lost = self._lost, set()
        return lost

    def send(self, peer: Peer, parts: Sequence[bytes]) -> None:
        """Send messages together, or drop them when the peer is gone or does not read."""
        door = peer[:1]
        socket = self._sockets[door]
        self._empty.discard(door)
        *most, last = peer[1:], *parts
        try:
            for part in most:
                socket.send(part, _MORE)
            socket.send(last, _NOW)
        except zmq.Again:
            log.debug("dropped a message to a client that does not read")

    def close(self) -> None:
        """Close all; what was said last has a moment to get out. A second call does nothing."""
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

    def _is_heard(self, peer: Peer, number: int) -> bool:
        """Whether a peer that speaks through this descriptor has not been told as lost."""
        if peer not in self._ended and self._connected.get(number) != peer:
            self._note_ends()
            before = self._connected.pop(number, None)
            if before is not None:  # a descriptor is another's only when its connection is over
                self._end(before)
            if number in self._numbers:
                self._connected[number] = peer
            else:  # it has spoken and gone, and its end was told before its words
                self._end(peer)
        return peer not in self._ended or peer in self._lost

    def _end(self, peer: Peer) -> None:
        self._ended.add(peer)
        self._lost.add(peer)

    def _note_ends(self) -> None:
        while self._monitor is not None and _has_news(self._monitor):
            event = recv_monitor_message(self._monitor, _NOW)
            number = int(event["value"])
            if event["event"] == zmq.EVENT_ACCEPTED:
                self._numbers.add(number)
                continue
            self._numbers.discard(number)
            peer = self._connected.pop(number, None)
            if peer is not None:
                self._end(peer)

    def _listen(self, address: str, keys: str) -> None:
        if not keys:
            if not is_loopback(address):
                raise ConfigError(
                    f"{address} can be reached from other machines; expected a folder of keys for it (--keys), "
                    "or an address of this machine alone, such as tcp://127.0.0.1:5555"
                )
            self._open(REMOTE, address, None)
            return
        is_loopback(address)
        self._keys = KnownKeys(Path(keys))
        self._guard = self._keys.guard(self._context)
        self._open(REMOTE, address, Path(keys))

    def _open(self, door: bytes, address: str, keys: Path | None) -> None:
        socket = self._context.socket(zmq.ROUTER)
        self._sockets[door] = socket
        socket.setsockopt(zmq.LINGER, _LINGER_MS)
        socket.setsockopt(zmq.MAXMSGSIZE, m.MAX_REQUEST_BYTES)
        socket.setsockopt(zmq.SNDHWM, _SEND_QUEUE[door])
        socket.setsockopt(zmq.RCVHWM, QUEUE)
        socket.setsockopt(zmq.IPV6, address.startswith("tcp://["))
        if door == REMOTE:
            socket.setsockopt(zmq.HANDSHAKE_IVL, _HANDSHAKE_MS)
            self._monitor = monitored(socket, zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)
            self.watch(int(self._monitor.getsockopt(zmq.FD)))
        if keys is not None:
            pair = server_keys(keys)
            socket.curve_server = True
            socket.curve_secretkey, socket.curve_publickey = pair.secret, pair.public
        try:
            socket.bind(address)
        except zmq.ZMQError as error:
            raise ConfigError(
                f"{address}: cannot be opened ({error.strerror}); choose another address"
            ) from None
        self._wakes.register(int(socket.getsockopt(zmq.FD)), select.EPOLLIN)
        if door == LOCAL:
            Path(address.removeprefix("ipc://")).chmod(0o600)


def monitored(socket: zmq.Socket[bytes], events: int) -> zmq.Socket[bytes]:
    """Where news of a socket's connections come in, for `recv_monitor_message`; without a bound. Before it has any.

    ZeroMQ's thread waits where news are not read, and every connection with it; so its own bound of 2,000 goes.

    The kernel ends TCP connections to a machine that is not there any more. It answers for a process that is stopped;
    ZeroMQ's heartbeats do not. They are answered by a thread of its own, however long the process computes.
    """
    socket.setsockopt(zmq.HEARTBEAT_IVL, 1000)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 1000 * _HEARTBEAT_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, 2)
    socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, _CUT_S - 2)
    socket.setsockopt(zmq.TCP_MAXRT, 1000 * _CUT_S)
    news: zmq.Socket[bytes] = socket.context.socket(zmq.PAIR)
    news.setsockopt(zmq.RCVHWM, 0)
    address = f"inproc://news-{socket.underlying}"
    socket.monitor(address, events)
    news.connect(address)
    return news


def _has_news(socket: zmq.Socket[bytes]) -> bool:
    return bool(int(socket.getsockopt(_EVENTS)) & _IN)


def _ipc(endpoint: str) -> str:
    """The address, after its folder was made. Raises ConfigError."""
    path = Path(endpoint.removeprefix("ipc://"))
    if (
        not endpoint.startswith("ipc://")
        or not path.is_absolute()
        or len(os.fsencode(path)) > _IPC_PATH_BYTES
    ):
        most = _IPC_PATH_BYTES
        raise ConfigError(
            f"endpoint {endpoint!r}: expected ipc:// and an absolute path of {most} bytes at most"
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
