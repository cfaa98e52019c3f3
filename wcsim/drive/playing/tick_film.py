"""A film: packed states of all ticks, sums and marks; the oldest go when it gets too large.

An hour of a chair in Helsinki takes some 10 MB (docs/watching.md).
"""

import math
from collections import deque
from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Final, NamedTuple

import msgspec
import numpy as np
import zstandard

from wcsim.drive.driven import happened_in
from wcsim.drive.playing.film_states import FilmAbout, FilmChair, FilmFrame
from wcsim.errors import ProtocolError
from wcsim.physics.renderer.instances import ChairPose
from wcsim.supervisor.actions import MAX_DISTANCE
from wcsim.supervisor.kpi import KpiTotals
from wcsim.view.street_pictures import Moment

MOST_BYTES: Final = 512 << 20
MOST_MARKS: Final = 4000
_BLOCK: Final = 128  # ticks that are packed together
_OPEN: Final = 6  # blocks that are kept unpacked
_LEVEL: Final = 3
# Kinds of marks, by what they count.
_MARKS: Final = {
    "crashes": "crash",
    "drops": "drop",
    "arrivals": "arrival",
    "given_up": "gave-up",
    "helps": "help",
    "warnings": "warning",
    "interventions": "intervention",
}


class _FilmTick(msgspec.Struct, frozen=True, array_like=True):
    """A frame with the sums of its chairs after it."""

    frame: FilmFrame
    sums: dict[int, KpiTotals]


_TICKS: Final = msgspec.msgpack.Decoder(list[_FilmTick])


class _FilmMark(NamedTuple):
    """Something on the time line."""

    at: int  # number of the frame
    seat: int  # -1 for all
    kind: str  # crash, drop, intervention, warning, arrival, gave-up, help, gap
    told: str


class TickFilm:
    """All frames of a source, by number from 0 on; `first` is the oldest that is still there.

    Args:
        about: What it is of.
        most_bytes: That frames may take, packed.
    """

    def __init__(self, about: FilmAbout, most_bytes: int = MOST_BYTES) -> None:
        self.about, self._most_bytes = about, most_bytes
        self.first = self.count = 0
        self.packed_bytes = 0
        self.marks = deque[_FilmMark](maxlen=MOST_MARKS)
        self.marked = 0  # ever
        self._blocks: dict[int, bytes] = {}
        self._newest: list[_FilmTick] = []
        self._unpacked = lru_cache(_OPEN)(partial(_unpacked, self._blocks))
        self._sums: dict[int, KpiTotals] = {}
        self._alone: dict[int, int] = {}  # ticks of an episode before its handover, by seat

    @property
    def span(self) -> range:
        """The frames that are there."""
        return range(self.first, self.count)

    @property
    def there(self) -> list[_FilmMark]:
        """The marks of the frames that are there."""
        return [mark for mark in self.marks if mark.at >= self.first]

    def add(self, frame: FilmFrame) -> None:
        """Add the frame of the next tick."""
        for chair in frame.chairs:
            self._count(chair)
        self._newest.append(
            _FilmTick(frame, {chair.seat: self._sums[chair.seat] for chair in frame.chairs})
        )
        self.count += 1
        if len(self._newest) < _BLOCK:
            return
        # The block is full: pack it, and drop the oldest blocks when all of them are too large.
        packed = zstandard.ZstdCompressor(level=_LEVEL).compress(
            msgspec.msgpack.encode(self._newest)
        )
        self._blocks[self.count // _BLOCK - 1] = packed
        self.packed_bytes += len(packed)
        self._newest = []
        while self.packed_bytes > self._most_bytes and len(self._blocks) > 1:
            oldest = next(iter(self._blocks))
            self.packed_bytes -= len(self._blocks.pop(oldest))
            self.first = (oldest + 1) * _BLOCK

    def mark(self, kind: str, told: str) -> None:
        """Mark the place where the next frame will be, for all chairs."""
        self._note(_FilmMark(self.count, -1, kind, told))

    def shot(self, at: int) -> _FilmTick:
        """A frame. Raises ProtocolError for a number that is not there."""
        if at not in self.span:
            raise ProtocolError(
                f"the film has no step {at}; expected {self.first} to {self.count - 1}"
            )
        block, row = divmod(at, _BLOCK)
        if block == self.count // _BLOCK:
            return self._newest[row]
        return self._unpacked(block)[row]

    def moment(self, at: int, seat: int, jumped: bool) -> Moment | None:
        """What there is to draw of a frame for a chair; None when that chair is not in it."""
        frame = self.shot(at).frame
        chair = next((each for each in frame.chairs if each.seat == seat), None)
        if chair is None:
            return None
        return Moment(
            actors=frame.actors,
            signals=frame.signals,
            chairs=tuple(
                ChairPose(
                    seat=each.seat,
                    p_WB_m=np.array(each.p_WB_m),
                    q_WB=np.array(each.q_WB),
                    outline=each.outline,
                )
                for each in frame.chairs
            ),
            seat=seat,
            jumped=jumped or chair.step == 1,
            route=frame.route(seat),
            done_m=chair.done_m,
        )

    def _count(self, chair: FilmChair) -> None:
        """Mark and count what a chair did; as in a test, nothing before a handover counts."""
        seat, happened = chair.seat, happened_in(chair)
        before = self._sums.get(seat, KpiTotals())
        started = before.starting(happened)
        for name, kind in _MARKS.items():
            # A fall is one mark: a drop, and not a crash too.
            if name in started and not (kind == "crash" and "drops" in started):
                told = chair.reason if kind in ("crash", "drop") else ""
                self._note(_FilmMark(self.count, seat, kind, told))
        alone = (0 if chair.step == 1 else self._alone.get(seat, 0)) + chair.alone
        steps = chair.step - alone if chair.step >= 0 else before.steps + (not chair.alone)
        # Between the user's stick and the chair's, KPI 1's; None where one of them is not known.
        distance = None
        if not (chair.alone or chair.stick is None or chair.commanded is None):
            distance = min(math.dist(chair.stick, chair.commanded), MAX_DISTANCE)
        after = before.plus(happened, distance, chair.speed_mps, steps)
        ends = chair.crashed or chair.truncated
        self._alone[seat], self._sums[seat] = (0, after.after_episode()) if ends else (alone, after)

    def _note(self, mark: _FilmMark) -> None:
        self.marks.append(mark)
        self.marked += 1


def _unpacked(blocks: Mapping[int, bytes], block: int) -> list[_FilmTick]:
    return _TICKS.decode(zstandard.ZstdDecompressor().decompress(blocks[block]))
