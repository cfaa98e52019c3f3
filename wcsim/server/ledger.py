"""A client's own record of what it has seen: the other half of the proof that no step was lost or done twice.

It is a log with one record a frame. `audit` compares ledgers with a world's journal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from wcsim.log.reader import LogScan
from wcsim.log.records import Header, Input, SeenFrame, Ticked
from wcsim.log.writer import LogWriter


def open_ledger(path: Path, client: str) -> LogWriter:
    """Begin a client's ledger, or go on with that of its earlier life. Raises what `LogWriter` raises."""
    if path.exists():
        return LogWriter.append_to(path, "ledger")
    return LogWriter(
        path, Header(town="", seed=0, seats=0, tick_s=1.0, fingerprint="", client=client)
    )


def iter_ledger(path: Path) -> Iterator[SeenFrame]:
    """What a client saw, up to the last whole record; it may be writing it.

    Raises:
        JournalError: It is no ledger, or damaged before its end.
    """
    return (record for record in LogScan(path, "ledger").records() if isinstance(record, SeenFrame))


@dataclass(slots=True, kw_only=True)
class Audit:
    """A ledger, by itself and against the journal of its world; or the ledgers of all clients together."""

    ticks: int = 0  # that the world did, where it is of all clients
    lost: int = 0  # steps of a client that are in the journal and that it never saw
    doubled: int = 0  # steps that a client saw more than once
    phantom: int = 0  # steps that a client saw and the journal does not have
    first_tick: int = -1  # of the client's first frame, -1 when it never had one
    last_tick: int = -1  # of its last one
    steps: int = 0
    missing: int = 0  # ticks between two frames of one life that were not seen


def audit(
    records: Iterable[Input], ledgers: Sequence[tuple[int, Iterable[SeenFrame]]]
) -> tuple[Audit, tuple[Audit, ...]]:
    """Compare a journal with (seat, ledger) of each client: what is wrong with all together, and with each.

    Only the very last step of a life may be missing from a ledger: its client acted, and died before it saw the frame.
    Epoch by epoch, in their order, so that no more than one of them is in memory.
    """
    pages = [_Pages(seat, entries) for seat, entries in ledgers]
    ticks, ticked = 0, (record for record in records if isinstance(record, Ticked))
    for epoch, group in groupby(ticked, key=lambda record: record.epoch):
        done: dict[int, set[int]] = {page.seat: set() for page in pages}
        for record in group:
            ticks += 1
            for command in (c for c in record.commands if c.seat in done):
                done[command.seat].add(record.tick)
        for page in pages:
            page.compare(epoch, done[page.seat])
    for page in pages:
        page.compare(None, set())
    each = tuple(page.found for page in pages)
    sums = {
        name: sum(getattr(one, name) for one in each) for name in ("lost", "doubled", "phantom")
    }
    return Audit(ticks=ticks, **sums), each


class _Pages:
    """A ledger, read epoch by epoch."""

    def __init__(self, seat: int, entries: Iterable[SeenFrame]) -> None:
        self.seat, self.found = seat, Audit()
        self._entries = iter(entries)
        self._next = next(self._entries, None)
        self._before: SeenFrame | None = None

    def compare(self, epoch: int | None, done: set[int]) -> None:
        """Read on to the end of an epoch, of all for None; `done` are the ticks that the world did for this seat."""
        seen: set[int] = set()
        ends: set[int] = (
            set()
        )  # what the dead may have asked for: one after the last frame of each life
        while self._next is not None and (epoch is None or self._next.epoch <= epoch):
            now = self._next
            self._count(now)
            if not now.stepped:
                self._end_life(epoch, ends)
            elif now.epoch != epoch:  # the journal has no tick of that one, or not any more
                self.found.phantom += 1
            else:
                self.found.doubled += now.tick in seen
                seen.add(now.tick)
            self._before, self._next = now, next(self._entries, None)
        if self._next is None or not self._next.stepped:
            self._end_life(epoch, ends)
        self.found.lost += len(done - seen - ends)
        self.found.phantom += len(seen - done)

    def _count(self, now: SeenFrame) -> None:
        """What the ledger shows by itself."""
        found = self.found
        if self._before is None:
            found.first_tick = now.tick
        elif now.stepped:
            found.missing += max(0, now.tick - self._before.tick - 1)
        found.last_tick, found.steps = now.tick, found.steps + now.stepped

    def _end_life(self, epoch: int | None, ends: set[int]) -> None:
        if self._before is not None and self._before.epoch == epoch:
            ends.add(self._before.tick + 1)
