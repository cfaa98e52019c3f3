"""What a world process reports to its parent process, as lines of JSON."""

import contextlib
import os
import statistics
import time
from collections import deque
from collections.abc import Sequence
from typing import Final

import msgspec

from wcsim.errors import WcsimError
from wcsim.server.host.world_host import WorldEffectExecutor
from wcsim.server.launch.states import ClientBarrierDelay, WorldStatusReport
from wcsim.server.protocol.events import BarrierState, Event, MessageReceivedEvent, TimePassedEvent
from wcsim.server.protocol.members import RosterClient
from wcsim.server.protocol.messages import Act, failure_from_error
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import encode_json_line, measure_rss_mb

_REPORT_EVERY_S: Final = 0.25
_STEPS: Final = 100  # for the median
_RATES: Final = 20  # reports that the rate is taken over


class StatusPipeWriter:
    """Writes lines of `WorldStatusReport` into a pipe; what a full pipe does not take is lost."""

    def __init__(self, pipe: int) -> None:
        """Use this descriptor; -1 for none."""
        self._pipe = pipe
        self.listening = ""  # the address for other machines
        self._report_s = -_REPORT_EVERY_S
        self._steps_s: deque[float] = deque(maxlen=_STEPS)
        self._counts: deque[tuple[float, int]] = deque(maxlen=_RATES)
        self._waiting = _WaitingTimes()
        if pipe >= 0:
            os.set_blocking(pipe, False)

    def report_loading(self) -> None:
        """Report that the world is not there yet."""
        self._write(encode_json_line(WorldStatusReport(stage="loading")))

    def report_failure(self, error: WcsimError) -> None:
        """Report that there is no world, or no more; the line is a `Failure`."""
        self._write(msgspec.json.encode(failure_from_error(error)) + b"\n")

    def record_event(self, core: ServerCore, event: Event, now_s: float, stepped_s: float) -> None:
        """Note how long the step of an event was, and who is waited for after it."""
        if stepped_s > 0.0:
            self._steps_s.append(stepped_s)
            # The last action and the step are one event: nobody waits during the step.
            self._waiting.update((), (), now_s - stepped_s)
        is_act = isinstance(event, MessageReceivedEvent) and isinstance(event.message, Act)
        if is_act or stepped_s > 0.0 or isinstance(event, TimePassedEvent):
            names, late = _names_and_late(core, core.roster.members)
            self._waiting.update(names, late, now_s)

    def report(self, core: ServerCore, host: WorldEffectExecutor, now_s: float) -> None:
        """Report the state of the server, unless the last report is recent."""
        real_s = time.monotonic()
        if real_s - self._report_s < _REPORT_EVERY_S or self._pipe < 0:
            return
        self._report_s = real_s
        self._counts.append((real_s, host.ticks))
        (first_s, first), (last_s, last) = self._counts[0], self._counts[-1]
        members = core.roster.by_seat()
        names, late = _names_and_late(core, members)
        master = core.roster.master
        is_waiting = core.stage is BarrierState.COLLECT
        owing_s = [now_s - p.owes_since_s for p in members if is_waiting and not p.ready]
        status = WorldStatusReport(
            stage=core.stage.value,
            epoch=core.epoch,
            tick=core.tick,
            ticks=host.ticks,
            ticks_per_s=(last - first) / (last_s - first_s) if last_s > first_s else 0.0,
            step_ms=1e3 * statistics.median(self._steps_s) if self._steps_s else 0.0,
            members=tuple(names),
            master="" if master is None else names[members.index(master)],
            late=tuple(late),
            late_s=max(owing_s, default=0.0),
            rss_mb=measure_rss_mb(),
            held=self._waiting.caused(names),
            waited_s=self._waiting.table(names),
            listening=self.listening,
        )
        self._write(encode_json_line(status))

    def _write(self, line: bytes) -> None:
        if self._pipe >= 0:
            with contextlib.suppress(BlockingIOError, BrokenPipeError):
                os.write(self._pipe, line)


class _WaitingTimes:
    """How much of the others' waiting each member has caused, which is more than who is late now.

    Adds up time in which some members had acted and others had not. Those that are late at the same
    moment share it evenly.

    >>> times = _WaitingTimes()
    >>> times.update(("a", "b"), ("a", "b"), 0.0)  # none has acted, so none waits
    >>> times.update(("a", "b"), ("b",), 1.0)  # a has acted
    >>> times.update(("a", "b"), (), 3.5)  # b too
    >>> times.caused(("a", "b"))
    (ClientBarrierDelay(name='a', seconds=0.0), ClientBarrierDelay(name='b', seconds=2.5))
    >>> times.table(("a", "b"))
    ((0.0, 2.5), (0.0, 0.0))
    """

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._pairs: dict[str, dict[str, float]] = {}  # seconds by who waited, and for whom
        self._late: Sequence[str] = ()  # for whom others have waited since `_update_s`
        self._update_s = 0.0
        # What each late member has been waited for, summed up over all that were late.
        self._shared_s = 0.0
        self._acted: dict[str, float] = {}  # `_shared_s` when each of those who wait began to

    def update(self, members: Sequence[str], late: Sequence[str], now_s: float) -> None:
        """Set who is in and who is late from now on; to be called whenever that has changed."""
        # 1. Share the time since the last call among those that were late. One that is not late
        #    any more is charged to each that has waited, with what that one has paid for it.
        if self._late:
            share_s = (now_s - self._update_s) / len(self._late)
            for name in self._late:
                self._seconds[name] = self._seconds.get(name, 0.0) + share_s
            self._shared_s += share_s
            for arrived in set(self._late).difference(late):
                for name, since_s in self._acted.items():
                    row = self._pairs.setdefault(name, {})
                    row[arrived] = row.get(arrived, 0.0) + self._shared_s - since_s
        # 2. Note who waits from now on: none where all are late, or none is.
        if len(late) in (0, len(members)):
            self._acted.clear()
        else:
            for name in set(members).difference(late, self._acted):
                self._acted[name] = self._shared_s
        self._late = late if len(late) < len(members) else ()
        self._update_s = now_s

    def caused(self, members: Sequence[str]) -> tuple[ClientBarrierDelay, ...]:
        """Seconds that each of these members was waited for; those of others are forgotten."""
        self._seconds = {name: self._seconds.get(name, 0.0) for name in members}
        return tuple(
            ClientBarrierDelay(name=name, seconds=seconds)
            for name, seconds in self._seconds.items()
        )

    def table(self, members: Sequence[str]) -> tuple[tuple[float, ...], ...]:
        """Seconds that each of these members (rows) has waited for each (columns).

        Rows of others are forgotten.
        """
        self._pairs = {name: self._pairs.get(name, {}) for name in members}
        return tuple(
            tuple(round(row.get(name, 0.0), 2) for name in members) for row in self._pairs.values()
        )


def _names_and_late(
    core: ServerCore, members: Sequence[RosterClient]
) -> tuple[list[str], list[str]]:
    """The names of members, and of those of them that the others wait for."""
    names = _names_of(members)
    if core.stage is not BarrierState.COLLECT:
        return names, []
    mates = zip(names, members, strict=True)
    return names, [name for name, mate in mates if not mate.ready]


def _names_of(members: Sequence[RosterClient]) -> list[str]:
    """The names of members; one that a member on a lower seat has too is given with its seat."""
    first = {mate.name: mate.seat for mate in sorted(members, key=lambda mate: -mate.seat)}
    return [
        mate.name if first[mate.name] == mate.seat else f"{mate.name} (seat {mate.seat})"
        for mate in members
    ]
