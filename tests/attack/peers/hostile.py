"""A hostile client with a key, `python -m tests.attack.peers.hostile flood|burn ...`, and the honest ones beside it.

`flood` says 1,000 messages a second to a server, of every kind, over as many connections as it takes; `burn` spends the
same share of a processor and says nothing.
"""

import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import zmq

from benchmarks.soak.stub_client import StubSight, read_sights
from tests.attack.peers.messages import hostile_request
from tests.attack.peers.wire import shapes
from tests.attack.scenarios.twists import Rng, integer, pick
from wcsim.server.protocol import messages as m
from wcsim.server.specs import SeatRequest
from wcsim.server.transport.keys import read_client_keys, read_server_public_key
from wcsim.types import SeatSpec

PER_S = 1000
TURN_S = 0.02
SETTLE_S = 1.0  # after a change of phase


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase:
    """A stretch of time with one of the two beside the world."""

    what: str  # "flood" or "burn"
    begin_s: float
    end_s: float
    cpu_share: float  # of one core, that the process beside took


def main(words: Sequence[str]) -> int:
    """Flood or burn until somebody ends this process."""
    what, *rest = words
    if what == "flood":
        flood(rest[0], Path(rest[1]), int(rest[2]))
    else:
        burn(float(rest[0]))
    return 0


def flood(endpoint: str, keys: Path, seed: int) -> None:
    """Say the worst; a connection is left when it is not heard any more."""
    rng = np.random.default_rng(seed)
    kinds = [shape for shape in shapes() if shape.request]
    pair, server = read_client_keys(keys, "evil"), read_server_public_key(keys)
    with zmq.Context() as context:
        while True:
            with context.socket(zmq.DEALER) as socket:
                socket.setsockopt(zmq.LINGER, 0)
                socket.curve_serverkey = server
                socket.curve_publickey, socket.curve_secretkey = pair.public, pair.secret
                socket.connect(endpoint)
                for _ in range(25):
                    _say_some(socket, kinds, rng)


def _say_some(socket: zmq.Socket[bytes], kinds: list[Any], rng: Rng) -> None:
    begun_s = time.monotonic()
    epoch, tick = integer(rng, 3), integer(rng, 100_000)
    for _ in range(round(PER_S * TURN_S)):
        wild = rng.random() < 0.05
        data = hostile_request(kinds, rng, epoch, tick) if wild else m.encode_message(_readable(rng, epoch, tick))
        try:
            socket.send(data, zmq.NOBLOCK)
        except zmq.Again:
            break
    while socket.poll(0):
        socket.recv_multipart()
    time.sleep(max(0.0, TURN_S - (time.monotonic() - begun_s)))


def _readable(rng: Rng, epoch: int, tick: int) -> m.Request:
    session = rng.bytes(16)
    join = m.Join(
        m.PROTOCOL, m.hash_message_schema(), "", session, rng.bytes(8), int(rng.integers(-1, 4)), "evil", SeatSpec()
    )
    said: tuple[m.Request, ...] = (
        join, m.Act(session, epoch, tick, 0, 0.1, 0.2),
        m.Respawn(session, epoch, tick, 0), m.Rebuild(session, epoch, 7), m.Beat(session, 1), m.Leave(session),
    )  # fmt: skip
    return pick(rng, said)


def burn(share: float) -> None:
    """Spend this share of a core."""
    while True:
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < share * TURN_S:
            pass
        time.sleep((1.0 - share) * TURN_S)


@contextmanager
def beside(words: Sequence[str]) -> Iterator[psutil.Process]:
    """A process of this module while the block runs."""
    child = subprocess.Popen([sys.executable, "-m", "tests.attack.peers.hostile", *words])
    try:
        yield psutil.Process(child.pid)
    finally:
        child.kill()
        child.wait()


def phases(endpoint: str, keys: Path, rounds: int, phase_s: float) -> Iterator[Phase]:
    """Flood and burn in turns; the burner takes what the flood took in the round before it."""
    for number in range(rounds):
        taken = yield from flooded(endpoint, keys, number, phase_s)
        yield from _phase("burn", ["burn", str(min(1.0, taken))], phase_s)


def flooded(endpoint: str, keys: Path, seed: int, phase_s: float) -> Generator[Phase, None, float]:
    """One flood; returns the share of a core that it took."""
    return (yield from _phase("flood", ["flood", endpoint, str(keys), str(seed)], phase_s))


def _phase(what: str, words: list[str], phase_s: float) -> Generator[Phase, None, float]:
    with beside(words) as process:
        time.sleep(SETTLE_S + 1.0)  # it starts
        before = process.cpu_times()
        begin_s = time.monotonic()
        time.sleep(phase_s)
        after, end_s = process.cpu_times(), time.monotonic()
        share = (after.user + after.system - before.user - before.system) / (end_s - begin_s)
        yield Phase(what=what, begin_s=begin_s, end_s=end_s, cpu_share=share)
    return share


def end(client: subprocess.Popen[bytes]) -> int:
    """Ask a client to leave."""
    client.send_signal(signal.SIGTERM)
    return client.wait(60.0)


def honest_order(endpoint: str, name: str, seat: int, folder: Path) -> SeatRequest:
    """How an honest client with a ledger joins."""
    return SeatRequest(
        endpoint=endpoint, name=name, claim=secrets.token_hex(16), seat=seat, ledger=str(folder / f"{name}.ledger")
    )


def tick_times_s(sights: Sequence[StubSight], within: Sequence[Phase]) -> list[float]:
    """Times between two frames that both lie in one of these phases."""
    spans = [(phase.begin_s, phase.end_s) for phase in within]
    pairs = pairwise(sights)
    return [b.time_s - a.time_s for a, b in pairs if any(s <= a.time_s and b.time_s <= e for s, e in spans)]


def sights_of(folder: Path, name: str) -> list[StubSight]:
    """What an honest client saw."""
    return read_sights(folder / f"{name}.sights")


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
