"""Append-only files of numbered blobs: what a frame store on disk is made of.

A segment holds up to SEGMENT_BLOBS blobs with consecutive numbers, in two files: `segment-00000012.blobs`, one blob
after the other, and `segment-00000012.index`, a record of 28 bytes for each of them: number, offset, length and
checksum of the blob, and a checksum of the record itself. A blob is written before its record, so that a record that is
whole means a blob that is whole. Segment k holds the numbers from k * SEGMENT_BLOBS on.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
import zlib
from collections import OrderedDict
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from wcsim.errors import DiskFullError

SEGMENT_BLOBS: Final = 4096
RECORD: Final = np.dtype([("number", "<u8"), ("offset", "<u8"), ("length", "<u4"), ("crc", "<u4"), ("seal", "<u4")])
_FIELDS: Final = struct.Struct("<QQII")
_SEAL: Final = struct.Struct("<I")
_INDEX: Final = re.compile(r"segment-(\d{8,12})\.index")
_MOST_OPEN: Final = 64  # files that are kept open for reading

Records = npt.NDArray[np.void]


def blobs_path(folder: Path, segment: int) -> Path:
    """The file of a segment's blobs."""
    return folder / f"segment-{segment:08d}.blobs"


def index_path(folder: Path, segment: int) -> Path:
    """The file of a segment's records."""
    return folder / f"segment-{segment:08d}.index"


def segments_in(folder: Path) -> list[int]:
    """Numbers of the segments of which there is an index, in order."""
    found = (_INDEX.fullmatch(path.name) for path in folder.iterdir())
    return sorted(int(match[1]) for match in found if match)


def sound_records(folder: Path, segment: int) -> Records:
    """The records of a segment up to the first one that is torn, damaged, out of order or without its blob.

    Whether the blobs are what they were is asked when they are read.
    """
    try:
        data = index_path(folder, segment).read_bytes()
        held = blobs_path(folder, segment).stat().st_size
    except FileNotFoundError:
        return np.zeros(0, RECORD)
    records = np.frombuffer(data, RECORD, count=len(data) // RECORD.itemsize)
    size, body = RECORD.itemsize, _FIELDS.size
    seals = (zlib.crc32(data[at : at + body]) for at in range(0, len(records) * size, size))
    good = records["seal"] == np.fromiter(seals, np.uint32, len(records))
    numbers, ends = records["number"].astype(np.int64), (records["offset"] + records["length"]).astype(np.int64)
    in_order = numbers == (numbers[0] if len(numbers) else 0) + np.arange(len(numbers))
    begins = np.concatenate([[0], ends[:-1]]) if len(ends) else ends
    good &= in_order & (numbers // SEGMENT_BLOBS == segment) & (records["offset"] == begins) & (ends <= held)
    return records[: len(good) if good.all() else int(good.argmin())]


def cut_segment(folder: Path, segment: int, records: Records) -> int:
    """Shorten a segment to these records, its first ones; returns how many bytes were behind them."""
    wanted = {index_path(folder, segment): records.nbytes, blobs_path(folder, segment): _end(records)}
    torn = 0
    for path, size in wanted.items():
        torn += path.stat().st_size - size if path.exists() else 0
        if path.exists() and path.stat().st_size != size:
            os.truncate(path, size)
    return torn


def drop_segment(folder: Path, segment: int) -> None:
    """Remove a segment; the index goes first, so that a kill in between leaves no record without a blob."""
    index_path(folder, segment).unlink(missing_ok=True)
    blobs_path(folder, segment).unlink(missing_ok=True)


def sync_segment(folder: Path, segment: int) -> None:
    """Flush a segment's files, where they still are, to disk."""
    for path in (blobs_path(folder, segment), index_path(folder, segment)):
        with contextlib.suppress(FileNotFoundError):
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def _end(records: Records) -> int:
    return int(records["offset"][-1] + records["length"][-1]) if len(records) else 0


class SegmentWriter:
    """Appends to one segment, whose files may be there already, cut to whole records."""

    def __init__(self, folder: Path, segment: int) -> None:
        """Open it, or begin it. Raises DiskFullError; nothing is open then."""
        self.segment, self._folder = segment, folder
        with contextlib.ExitStack() as opened:
            try:
                self._blobs = _opened(blobs_path(folder, segment), opened)
                self._index = _opened(index_path(folder, segment), opened)
                self._records = os.fstat(self._index).st_size
                if self._records == 0:  # blobs without an index are nobody's
                    os.ftruncate(self._blobs, 0)
                self._at = os.fstat(self._blobs).st_size
            except OSError as error:
                raise self._full(error) from None
            opened.pop_all()

    def append(self, number: int, blob: bytes) -> tuple[int, int]:
        """Write a blob; returns its offset and checksum. Raises DiskFullError; the segment is what it was then."""
        offset, crc = self._at, zlib.crc32(blob)
        body = _FIELDS.pack(number, offset, len(blob), crc)
        try:
            _write(self._blobs, blob)
            _write(self._index, body + _SEAL.pack(zlib.crc32(body)))
        except OSError as error:
            os.ftruncate(self._index, self._records)
            os.ftruncate(self._blobs, self._at)
            raise self._full(error) from None
        self._at, self._records = offset + len(blob), self._records + RECORD.itemsize
        return offset, crc

    def close(self) -> None:
        """Close both files."""
        os.close(self._blobs)
        os.close(self._index)

    def _full(self, error: OSError) -> DiskFullError:
        return DiskFullError(
            f"{blobs_path(self._folder, self.segment)}: could not be written ({error.strerror}); make room "
            "and --resume, or start a new run with a smaller learn.replay_frames"
        )


class SegmentReader:
    """Reads blobs of the segments in a folder, and keeps a few of their files open."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._open: OrderedDict[int, int] = OrderedDict()

    def read(self, segment: int, offset: int, length: int) -> bytes:
        """The bytes there, fewer when the file is shorter. Raises OSError when there is no such file."""
        if segment not in self._open:
            while len(self._open) >= _MOST_OPEN:
                os.close(self._open.popitem(last=False)[1])
            self._open[segment] = os.open(blobs_path(self._folder, segment), os.O_RDONLY | os.O_CLOEXEC)
        self._open.move_to_end(segment)
        return os.pread(self._open[segment], length, offset)

    def forget(self, segment: int) -> None:
        """Close what is open of a segment."""
        if segment in self._open:
            os.close(self._open.pop(segment))

    def close(self) -> None:
        """Close all files."""
        while self._open:
            os.close(self._open.popitem()[1])


def _opened(path: Path, held: contextlib.ExitStack) -> int:
    """A file to append to, closed with `held`."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
    held.callback(os.close, descriptor)
    return descriptor


def _write(descriptor: int, data: bytes) -> None:
    left = memoryview(data)
    while left:
        left = left[os.write(descriptor, left) :]
