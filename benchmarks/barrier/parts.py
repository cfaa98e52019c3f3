"""The processes of the barrier bench: `python -m benchmarks.barrier.parts ROLE ORDER_FILE`.

The `world` is a process with a `TimedWorld`. A `client` has a seat in a world and a socket to an `echo` server, which
does with bare messages what a world does with its own: wait for one of each client, send one to each. Blocks of ticks
and of echo rounds are asked for on stdin, so that both are measured in turns; times of each are written to stdout.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import zmq

from benchmarks.barrier.fake_world import FakeWorld
from wcsim.bridge.replay.player import Specs
from wcsim.core.processes import die_with_parent
from wcsim.server.links.base import ProcessSeatLink
from wcsim.server.links.socket import SocketSeatLink
from wcsim.server.specs import SeatRequest, WorldBuildSpec
from wcsim.server.transport.keys import ClientKeyLookup, read_client_keys, read_server_keys, read_server_public_key
from wcsim.types import ClientSnapshot, Command, Joystick, SensorFrame, Snapshot

TICK_TIMES = "tick-times.json"  # in the run folder of a `TimedWorld`
_WAIT_MS = 60_000
_AHEAD = Joystick(0.1, 0.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Bytes of the messages of a round."""

    act: int
    done: int
    frame: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PartOrder:
    """What a process of the bench is told."""

    join: SeatRequest
    echo: str  # endpoint
    keys: str
    clients: int
    sizes: Sizes
    number: int = 0  # of a client


class TimedWorld(FakeWorld):
    """A stand-in that notes when each tick was done, and writes that down when it is closed."""

    def __init__(self, order: WorldBuildSpec, specs: Specs, seed: int, epoch: int = 0) -> None:
        super().__init__(order, specs, seed, epoch=epoch)
        self._file = Path(order.run) / TICK_TIMES
        self._times_s: list[float] = []

    def tick(self, commands: Sequence[Command], out: object = None) -> Snapshot:
        """See `World.tick`; everybody sees the same again, under a new number."""
        del commands, out
        self._times_s.append(time.monotonic())
        now = self.snapshot
        self.snapshot = replace(now, tick=now.tick + 1, clients=tuple(map(_again, now.clients)))
        return self.snapshot

    def close(self) -> None:
        """Write the times."""
        self._file.write_bytes(msgspec.json.encode(self._times_s))


def _again(client: ClientSnapshot) -> ClientSnapshot:
    """The same frame, a tick later."""
    sensors, tick = client.sensors, client.tick + 1
    return ClientSnapshot(
        seat=client.seat,
        tick=tick,
        plant=client.plant,
        sensors=SensorFrame(tick=tick, cameras=sensors.cameras, imu=sensors.imu),
        user=client.user,
        contacts=client.contacts,
        events=client.events,
    )


def main(words: Sequence[str]) -> int:
    """Play a role until stdin ends, or be the world process of a `WorldProcessSpec`."""
    role, path = words
    if role == "world":
        from wcsim.server.host.process import main as host  # clients and the echo load no simulator

        return host([path], TimedWorld)
    die_with_parent()
    order = msgspec.json.decode(Path(path).read_bytes(), type=PartOrder)
    with zmq.Context() as context:
        if role == "echo":
            _echo(context, order)
        else:
            _client(context, order)
    return 0


def _client(context: zmq.Context[zmq.Socket[bytes]], order: PartOrder) -> None:
    with SocketSeatLink(order.join) as link, context.socket(zmq.DEALER) as socket:
        _prepare(socket)
        socket.setsockopt(zmq.IDENTITY, b"%d" % (order.number + 1))
        if order.keys:
            pair = read_client_keys(Path(order.keys), order.join.name)
            socket.curve_serverkey = read_server_public_key(Path(order.keys))
            socket.curve_publickey, socket.curve_secretkey = pair.public, pair.secret
        socket.connect(order.echo)
        link.join()
        _say([])
        for line in sys.stdin.buffer:
            kind, count = line.split()
            _say(_ticks(link, int(count)) if kind == b"ticks" else _rounds(socket, order, int(count)))


def _ticks(link: ProcessSeatLink, count: int) -> list[float]:
    tick, times_s = link.join().tick, []
    for _ in range(count):
        tick = link.act(tick, _AHEAD).tick
        times_s.append(time.monotonic())
    return times_s


def _rounds(socket: zmq.Socket[bytes], order: PartOrder, count: int) -> list[float]:
    act, times_s = bytes(order.sizes.act), []
    for _ in range(count):
        socket.send(act)
        socket.recv_multipart()
        times_s.append(time.monotonic())
    return times_s


def _echo(context: zmq.Context[zmq.Socket[bytes]], order: PartOrder) -> None:
    sizes, guard = order.sizes, None
    with context.socket(zmq.ROUTER) as socket:
        _prepare(socket)
        if order.keys:
            guard, pair = ClientKeyLookup(Path(order.keys)).guard(context), read_server_keys(Path(order.keys))
            socket.curve_server = True
            socket.curve_secretkey, socket.curve_publickey = pair.secret, pair.public
        socket.bind(order.echo)
        _say([])
        answer = (bytes(sizes.done), bytes(sizes.frame))
        try:
            for line in sys.stdin.buffer:
                _say([_round(socket, order.clients, answer) for _ in range(int(line.split()[1]))])
        finally:
            if guard is not None:
                guard.stop()


def _round(socket: zmq.Socket[bytes], clients: int, answer: tuple[bytes, bytes]) -> float:
    """One round; returns when all had spoken."""
    peers = sorted(socket.recv_multipart()[0] for _ in range(clients))
    now_s = time.monotonic()
    for peer in peers:
        socket.send_multipart((peer, *answer))
    return now_s


def _prepare(socket: zmq.Socket[bytes]) -> None:
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.RCVTIMEO, _WAIT_MS)


def _say(times_s: list[float]) -> None:
    sys.stdout.buffer.write(msgspec.json.encode(times_s) + b"\n")
    sys.stdout.buffer.flush()


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
