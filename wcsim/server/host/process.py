"""A world in a process of its own: `python -m wcsim.server.host.process ORDER_FILE`, a `WorldSpec` as JSON.

It ends when SIGTERM asks it to, or when whoever started it has gone. It ends with a code of `WorldExit`.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

from wcsim.errors import ConfigError, DiskFullError, HookError, JournalError, TownError, WcsimError
from wcsim.log.records import Ended, Input
from wcsim.server.host.epoch_cap import EPOCH_OVER
from wcsim.server.host.loop import Hosted, ServerLoop
from wcsim.server.host.made_world import street_world
from wcsim.server.host.recovery import Opened, open_server
from wcsim.server.host.status import Reporter
from wcsim.server.launch.lifeline import Lifelines
from wcsim.server.launch.parent_death import die_with_parent
from wcsim.server.launch.states import WorldExit
from wcsim.server.protocol.limits import NO_ROOM, last_words, told_limit
from wcsim.server.seat_world import MakesWorld, SeatWorld
from wcsim.server.specs import WorldSpec, read_order
from wcsim.server.transport.shared_images import RingSink, pictures_of
from wcsim.server.transport.sockets import ServerSockets

_ORDER_FAULTS = (ConfigError, TownError, HookError, JournalError)
_PARENT_GONE = signal.SIGUSR1


def main(words: list[str], make: MakesWorld[SeatWorld] = street_world) -> int:
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
        limit = DiskFullError(told) if getattr(error, "errno", None) in NO_ROOM else ConfigError(told)
        reporter.failed(limit)
        return _failed(limit, order.quiet)
    if not reason.startswith(EPOCH_OVER):
        return WorldExit.DONE
    last_words(f"wcsim: {reason}")
    return WorldExit.EPOCH_OVER


def _prepared(
    order: WorldSpec, make: MakesWorld[SeatWorld], reporter: Reporter, held: ExitStack
) -> tuple[Opened, ServerLoop]:
    """Open the doors first, so that an order that cannot be used fails before the world is loaded."""
    doors = held.enter_context(ServerSockets(order.endpoint, order.listen, order.keys))
    lifelines = held.enter_context(Lifelines(order.status_fd))
    opened = open_server(order, make, reporter.loading)  # a long silence would be taken for a hang
    if opened.journal is not None:
        held.enter_context(opened.journal)
    held.callback(opened.world.close)
    ring = RingSink(Path(order.ring), order.rules.capacity, pictures_of(order.world.config.cameras))
    reporter.listening = doors.listening
    keep = _forget if opened.journal is None else opened.journal.append
    hosted = Hosted(order=order, core=opened.core, world=opened.world, keep=keep, ring=ring)
    return opened, ServerLoop(hosted, doors, lifelines, reporter)


def _forget(record: Input) -> None:
    """A world without a run folder keeps no journal."""
    del record


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
