"""What a tick of several client processes costs without simulators and networks, beside a bare echo of its messages.

Blocks of ticks and of echo rounds take turns, so that both see the same noise of the machine.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.barrier.fake_world import FakeWorld
from benchmarks.barrier.parts import TICK_TIMES, PartOrder, Sizes
from wcsim.config import RunConfig
from wcsim.core.own_folder import LockedTempFolder, create_runtime_folder
from wcsim.errors import LinkTimeoutError
from wcsim.server.launch.states import WorldStatusReport
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import SeatRequest, WorldBuildSpec, WorldProcessSpec, decode_json_line, encode_json_line
from wcsim.server.transport.keys import create_missing_keys
from wcsim.types import SeatSpec

BLOCK_TICKS = 100
_WARM_TICKS = 20
_START_S = 120.0
_SESSION = bytes(m.SESSION_BYTES)

Blocks = list[list[float]]  # times of each party
Progress = Callable[[int], None]  # (ticks done)


@dataclass(frozen=True, slots=True, kw_only=True)
class BarrierCost:
    """Milliseconds from tick to tick, the larger of what the server and the clients saw; and of bare echo rounds."""

    median_ms: float
    p99_ms: float
    echo_median_ms: float
    echo_p99_ms: float


def measure_barrier(
    config: RunConfig, clients: int, ticks: int, remote: bool, progress: Progress = lambda ticks: None
) -> BarrierCost:
    """Drive `clients` processes for `ticks` ticks, over ipc or, as `remote` ones, over TCP with CURVE.

    Raises:
        LinkTimeoutError: A process of the bench does not answer.
    """
    counts = [min(BLOCK_TICKS, ticks - done) for done in range(0, ticks, BLOCK_TICKS)]
    tick_times: list[Blocks] = []
    echo_times: list[Blocks] = []
    with ExitStack() as held:
        bench = _Bench(config, clients, remote, held)
        bench.ticks(_WARM_TICKS)
        bench.rounds(_WARM_TICKS)
        for number, count in enumerate(counts):
            tick_times.append(bench.ticks(count))
            echo_times.append(bench.rounds(count))
            progress(sum(counts[: number + 1]))
        server_times = bench.world_times()[_WARM_TICKS:]
    ends = np.cumsum(counts)
    for block, (end, count) in zip(tick_times, zip(ends, counts, strict=True), strict=True):
        block.append(server_times[end - count : end])
    median_ms, p99_ms = _worst_ms(tick_times)
    echo_median_ms, echo_p99_ms = _worst_ms(echo_times)
    return BarrierCost(median_ms=median_ms, p99_ms=p99_ms, echo_median_ms=echo_median_ms, echo_p99_ms=echo_p99_ms)


def _worst_ms(blocks: Sequence[Blocks]) -> tuple[float, float]:
    """The largest median and 99th percentile of all parties, from tick to tick within each block."""
    parties = list(zip(*blocks, strict=True))
    rows = [1e3 * np.concatenate([np.diff(np.array(block)) for block in party]) for party in parties]
    return max(float(np.median(row)) for row in rows), max(float(np.percentile(row, 99)) for row in rows)


class _Bench:
    """All processes of a bench, ready to go."""

    def __init__(self, config: RunConfig, clients: int, remote: bool, held: ExitStack) -> None:
        self._folder = held.enter_context(create_runtime_folder(prefix="wcsim-bench-"))
        ring = LockedTempFolder()
        held.callback(ring.close)
        keys = str(self._folder / "keys") if remote else ""
        names = tuple(f"client-{number}" for number in range(clients))
        if remote:
            create_missing_keys(Path(keys), names)
        echo = f"tcp://127.0.0.1:{_free_port()}" if remote else f"ipc://{self._folder}/echo"
        self._world = _world(config, clients, keys, self._folder, ring.path, held)
        join = SeatRequest(endpoint=_listening(self._world, remote, self._folder), name="", claim="", keys=keys)
        order = PartOrder(join=join, echo=echo, keys=keys, clients=clients, sizes=_sizes(config, remote))
        self._echo = _Part("echo", order, self._folder, held)
        orders = [
            replace(order, join=replace(join, name=name, claim=name), number=number)
            for number, name in enumerate(names)
        ]
        self._clients = [_Part("client", own, self._folder, held) for own in orders]
        for part in (self._echo, *self._clients):
            part.answer()

    def ticks(self, count: int) -> Blocks:
        """Have all clients drive; the times at which each saw its frames."""
        return _asked(self._clients, b"ticks %d" % count)

    def rounds(self, count: int) -> Blocks:
        """Have all clients and the echo server do rounds; the times of each, the server's last."""
        return _asked([*self._clients, self._echo], b"rounds %d" % count)

    def world_times(self) -> list[float]:
        """End the world; when it did each tick since its beginning."""
        self._world.terminate()
        self._world.wait(_START_S)
        return msgspec.json.decode((self._folder / TICK_TIMES).read_bytes(), type=list[float])


class _Part:
    """A client or the echo server."""

    def __init__(self, role: str, order: PartOrder, folder: Path, held: ExitStack) -> None:
        path = folder / f"{role}-{order.number}.json"
        path.write_bytes(msgspec.json.encode(order))
        command = [sys.executable, "-m", "benchmarks.barrier.parts", role, str(path)]
        self._name = f"{role} {order.number}"
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        held.callback(_killed, self._process)
        self._rest = b""

    def ask(self, what: bytes) -> None:
        """Have it do something."""
        if self._process.stdin is not None:
            self._process.stdin.write(what + b"\n")
            self._process.stdin.flush()

    def answer(self) -> list[float]:
        """What it answers. Raises LinkTimeoutError when it does not."""
        out, end_s = self._process.stdout, time.monotonic() + _START_S
        while out is not None and b"\n" not in self._rest and time.monotonic() < end_s:
            if select.select([out], [], [], 1.0)[0]:
                data = os.read(out.fileno(), 1 << 20)
                self._rest += data
                if not data:
                    break
        line, found, self._rest = self._rest.partition(b"\n")
        if not found:
            raise LinkTimeoutError(f"{self._name} of the bench does not answer; its messages above may say why")
        return msgspec.json.decode(line, type=list[float])


def _asked(parts: Sequence[_Part], what: bytes) -> Blocks:
    for part in parts:
        part.ask(what)
    return [part.answer() for part in parts]


def _world(
    config: RunConfig, clients: int, keys: str, folder: Path, ring: Path, held: ExitStack
) -> subprocess.Popen[bytes]:
    """The world process; its status lines go to its stdout."""
    order = WorldProcessSpec(
        town="",
        config=config,
        seed=0,
        rules=ServerRules(capacity=clients, expected=clients),
        endpoint=f"ipc://{folder}/s/world",
        ring=str(ring),
        run=str(folder),
        journal=False,
        listen="tcp://127.0.0.1:*" if keys else "",
        keys=keys,
        status_fd=1,
    )
    path = folder / "world.json"
    path.write_bytes(encode_json_line(order))
    command = [sys.executable, "-m", "benchmarks.barrier.parts", "world", str(path)]
    world = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    held.callback(_killed, world)
    return world


def _listening(world: subprocess.Popen[bytes], remote: bool, folder: Path) -> str:
    """Where clients reach the world, once it is there."""
    for line in world.stdout or ():
        status = decode_json_line(WorldStatusReport, line)
        if status.stage != "loading":
            return status.listening if remote else f"ipc://{folder}/s/world"
    raise LinkTimeoutError("the world of the bench has ended; its messages above say why")


def _sizes(config: RunConfig, remote: bool) -> Sizes:
    """What the messages of a tick weigh."""
    world = FakeWorld(WorldBuildSpec(town="", config=config, seed=0), (SeatSpec(),), 0)
    frame = m.Frame(0, 1000, 0, world.snapshot.clients[0], -1 if remote else 0)
    return Sizes(
        act=len(m.encode_message(m.Act(_SESSION, 0, 1000, 0, 0.1, 0.8))),
        done=len(m.encode_message(m.TickDone(0, 1000, 0, 1e-4))),
        frame=len(m.encode_message(frame)),
    )


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
        return port


def _killed(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
