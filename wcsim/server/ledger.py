"""A client's own record of what it has seen: the other half of the proof that no step was lost or done twice.

One entry a frame. `audit` compares the ledgers of clients with a world's journal.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import FileIO
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Self

from wcsim.errors import DiskFullError, WcsimError
from wcsim.server.journal_records import JournalRecord, Ticked

_ENTRY = struct.Struct("<16siqi")  # session, epoch, tick, stepped


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerEntry:
    """One frame that a client has seen."""

    session: bytes
    epoch: int
    tick: int
    stepped: bool  # it came of the client's own action, not of a join, a respawn or a new epoch


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerFacts:
    """What a ledger shows by itself."""

    first_tick: int  # of the first frame, -1 when the client never had one
    last_tick: int  # of the last one
    ticks: int  # steps
    missing: int  # ticks between two frames of one life that were not seen
    doubled: int  # steps seen more than once
    lives: int  # joins, respawns and new epochs


class LedgerWriter:
    """Appends to a ledger, which may have been begun in an earlier life; a killed process loses nothing."""

    def __init__(self, path: Path) -> None:
        """Open a ledger. Raises OSError when that is not possible."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path, self._file = path, FileIO(path, "ab")
        torn = self._file.tell() % _ENTRY.size
        if torn:
            self._file.truncate(self._file.tell() - torn)

    def add(self, entry: LedgerEntry) -> None:
        """Write one entry, or nothing of it. Raises DiskFullError."""
        data = _ENTRY.pack(entry.session, entry.epoch, entry.tick, entry.stepped)
        try:
            written = self._file.write(data) or 0
            reason = "" if written == len(data) else "only a part was written"
            if reason:  # all that follows half an entry would be read wrongly
                self._file.truncate(self._file.tell() - written)
        except OSError as error:
            reason = str(error.strerror)
        if reason:
            raise DiskFullError(f"{self._path}: an entry could not be written ({reason}); make room")

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def read_ledger(path: Path) -> tuple[LedgerEntry, ...]:
    """All whole entries of a ledger. Raises WcsimError when it cannot be read."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise WcsimError(f"{path}: cannot be read ({error.strerror}); expected a client's ledger") from None
    whole = len(data) - len(data) % _ENTRY.size
    return tuple(
        LedgerEntry(session=session, epoch=epoch, tick=tick, stepped=bool(stepped))
        for session, epoch, tick, stepped in _ENTRY.iter_unpack(data[:whole])
    )


def ledger_facts(entries: Sequence[LedgerEntry]) -> LedgerFacts:
    """Count what a ledger shows by itself; a session that was taken over goes on with the same life."""
    missing = doubled = 0
    seen: set[tuple[int, int]] = set()
    for before, now in pairwise(entries):
        if now.stepped:
            missing += max(0, now.tick - before.tick - 1)
            doubled += (now.epoch, now.tick) in seen
            seen.add((now.epoch, now.tick))
    return LedgerFacts(
        first_tick=entries[0].tick if entries else -1,
        last_tick=entries[-1].tick if entries else -1,
        ticks=sum(entry.stepped for entry in entries),
        missing=missing,
        doubled=doubled,
        lives=sum(not entry.stepped for entry in entries),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Audit:
    """The ledgers of all clients against the journal of their world."""

    ticks: int  # that the world did
    lost: int  # steps of a client that are in the journal and that it never saw
    doubled: int  # steps that a client saw more than once
    phantom: int  # steps that a client saw and the journal does not have


def audit(records: Iterable[JournalRecord], ledgers: Sequence[tuple[int, Sequence[LedgerEntry]]]) -> Audit:
    """Compare a journal with (seat, ledger) of each client.

    Only the very last step of a life may be missing from a ledger: its client acted, and died before it saw the frame.
    """
    done: dict[int, set[tuple[int, int]]] = {}
    ticks, seats = 0, {seat for seat, _ in ledgers}
    for record in records:
        if isinstance(record, Ticked):
            ticks += 1
            for command in (c for c in record.commands if c.seat in seats):
                done.setdefault(command.seat, set()).add((record.epoch, record.tick))
    lost = doubled = phantom = 0
    for seat, entries in ledgers:
        mine = done.get(seat, set())
        seen = {(entry.epoch, entry.tick) for entry in entries if entry.stepped}
        lost += len(mine - seen - _after_last_frames(entries))
        phantom += len(seen - mine)
        doubled += ledger_facts(entries).doubled
    return Audit(ticks=ticks, lost=lost, doubled=doubled, phantom=phantom)


def _after_last_frames(entries: Sequence[LedgerEntry]) -> set[tuple[int, int]]:
    """The steps that the dead may have asked for: one after the last frame of each life."""
    ends = [before for before, now in pairwise(entries) if not now.stepped]
    return {(entry.epoch, entry.tick + 1) for entry in (*ends, *entries[-1:])}
