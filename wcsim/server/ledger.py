"""A client's own record of what it has seen: the other half of the proof that no step was lost or done twice.

One entry a frame; each is sealed by a checksum that begins with that of the one before, so that damage anywhere is
noticed. Ledgers of older versions have none, and go on without. `audit` compares ledgers with a world's journal.
"""

from __future__ import annotations

import os
import stat
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import FileIO
from itertools import groupby
from pathlib import Path

from wcsim.core.closing import Closing
from wcsim.core.reading import FileKind, opened
from wcsim.errors import DiskFullError, JournalError
from wcsim.log.records import Input, Ticked
from wcsim.log.torn import keep_torn

_ENTRY = struct.Struct("<16siqI")  # session, epoch, tick, and 31 bits of checksum above one bit: stepped
_MOST_TORN_BYTES = 2 * _ENTRY.size  # less than that is cut off an end: a last entry, and a part of one
_KIND = FileKind(what="a client's ledger", limit_bytes=1 << 40, error=JournalError)


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerEntry:
    """One frame that a client has seen."""

    session: bytes
    epoch: int
    tick: int
    stepped: bool  # it came of the client's own action, not of a join, a respawn or a new epoch


@dataclass(frozen=True, slots=True, kw_only=True)
class _LedgerFacts:
    """What a ledger shows by itself."""

    first_tick: int  # of the first frame, -1 when the client never had one
    last_tick: int  # of the last one
    ticks: int  # steps
    missing: int  # ticks between two frames of one life that were not seen
    doubled: int  # steps seen more than once
    lives: int  # joins, respawns and new epochs


class LedgerWriter(Closing):
    """Appends to a ledger, which may have been begun in an earlier life; a killed process loses nothing."""

    def __init__(self, path: Path) -> None:
        """Open a ledger; a torn last entry is cut off, and kept beside it.

        Raises:
            OSError: It cannot be opened.
            JournalError: It is damaged before its end, or no regular file.
            DiskFullError: There is no room to keep what would be cut off.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC
        self._path, self._file = path, FileIO(os.open(path, flags, 0o644), "r+b")
        self.cut_bytes = 0  # of a torn end
        self._seal: int | None = 0  # of the last entry; None in a ledger without seals
        try:
            if not stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                raise JournalError(f"{path}: is not a regular file; expected a client's ledger")
            self._to_end()
        except BaseException:
            self._file.close()
            raise

    def add(self, entry: LedgerEntry) -> None:
        """Write one entry, or nothing of it. Raises DiskFullError."""
        data, seal = _packed(entry, self._seal)
        try:
            written = self._file.write(data) or 0
            reason = "" if written == len(data) else "only a part was written"
            if reason:  # all that follows half an entry would be read wrongly
                self._file.seek(-written, os.SEEK_CUR)
                self._file.truncate()
        except OSError as error:
            reason = str(error.strerror)
        if reason:
            raise DiskFullError(f"{self._path}: an entry could not be written ({reason}); make room")
        self._seal = seal

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def _to_end(self) -> None:
        """Go behind the last whole entry, and cut off what follows it."""
        scan = _Scan(self._path)
        for _ in scan.entries():
            pass
        self._seal, self.cut_bytes = scan.seal, scan.torn_bytes
        self._file.seek(scan.end)
        if scan.torn_bytes:
            keep_torn(self._path, self._file.read(min(scan.torn_bytes, _MOST_TORN_BYTES)))  # what is longer is zeros
            self._file.truncate(scan.end)
            self._file.seek(scan.end)


def _read_ledger(path: Path) -> tuple[LedgerEntry, ...]:
    """All whole entries of a ledger; its client may be writing it.

    Raises:
        JournalError: It cannot be read, or is damaged before its end.
    """
    return tuple(iter_ledger(path))


def iter_ledger(path: Path) -> Iterator[LedgerEntry]:
    """The same, one by one. Raises JournalError."""
    return _Scan(path).entries()


class _Scan:
    """One reading of a ledger; afterwards `seal` is that of the last whole entry, which ends at `end`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.end, self.torn_bytes = 0, 0
        self.seal: int | None = 0

    def entries(self) -> Iterator[LedgerEntry]:
        """All whole ones. Raises JournalError for damage before the end."""
        with opened(self._path, _KIND) as file:
            while len(data := file.read(_ENTRY.size)) == _ENTRY.size:
                entry = self._next(data)
                if entry is None:
                    break
                yield entry
            size = file.seek(0, os.SEEK_END) - self.end
            file.seek(self.end)
            rest = file.read(_MOST_TORN_BYTES)
            zeros = not any(rest) and all(not any(part) for part in iter(lambda: file.read(1 << 20), b""))
        self.torn_bytes = size
        if size >= _MOST_TORN_BYTES and not zeros:
            raise JournalError(
                f"{self._path}: is damaged at byte {self.end}; restore it from a copy, or start a new run"
            )

    def _next(self, data: bytes) -> LedgerEntry | None:
        session, epoch, tick, word = _ENTRY.unpack(data)
        if self.end == 0 and word in (0, 1):
            self.seal = None
        entry = LedgerEntry(session=session, epoch=epoch, tick=tick, stepped=bool(word & 1))
        packed, seal = _packed(entry, self.seal)
        if packed != data or (self.seal is None and not any(data)):
            return None
        self.end += _ENTRY.size
        self.seal = seal
        return entry


def _packed(entry: LedgerEntry, seal: int | None) -> tuple[bytes, int | None]:
    """An entry as bytes, and its seal; `seal` is that of the entry before, None in a ledger without any."""
    plain = _ENTRY.pack(entry.session, entry.epoch, entry.tick, entry.stepped)
    if seal is None:
        return plain, None
    seal = zlib.crc32(plain, seal) >> 1 or 1
    return _ENTRY.pack(entry.session, entry.epoch, entry.tick, seal << 1 | entry.stepped), seal


def ledger_facts(entries: Iterable[LedgerEntry]) -> _LedgerFacts:
    """Count what a ledger shows by itself; a session that was taken over goes on with the same life."""
    missing = doubled = ticks = lives = 0
    first: LedgerEntry | None = None
    before: LedgerEntry | None = None
    seen: set[int] = set()  # ticks of this epoch
    for now in entries:
        if before is None or now.epoch != before.epoch:
            seen.clear()
        if before is None:
            first = now
        elif now.stepped:
            missing += max(0, now.tick - before.tick - 1)
            doubled += now.tick in seen
            seen.add(now.tick)
        ticks, lives, before = ticks + now.stepped, lives + (not now.stepped), now
    return _LedgerFacts(
        first_tick=-1 if first is None else first.tick,
        last_tick=-1 if before is None else before.tick,
        ticks=ticks,
        missing=missing,
        doubled=doubled,
        lives=lives,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Audit:
    """The ledgers of all clients against the journal of their world."""

    ticks: int  # that the world did
    lost: int  # steps of a client that are in the journal and that it never saw
    doubled: int  # steps that a client saw more than once
    phantom: int  # steps that a client saw and the journal does not have


def audit(records: Iterable[Input], ledgers: Sequence[tuple[int, Iterable[LedgerEntry]]]) -> Audit:
    """Compare a journal with (seat, ledger) of each client.

    Only the very last step of a life may be missing from a ledger: its client acted, and died before it saw the frame.
    """
    ticks, each = audits(records, ledgers)
    return Audit(
        ticks=ticks,
        lost=sum(one.lost for one in each),
        doubled=sum(one.doubled for one in each),
        phantom=sum(one.phantom for one in each),
    )


def audits(
    records: Iterable[Input], ledgers: Sequence[tuple[int, Iterable[LedgerEntry]]]
) -> tuple[int, tuple[Audit, ...]]:
    """The same, and each ledger by itself: how many ticks the world did, and what is wrong with each.

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
    return ticks, tuple(
        Audit(ticks=ticks, lost=page.lost, doubled=page.doubled, phantom=page.phantom) for page in pages
    )


class _Pages:
    """A ledger, read epoch by epoch."""

    def __init__(self, seat: int, entries: Iterable[LedgerEntry]) -> None:
        self.seat = seat
        self.lost = self.doubled = self.phantom = 0
        self._entries = iter(entries)
        self._next = next(self._entries, None)
        self._before: LedgerEntry | None = None

    def compare(self, epoch: int | None, done: set[int]) -> None:
        """Read on to the end of an epoch, of all for None; `done` are the ticks that the world did for this seat."""
        seen: set[int] = set()
        ends: set[int] = set()  # what the dead may have asked for: one after the last frame of each life
        while self._next is not None and (epoch is None or self._next.epoch <= epoch):
            now = self._next
            if not now.stepped:
                self._end_life(epoch, ends)
            elif now.epoch != epoch:  # the journal has no tick of that one, or not any more
                self.phantom += 1
            else:
                self.doubled += now.tick in seen
                seen.add(now.tick)
            self._before, self._next = now, next(self._entries, None)
        if self._next is None or not self._next.stepped:
            self._end_life(epoch, ends)
        self.lost += len(done - seen - ends)
        self.phantom += len(seen - done)

    def _end_life(self, epoch: int | None, ends: set[int]) -> None:
        if self._before is not None and self._before.epoch == epoch:
            ends.add(self._before.tick + 1)
