"""A client's own record of what it has seen: half of the proof that no step was lost or done twice.

It is a log with one record a frame. `audit_ledgers` compares ledgers with a world's journal.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from wcsim.log.reader import LogScan
from wcsim.log.records import Header, Input, SeenFrame, Ticked
from wcsim.log.writer import LogWriter


def open_ledger_writer(path: Path, client: str) -> LogWriter:
    """Start a client's ledger, or go on with that of its last process.

    Raises what `LogWriter` raises.
    """
    if path.exists():
        return LogWriter.append_to(path, "ledger")
    return LogWriter(
        path, Header(town="", seed=0, seats=0, tick_s=1.0, fingerprint="", client=client)
    )


def iter_ledger_frames(path: Path) -> Iterator[SeenFrame]:
    """What a client saw, up to the last whole record; the client may be writing it.

    Raises:
        JournalError: It is no ledger, or damaged before its end.
    """
    return (record for record in LogScan(path, "ledger").records() if isinstance(record, SeenFrame))


@dataclass(slots=True, kw_only=True)
class LedgerAuditResult:
    """A ledger, by itself and against its world's journal; or the ledgers of all clients."""

    ticks: int = 0  # of the world, in the audit of all clients
    lost: int = 0  # steps of a client that are in the journal and that it never saw
    doubled: int = 0  # steps that a client saw more than once
    phantom: int = 0  # steps that a client saw and the journal does not have
    first_tick: int = -1  # of the client's first frame, -1 when it never had one
    last_tick: int = -1  # of its last one
    steps: int = 0
    missing: int = 0  # ticks between two frames of one life that were not seen


def audit_ledgers(
    records: Iterable[Input], ledgers: Sequence[tuple[int, Iterable[SeenFrame]]]
) -> tuple[LedgerAuditResult, tuple[LedgerAuditResult, ...]]:
    """Compare a journal with (seat, ledger) of each client: the faults of all, and of each.

    Only the very last step of a life may be missing from a ledger: its client acted, and died
    before it saw the frame. No more than one epoch is in memory at a time.
    """
    readers = [_LedgerReader(seat, entries) for seat, entries in ledgers]
    ticks = 0
    ticked = (record for record in records if isinstance(record, Ticked))
    for epoch, group in groupby(ticked, key=lambda record: record.epoch):
        done: dict[int, set[int]] = {reader.seat: set() for reader in readers}
        for record in group:
            ticks += 1
            for command in record.commands:
                if command.seat in done:
                    done[command.seat].add(record.tick)
        for reader in readers:
            reader.compare(epoch, done[reader.seat])
    for reader in readers:
        reader.compare(None, set())
    each = tuple(reader.found for reader in readers)
    total = LedgerAuditResult(
        ticks=ticks,
        lost=sum(one.lost for one in each),
        doubled=sum(one.doubled for one in each),
        phantom=sum(one.phantom for one in each),
    )
    return total, each


class _LedgerReader:
    """A ledger, read epoch by epoch."""

    def __init__(self, seat: int, entries: Iterable[SeenFrame]) -> None:
        self.seat = seat
        self.found = LedgerAuditResult()
        self._entries = iter(entries)
        self._next = next(self._entries, None)
        self._before: SeenFrame | None = None

    def compare(self, epoch: int | None, done: set[int]) -> None:
        """Read on to the end of an epoch, or to the end of the ledger for None.

        Args:
            epoch: The epoch.
            done: The ticks that the world did for this seat in it.
        """
        seen: set[int] = set()
        # Steps that a client may have requested before it died: one after each life's last frame.
        last_requests: set[int] = set()
        while self._next is not None and (epoch is None or self._next.epoch <= epoch):
            now, before = self._next, self._before
            # 1. What the ledger shows by itself.
            if before is None:
                self.found.first_tick = now.tick
            elif now.stepped:
                self.found.missing += max(0, now.tick - before.tick - 1)
            self.found.last_tick = now.tick
            self.found.steps += now.stepped
            # 2. What it shows against the journal. A frame without a step starts a life. Of a step
            #    in an earlier epoch the journal has no tick, or not any more.
            if not now.stepped:
                self._end_life(epoch, last_requests)
            elif now.epoch != epoch:
                self.found.phantom += 1
            else:
                self.found.doubled += now.tick in seen
                seen.add(now.tick)
            self._before = now
            self._next = next(self._entries, None)
        if self._next is None or not self._next.stepped:
            self._end_life(epoch, last_requests)
        self.found.lost += len(done - seen - last_requests)
        self.found.phantom += len(seen - done)

    def _end_life(self, epoch: int | None, last_requests: set[int]) -> None:
        if self._before is not None and self._before.epoch == epoch:
            last_requests.add(self._before.tick + 1)
