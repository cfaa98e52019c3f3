"""What a world process says of itself, a line of JSON a few times a second, to whoever started it."""

from __future__ import annotations

import contextlib
import os
import statistics
import time
from collections import deque
from collections.abc import Sequence

import msgspec

from wcsim.errors import WcsimError
from wcsim.server.host.world_host import WorldHost
from wcsim.server.launch.states import BarrierDelay, WorldStatus
from wcsim.server.protocol.events import BarrierState, Clock, Event, Received
from wcsim.server.protocol.members import Member
from wcsim.server.protocol.messages import Act, failure_of
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import rss_mb, to_line

_EVERY_S = 0.25
_STEPS = 100  # for the median
_RATES = 20  # reports that the rate is taken over


class _Stragglers:
    """For whom the others wait: not who is late now, but how much of everybody's waiting each one has caused.

    Adds up time in which some members had acted and others had not; a moment's late ones share it evenly.

    >>> holdups = _Stragglers()
    >>> holdups.saw(("a", "b"), ("a", "b"), 0.0)  # nobody waits yet
    >>> holdups.saw(("a", "b"), ("b",), 1.0)  # a has acted
    >>> holdups.saw(("a", "b"), (), 3.5)  # b too
    >>> holdups.held(("a", "b"))
    (BarrierDelay(name='a', seconds=0.0), BarrierDelay(name='b', seconds=2.5))
    >>> holdups.waited(("a", "b"))
    ((0.0, 2.5), (0.0, 0.0))
    """

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._pairs: dict[str, dict[str, float]] = {}  # seconds by who waited, and for whom
        self._late: Sequence[str] = ()  # for whom somebody has waited since `_seen_s`
        self._seen_s = 0.0
        self._shared_s = (
            0.0  # what each late one has been waited for, summed up over all that were late
        )
        self._acted: dict[str, float] = {}  # who waits, and `_shared_s` when they began to

    def saw(self, members: Sequence[str], late: Sequence[str], now_s: float) -> None:
        """These are in from now on, and these of them are late; to be called whenever that has changed."""
        if self._late:
            share_s = (now_s - self._seen_s) / len(self._late)
            for name in self._late:
                self._seconds[name] = self._seconds.get(name, 0.0) + share_s
            self._shared_s += share_s
            for name in set(self._late).difference(late):
                self._came(name)
        if len(late) in (0, len(members)):
            self._acted.clear()
        else:
            for name in set(members).difference(late, self._acted):
                self._acted[name] = self._shared_s
        self._late = late if len(late) < len(members) else ()
        self._seen_s = now_s

    def _came(self, late: str) -> None:
        """One that was late is not any more: note what each of those who waited has paid for it."""
        for name, since_s in self._acted.items():
            row = self._pairs.setdefault(name, {})
            row[late] = row.get(late, 0.0) + self._shared_s - since_s

    def held(self, members: Sequence[str]) -> tuple[BarrierDelay, ...]:
        """Seconds that each of these members was waited for; those of others are forgotten."""
        self._seconds = {name: self._seconds.get(name, 0.0) for name in members}
        return tuple(
            BarrierDelay(name=name, seconds=seconds) for name, seconds in self._seconds.items()
        )

    def waited(self, members: Sequence[str]) -> tuple[tuple[float, ...], ...]:
        """Seconds that each of these members (rows) has waited for each (columns); rows of others are forgotten."""
        self._pairs = {name: self._pairs.get(name, {}) for name in members}
        return tuple(
            tuple(round(row.get(whom, 0.0), 2) for whom in members) for row in self._pairs.values()
        )


def _names_of(members: Sequence[Member]) -> list[str]:
    """The names of members; who bears the name of one on a lower seat is told with its own."""
    first = {mate.name: mate.seat for mate in sorted(members, key=lambda mate: -mate.seat)}
    return [
        mate.name if first[mate.name] == mate.seat else f"{mate.name} (seat {mate.seat})"
        for mate in members
    ]


def _names_and_late(core: ServerCore, members: Sequence[Member]) -> tuple[list[str], list[str]]:
    """The names of members, and of those of them that the others wait for."""
    names = _names_of(members)
    waits = core.stage is BarrierState.COLLECT
    return names, [
        name for name, mate in zip(names, members, strict=True) if waits and not mate.ready
    ]


class Reporter:
    """Writes `WorldStatus` lines into a pipe; one that nobody reads fills up, and is then left alone."""

    def __init__(self, pipe: int) -> None:
        """Use this descriptor; -1 says nothing to nobody."""
        self._pipe = pipe
        self.listening = ""  # the address for other machines
        self._said_s = -_EVERY_S
        self._steps_s: deque[float] = deque(maxlen=_STEPS)
        self._counts: deque[tuple[float, int]] = deque(maxlen=_RATES)
        self._holdups = _Stragglers()
        if pipe >= 0:
            os.set_blocking(pipe, False)

    def loading(self) -> None:
        """The world is not there yet."""
        self._say(WorldStatus(stage="loading"))

    def failed(self, error: WcsimError) -> None:
        """There is no world, or no more; the line is a `Failure`."""
        self._write(msgspec.json.encode(failure_of(error)) + b"\n")

    def saw(self, core: ServerCore, event: Event, now_s: float, stepped_s: float) -> None:
        """An event was dealt with: note how long the step was, and who is waited for from now on."""
        if stepped_s > 0.0:
            self._steps_s.append(stepped_s)
            self._holdups.saw(
                (), (), now_s - stepped_s
            )  # the last one's action and the step are one event
        acted = isinstance(event, Received) and isinstance(event.message, Act)
        if acted or stepped_s > 0.0 or isinstance(event, Clock):
            names, late = _names_and_late(core, core.roll.members)
            self._holdups.saw(names, late, now_s)

    def report(self, core: ServerCore, hub: WorldHost, now_s: float) -> None:
        """Say how things are, when it is time to."""
        real_s = time.monotonic()
        if real_s - self._said_s < _EVERY_S or self._pipe < 0:
            return
        self._said_s = real_s
        self._counts.append((real_s, hub.ticks))
        members = core.roll.by_seat()
        names, late = _names_and_late(core, members)
        master = core.roll.master
        owing = (
            [mate for mate in members if not mate.ready]
            if core.stage is BarrierState.COLLECT
            else []
        )
        self._say(
            WorldStatus(
                stage=core.stage.value,
                epoch=core.epoch,
                tick=core.tick,
                ticks=hub.ticks,
                ticks_per_s=self._rate(),
                step_ms=1e3 * statistics.median(self._steps_s) if self._steps_s else 0.0,
                members=tuple(names),
                master="" if master is None else names[members.index(master)],
                late=tuple(late),
                late_s=max((now_s - mate.asked_s for mate in owing), default=0.0),
                rss_mb=rss_mb(),
                held=self._holdups.held(names),
                waited_s=self._holdups.waited(names),
                listening=self.listening,
            )
        )

    def _rate(self) -> float:
        (begun_s, first), (ended_s, last) = self._counts[0], self._counts[-1]
        return (last - first) / (ended_s - begun_s) if ended_s > begun_s else 0.0

    def _say(self, status: WorldStatus) -> None:
        self._write(to_line(status))

    def _write(self, line: bytes) -> None:
        if self._pipe >= 0:
            with contextlib.suppress(BlockingIOError, BrokenPipeError):
                os.write(self._pipe, line)
