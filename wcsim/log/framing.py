"""The framing of a log: a file of records, each `length, CRC-32, zlib payload`.

What was written whole is read whole: reading ends before the first record that is torn or damaged, so a file may be
read while another process appends to it. A record's CRC begins with that of the one before, so that none can be left
out, doubled or moved. A zlib stream says itself where it ends: damage to a length is told from a record that was only
begun.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

MAX_RECORD_BYTES = 256 << 20  # of a payload; one tick of any town takes less
MOST_TORN_BYTES = 1 << 16  # of a last record; more than this is no torn record
_MOST_RATIO, _FREE_BYTES = (
    100,
    1 << 12,
)  # unpacked against packed; sound records come to less than 10
_MOST_PIECES = 1 << 8  # of 64 KiB, unpacked in all looks at a torn end; a sound one has some 10
_FRAME = struct.Struct("<II")
_LEVEL = 6
_STREAM = b"\x78\x9c"  # how a zlib stream of that level begins


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A payload, and where its record ends in the file."""

    payload: bytes
    end: int  # bytes from where the reading began
    crc: int  # as it stands in the file


def framed(payload: bytes, after: int = 0) -> bytes:
    """A payload as the record that holds it; `after` is the CRC of the record before it."""
    packed = zlib.compress(payload, _LEVEL)
    return _FRAME.pack(len(packed), zlib.crc32(packed, after)) + packed


def crc_of(record: bytes) -> int:
    """The CRC that stands in a framed record."""
    crc: int = _FRAME.unpack_from(record)[1]
    return crc


def whole_records(file: BinaryIO, after: int = 0) -> Iterator[Record]:
    """The records from here on, up to the end or to the first one that is torn or damaged.

    Args:
        file: Open for reading.
        after: The CRC of the record before.
    """
    end = 0
    while len(head := file.read(_FRAME.size)) == _FRAME.size:
        size, crc = _FRAME.unpack(head)
        packed = file.read(size) if size <= MAX_RECORD_BYTES else b""
        payload = (
            _unpacked(packed) if len(packed) == size and zlib.crc32(packed, after) == crc else None
        )
        if payload is None:
            return
        end += _FRAME.size + size
        after = crc
        yield Record(payload=payload, end=end, crc=crc)


def torn_bytes(file: BinaryIO, end: int, after: int = 0) -> int | None:
    """How many bytes after the last whole record were never a whole one; None when they may have been.

    Zeros are what a file system leaves where it had no time to write. The answer is -1 when there is a whole record by
    now, as another process is writing.

    Args:
        file: Open for reading.
        end: Where the last whole record ends.
        after: As for `whole_records`.
    """
    file.seek(end)
    rest = file.read(MOST_TORN_BYTES + 1)
    if not rest:  # what another process writes from here on is for the next look
        return 0
    if next(whole_records(io.BytesIO(rest), after), None) is not None:
        return -1
    size = file.seek(0, os.SEEK_END) - end
    if not any(rest):
        file.seek(end)
        return (
            size if all(not any(part) for part in iter(lambda: file.read(1 << 20), b"")) else None
        )
    told = _FRAME.unpack_from(rest)[0] + _FRAME.size if len(rest) >= _FRAME.size else len(rest)
    return (
        None if len(rest) > MOST_TORN_BYTES or told < len(rest) or _hides_a_record(rest) else size
    )


def _hides_a_record(rest: bytes) -> bool:
    """Whether the whole content of a record lies anywhere in these bytes.

    Where that takes more than `_MOST_PIECES` to know, the answer is yes: what may be a record is never cut off.
    """
    pieces, at = 0, rest.find(_STREAM)
    while at >= 0:
        unzip, packed, full = zlib.decompressobj(), rest[at:], True
        while full and pieces < _MOST_PIECES:
            pieces += 1
            try:
                full = len(unzip.decompress(packed, MOST_TORN_BYTES)) == MOST_TORN_BYTES
            except zlib.error:
                break
            packed = unzip.unconsumed_tail
        if unzip.eof or pieces == _MOST_PIECES:
            return True
        at = rest.find(_STREAM, at + 1)
    return False


def _unpacked(packed: bytes) -> bytes | None:
    """The payload; None for what no writer here packed, which may want to fill the memory."""
    unzip = zlib.decompressobj()
    try:
        payload = unzip.decompress(
            packed, min(MAX_RECORD_BYTES, _FREE_BYTES + _MOST_RATIO * len(packed))
        )
    except zlib.error:
        return None
    return payload if unzip.eof else None
