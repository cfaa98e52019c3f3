"""What a server spends on a message before its core sees it: `python -m tests.attack.peers.cost`."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable

from tests.attack.peers.peers import a_join
from wcsim.server.host.process import _at_the_door, _PeerLimits
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import Rules
from wcsim.server.protocol.members import Roster
from wcsim.server.protocol.server_core import _admission

SESSION = b"s" * m.SESSION_BYTES
TIMES = 20_000


def us(do: Callable[[], object]) -> float:
    """Microseconds of one call, the best of seven rounds."""
    best_s = float("inf")
    for _ in range(7):
        begun_s = time.perf_counter()
        for _ in range(TIMES):
            do()
        best_s = min(best_s, time.perf_counter() - begun_s)
    return 1e6 * best_s / TIMES


def main() -> None:
    """Print a row a kind of message."""
    peers, rules, roll, join = _PeerLimits(), Rules(capacity=4), Roster(), a_join(name="ann")
    said: tuple[m.Request, ...] = (
        m.Act(SESSION, 1, 2, 0, 0.5, 0.5), m.Beat(SESSION, 3), m.Leave(SESSION), join
    )  # fmt: skip
    write = sys.stdout.write
    clock_s = itertools.count()
    write(f"account of a peer: {us(lambda: peers.hears(b'Rx', next(clock_s), set)):.2f} us a message\n")
    for message in said:
        data = m.encode(message)
        write(f"{type(message).__name__}: read and checked in {us(lambda data=data: m.decode_request(data)):.2f} us\n")
    write(f"Join at the door: {us(lambda: _at_the_door(join, True, 'ann')):.2f} us\n")
    write(f"Join, admitted or not: {us(lambda: _admission(join, rules, roll)):.2f} us\n")


if __name__ == "__main__":
    main()
