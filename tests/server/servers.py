"""World processes for tests, as a launcher would start them; most have a stand-in for a world."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.support.worlds import quick_config
from wcsim.errors import ConfigError
from wcsim.server.launch.states import WorldStatusReport
from wcsim.server.links.base import ProcessSeatLink, SeatLink, SeatLinkGroup
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import Patience
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import SeatRequest, WorldProcessSpec, decode_json_line, encode_json_line
from wcsim.types import ClientSnapshot, Joystick

AHEAD = Joystick(0.1, 0.8)
NOWHERE = "nowhere"  # the town of stand-ins
REAL, STAND_IN = "wcsim.server.host.process", "benchmarks.barrier.fake_world"  # a world process with either
WAIT_S = 120.0
QUICK = Patience(resend_s=0.3, reconnect_s=120.0, tick_s=120.0)


def stand_in_order(folder: Path, seats: int = 2, **changes: Any) -> WorldProcessSpec:
    """A server, all in `folder`; a stand-in for a world, unless `changes` name a town."""
    rules = changes.pop("rules", ServerRules(capacity=seats, expected=1, gather_s=60.0, notice_s=0.2))
    order = WorldProcessSpec(
        town=NOWHERE,
        config=quick_config(),
        seed=3,
        rules=rules,
        endpoint=f"ipc://{folder}/s/world",
        ring=str(folder / "ring"),
    )
    return replace(order, **changes)


def far_order(folder: Path, town: Path, **changes: Any) -> WorldProcessSpec:
    """A real world with one seat, for clients on other machines too."""
    return stand_in_order(folder, town=str(town), rules=ServerRules(capacity=1), listen="tcp://127.0.0.1:*", **changes)


@contextmanager
def alone(group: SeatLinkGroup) -> Iterator[SeatLink]:
    """The only seat of a world, which ends with it."""
    with group:
        yield group.links[0]


class Server:
    """A world process; `start` may be called again when it has ended."""

    def __init__(self, order: WorldProcessSpec, folder: Path, before: Callable[[], None] | None = None) -> None:
        self.order, self._file, self._before = order, folder / "order.json", before
        self.process: subprocess.Popen[bytes]
        self._pipe = -1
        self._rest = b""
        self.failures: list[bytes] = []
        self.start()

    def start(self) -> None:
        self._rest = b""
        if self._pipe >= 0:
            os.close(self._pipe)
        self._pipe, theirs = os.pipe()
        self._file.write_bytes(encode_json_line(replace(self.order, status_fd=theirs)))
        module = STAND_IN if self.order.town == NOWHERE else REAL
        command = [sys.executable, "-m", module, str(self._file)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, pass_fds=(theirs,), preexec_fn=self._before
        )
        os.close(theirs)

    def status(
        self, fits: Callable[[WorldStatusReport], bool] = lambda status: status.stage != "loading"
    ) -> WorldStatusReport:
        """The first status from now on that fits."""
        end_s = time.monotonic() + WAIT_S
        while time.monotonic() < end_s:
            if select.select([self._pipe], [], [], 0.1)[0]:
                data = os.read(self._pipe, 1 << 16)
                *lines, self._rest = (self._rest + data).split(b"\n")
                for line in lines:
                    try:
                        status = decode_json_line(WorldStatusReport, line)
                    except ConfigError:
                        self.failures.append(line)
                        continue
                    if fits(status):
                        return status
                if not data:
                    break
        ended = self.process.poll()
        raise AssertionError(f"nothing fits; its end: {ended}; {self.errors() if ended is not None else ''}")

    def wait(self) -> int:
        return self.process.wait(WAIT_S)

    def errors(self) -> str:
        """What it wrote to stderr, once it has ended."""
        assert self.process.stderr is not None
        return self.process.stderr.read().decode()

    def kill(self) -> None:
        """As a crash would."""
        self.process.kill()
        self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()

    def let_go(self) -> None:
        """As when whoever started it dies."""
        os.close(self._pipe)
        self._pipe = -1

    def close(self) -> None:
        self.kill()
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def seat(self, name: str, **changes: Any) -> SeatRequest:
        """How a client joins."""
        order = SeatRequest(endpoint=self.order.endpoint, name=name, claim=name, patience=QUICK)
        return replace(order, **changes)


def frames_of(link: ProcessSeatLink, ticks: int) -> list[bytes]:
    """Every frame as bytes, because images are views that later frames overwrite."""
    frame = link.join()
    frames = [m.encode_message(m.Frame(0, frame.tick, 0, frame))]
    for _ in range(ticks):
        frame = link.act(frame.tick, AHEAD)
        frames.append(m.encode_message(m.Frame(0, frame.tick, 0, frame)))
    return frames


def joined(links: Sequence[ProcessSeatLink]) -> list[ClientSnapshot]:
    """All links join at the same time."""
    return together(links, lambda link: link.join())


def driven(links: Sequence[ProcessSeatLink], ticks: int) -> list[ClientSnapshot]:
    """All links drive so many ticks at the same time."""

    def drive(link: ProcessSeatLink) -> ClientSnapshot:
        seen = link.join()
        for _ in range(ticks):
            seen = link.act(seen.tick, AHEAD)
        return seen

    return together(links, drive)


def together(links: Sequence[ProcessSeatLink], do: Callable[[ProcessSeatLink], ClientSnapshot]) -> list[ClientSnapshot]:
    """The same with every link, each in a thread of its own: all wait for each other."""
    with ThreadPoolExecutor(len(links)) as pool:
        return list(pool.map(do, links))


def start_client(join: SeatRequest, folder: Path, *options: str) -> subprocess.Popen[bytes]:
    """A client without a learner, in a process of its own, with a list of what it saw when: it drives on and on."""
    order, sights = folder / f"{join.name}.json", folder / f"{join.name}.sights"
    order.write_bytes(encode_json_line(join))
    command = [sys.executable, "-m", "benchmarks.soak.stub_client", str(order), "--sights", str(sights), *options]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL)


@contextmanager
def stub_client(join: SeatRequest, folder: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """The same for the length of the block."""
    process = start_client(join, folder, *options)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
