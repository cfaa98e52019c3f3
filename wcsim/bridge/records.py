"""The framing of traces and journals: a file of records, each `length, CRC-32, zlib payload`.

What was written whole is read whole: reading ends before the first record that is torn or damaged, so a file may be
read while another process appends to it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

MAX_RECORD_BYTES = 256 << 20  # of a payload; one tick of a town with a million actors takes less
_FRAME = struct.Struct("<II")


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A payload, and where its record ends in the file."""

    payload: bytes
    end: int  # bytes from where the reading began


def framed(payload: bytes) -> bytes:
    """A payload as the record that holds it."""
    packed = zlib.compress(payload, 6)
    return _FRAME.pack(len(packed), zlib.crc32(packed)) + packed


def whole_records(file: BinaryIO) -> Iterator[Record]:
    """The records from here on, up to the end or to the first one that is torn or damaged."""
    end = 0
    while len(head := file.read(_FRAME.size)) == _FRAME.size:
        size, crc = _FRAME.unpack(head)
        packed = file.read(size) if size <= MAX_RECORD_BYTES else b""
        payload = _unpacked(packed) if len(packed) == size and zlib.crc32(packed) == crc else None
        if payload is None:
            return
        end += _FRAME.size + size
        yield Record(payload=payload, end=end)


def _unpacked(packed: bytes) -> bytes | None:
    """The payload; None for what no writer here packed, which may want to fill the memory."""
    unzip = zlib.decompressobj()
    try:
        payload = unzip.decompress(packed, MAX_RECORD_BYTES)
    except zlib.error:
        return None
    return payload if unzip.eof else None
