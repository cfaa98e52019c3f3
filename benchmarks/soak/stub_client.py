"""A client without a learner, for benches and soaks: `python -m benchmarks.soak.stub_client ORDER_FILE [options]`.

It drives as its user wishes, thinks for a given time, and writes down when it saw each frame (the machine's monotonic
clock, the same for all processes). SIGTERM ends it in good order; it ends with a code of `ClientExitCode`.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import struct
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from types import FrameType

from wcsim.core.processes import die_with_parent
from wcsim.errors import EvictedError, LinkError, WcsimError, WorldRestartedError
from wcsim.server.launch.states import WAIT_NO_MORE, ClientExitCode, ClientStatusReport
from wcsim.server.links.base import ProcessSeatLink
from wcsim.server.links.socket import SocketSeatLink
from wcsim.server.specs import SeatRequest, encode_json_line, read_spec_file
from wcsim.types import ClientSnapshot

SAY_S = 0.5
_SEEN = struct.Struct("<dqq")


@dataclass(frozen=True, slots=True)
class StubSight:
    """A frame that a client saw."""

    time_s: float  # of the monotonic clock
    epoch: int
    tick: int


def read_sights(path: Path) -> list[StubSight]:
    """What a client wrote down in all its lives; nothing when there is no such file."""
    data = path.read_bytes() if path.is_file() else b""
    whole = len(data) - len(data) % _SEEN.size
    return [StubSight(*entry) for entry in _SEEN.iter_unpack(data[:whole])]


class _Ends:
    """Set once somebody asks for the end."""

    def __init__(self) -> None:
        self.asked = False
        signal.signal(signal.SIGTERM, self._ask)
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.asked = True


class _Notes:
    """Writes sights down, and says how many there are."""

    def __init__(self, path: Path, name: str, pipe: int) -> None:
        self._file = FileIO(path, "ab")
        self._name, self._pipe = name, pipe
        self._count = self._file.tell() // _SEEN.size
        self._said_s = 0.0

    def note(self, link: ProcessSeatLink, seen: ClientSnapshot) -> None:
        """One more frame."""
        now_s = time.monotonic()
        self._file.write(_SEEN.pack(now_s, link.epoch, seen.tick))
        self._count += 1
        if self._pipe >= 0 and now_s - self._said_s > SAY_S:
            self._said_s = now_s
            with contextlib.suppress(OSError):
                os.write(self._pipe, encode_json_line(ClientStatusReport(name=self._name, step=self._count)))


def main(words: Sequence[str]) -> int:
    """Drive until the steps are done or the end is asked for; returns a code of `ClientExitCode`."""
    die_with_parent()
    ends = _Ends()
    parser = argparse.ArgumentParser()
    parser.add_argument("order", type=Path)
    parser.add_argument("--steps", type=int, default=1 << 60)
    parser.add_argument("--think-ms", type=float, default=0.0)
    parser.add_argument("--sights", type=Path, required=True)
    parser.add_argument("--status-fd", type=int, default=-1)
    parser.add_argument("--resume", action="store_true")
    options = parser.parse_args(words)
    try:
        order = read_spec_file(SeatRequest, options.order)
        notes = _Notes(options.sights, order.name, options.status_fd)
        with SocketSeatLink(order) as link:
            signal.signal(WAIT_NO_MORE, lambda number, frame: link.wait_no_more())
            _drive(link, notes, ends, options.steps, 1e-3 * options.think_ms)
    except WcsimError as error:
        sys.stderr.write(f"wcsim: {type(error).__name__}: {error}\n")
        if ends.asked:
            return ClientExitCode.STOPPED
        return _exit_of(error)
    return ClientExitCode.STOPPED if ends.asked else ClientExitCode.DONE


def _drive(link: ProcessSeatLink, notes: _Notes, ends: _Ends, steps: int, think_s: float) -> None:
    seen = link.join()
    notes.note(link, seen)
    for _ in range(steps):
        if ends.asked:
            return
        if think_s > 0.0:
            time.sleep(think_s)
        try:
            seen = link.act(seen.tick, (seen.first or seen).user)
        except WorldRestartedError:
            seen = link.join()
        notes.note(link, seen)


def _exit_of(error: WcsimError) -> ClientExitCode:
    if isinstance(error, EvictedError):
        return ClientExitCode.EVICTED
    return ClientExitCode.SERVER_GONE if isinstance(error, LinkError) else ClientExitCode.USER_ERROR


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
