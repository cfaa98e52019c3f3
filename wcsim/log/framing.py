"""The framing of a log: a file of records, each `length, CRC-32, zlib payload`.

Reading ends before the first record that is truncated or damaged, so a file may be read while
another process appends to it. A record's CRC begins with that of the record before, so that none
can be left out, doubled or moved. A zlib stream marks its own end: so a damaged length differs from
a record that was only started.
"""

import io
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final, Literal

MAX_RECORD_BYTES: Final = 256 << 20  # of a payload; one tick of any town takes less
MOST_TRUNCATED_BYTES: Final = 1 << 16  # of a last record; more than this is damage
# Unpacked against packed; the records of a writer come to less than 10.
_MOST_RATIO: Final = 100
_FREE_BYTES: Final = 1 << 12
# Of 64 KiB, unpacked in all looks at a truncated end; an intact one has some 10.
_MOST_PIECES: Final = 1 << 8
_FRAME: Final = struct.Struct("<II")
_LEVEL: Final = 6
_STREAM: Final = b"\x78\x9c"  # how a zlib stream of that level begins


@dataclass(frozen=True, slots=True, kw_only=True)
class FramedRecord:
    """A payload, and where its record ends in the file."""

    payload: bytes
    end: int  # bytes from where the reading began
    crc: int  # as it stands in the file


def frame_payload(payload: bytes, after: int = 0) -> bytes:
    """A payload as the record that holds it; `after` is the CRC of the record before it."""
    packed = zlib.compress(payload, _LEVEL)
    return _FRAME.pack(len(packed), zlib.crc32(packed, after)) + packed


def crc_from_record(record: bytes) -> int:
    """The CRC that stands in a framed record."""
    crc: int = _FRAME.unpack_from(record)[1]
    return crc


def iter_whole_records(file: BinaryIO, after: int = 0) -> Iterator[FramedRecord]:
    """The records from here on, up to the end or to the first that is truncated or damaged.

    Args:
        file: Open for reading.
        after: The CRC of the record before.
    """
    end = 0
    while len(head := file.read(_FRAME.size)) == _FRAME.size:
        size, crc = _FRAME.unpack(head)
        packed = file.read(size) if size <= MAX_RECORD_BYTES else b""
        if len(packed) != size or zlib.crc32(packed, after) != crc:
            return
        payload = _unpacked(packed)
        if payload is None:
            return
        end += _FRAME.size + size
        after = crc
        yield FramedRecord(payload=payload, end=end, crc=crc)


def count_truncated_bytes(
    file: BinaryIO, end: int, after: int = 0
) -> int | Literal["appended", "damaged"]:
    """How many bytes after the last whole record are a truncated one, which may be cut off.

    Zeros count as truncated: a file system leaves them where it had no time to write.

    Args:
        file: Open for reading.
        end: Where the last whole record ends.
        after: As for `iter_whole_records`.

    Returns:
        The bytes; "appended" when another process has written a whole record by now; "damaged" when
        these bytes may have been a whole record.
    """
    file.seek(end)
    rest = file.read(MOST_TRUNCATED_BYTES + 1)
    # What another process writes from here on is for the next look.
    if not rest:
        return 0
    if any(iter_whole_records(io.BytesIO(rest), after)):
        return "appended"
    size = file.seek(0, os.SEEK_END) - end
    if not any(rest):
        file.seek(end)
        while part := file.read(1 << 20):
            if any(part):
                return "damaged"
        return size
    if len(rest) > MOST_TRUNCATED_BYTES:
        return "damaged"
    # A truncated record is shorter than its length says.
    if len(rest) >= _FRAME.size and _FRAME.size + _FRAME.unpack_from(rest)[0] < len(rest):
        return "damaged"
    return "damaged" if _hides_a_record(rest) else size


def _hides_a_record(rest: bytes) -> bool:
    """Whether the whole content of a record lies anywhere in these bytes.

    Where that takes more than `_MOST_PIECES` to find out, the answer is yes: what may be a record
    is never cut off.
    """
    pieces = 0
    at = rest.find(_STREAM)
    while at >= 0:
        unzip = zlib.decompressobj()
        packed = rest[at:]
        full = True
        while full and pieces < _MOST_PIECES:
            pieces += 1
            try:
                unpacked = unzip.decompress(packed, MOST_TRUNCATED_BYTES)
            except zlib.error:
                break
            full = len(unpacked) == MOST_TRUNCATED_BYTES
            packed = unzip.unconsumed_tail
        if unzip.eof or pieces == _MOST_PIECES:
            return True
        at = rest.find(_STREAM, at + 1)
    return False


def _unpacked(packed: bytes) -> bytes | None:
    """The payload; None for what no writer here packed, which might fill the memory."""
    unzip = zlib.decompressobj()
    most = min(MAX_RECORD_BYTES, _FREE_BYTES + _MOST_RATIO * len(packed))
    try:
        payload = unzip.decompress(packed, most)
    except zlib.error:
        return None
    return payload if unzip.eof else None
