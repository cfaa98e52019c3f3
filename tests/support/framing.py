"""Files of records made by hand, as no writer would make them."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

from wcsim.users.recording.framing import crc_of, framed, whole_records


def chained(payloads: Iterable[bytes], after: int = 0) -> bytes:
    """Payloads as chained records, as a journal of this version holds them."""
    records = []
    for payload in payloads:
        records.append(framed(payload, after))
        after = crc_of(records[-1])
    return b"".join(records)


def last_crc(path: Path) -> int:
    """The CRC of the last record of a chained file."""
    with path.open("rb") as file:
        return [record.crc for record in whole_records(file, 0)][-1]


def record_ends(path: Path, after: int | None = 0) -> list[int]:
    """Where the records of a file end; `after` None for one that is not chained."""
    with path.open("rb") as file:
        return [record.end for record in whole_records(file, after)]


def pieces(path: Path, after: int | None = 0) -> list[bytes]:
    """The records of a file as they lie there."""
    data = path.read_bytes()
    return [data[begin:end] for begin, end in pairwise([0, *record_ends(path, after)])]
