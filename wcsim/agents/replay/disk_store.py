"""Frames on disk: one zstd blob a frame in append-only segments, so that a replay memory may be larger than memory.

In memory are 16 bytes a frame, where it lies. The oldest frames go by removing the oldest segment's files. What a
checkpoint counts on is kept besides (`hold`), and whatever was written after the checkpoint that a run goes on from is
cut off. A process that was killed leaves whole frames and at most one torn one, which is cut off when the store is
opened again; `notes` tells of it.

Append-only files of numbered blobs: what a frame store on disk is made of.

A segment holds up to SEGMENT_BLOBS blobs with consecutive numbers, in two files: `segment-00000012.blobs`, one blob
after the other, and `segment-00000012.index`, a record of 28 bytes for each of them: number, offset, length and
checksum of the blob, and a checksum of the record itself. A blob is written before its record, so that a record that is
whole means a blob that is whole. Segment k holds the numbers from k * SEGMENT_BLOBS on.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import struct
import zlib
from collections import OrderedDict
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import zstandard

from wcsim.agents.replay.blob import BlobCodec
from wcsim.core import files
from wcsim.core.reading import FileKind, read_json, shown
from wcsim.errors import DiskFullError, PolicyError
from wcsim.types import I64, U8, Bool

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


def _sound_records(folder: Path, segment: int) -> Records:
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


def _cut_segment(folder: Path, segment: int, records: Records) -> int:
    """Shorten a segment to these records, its first ones; returns how many bytes were behind them."""
    wanted = {index_path(folder, segment): records.nbytes, blobs_path(folder, segment): _end(records)}
    torn = 0
    for path, size in wanted.items():
        torn += path.stat().st_size - size if path.exists() else 0
        if path.exists() and path.stat().st_size != size:
            os.truncate(path, size)
    return torn


def _drop_segment(folder: Path, segment: int) -> None:
    """Remove a segment; the index goes first, so that a kill in between leaves no record without a blob."""
    index_path(folder, segment).unlink(missing_ok=True)
    blobs_path(folder, segment).unlink(missing_ok=True)


def _sync_segment(folder: Path, segment: int) -> None:
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


class _SegmentWriter:
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


class _SegmentReader:
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


STORE_JSON: Final = "store.json"
VERSION: Final = 1
_KIND = FileKind(what="the description of a replay on disk", limit_bytes=1 << 16, error=PolicyError)


class DiskFrames:
    """The last `steps` steps of every seat, in a folder of its own; one process at a time has it open.

    Frames are numbered in the order in which they are written: step by step, seat by seat.
    """

    def __init__(self, folder: Path, steps: int, seats: int, size: int, layout: str = "", smooth: int = 0) -> None:
        """Open the store in `folder`, or make one.

        Args:
            folder: Where; it is made when it is not there.
            steps: Of so many the frames can be read.
            seats: Frames of a step.
            size: Bytes of a frame.
            layout: What a frame is made of, in words; another one's store is refused.
            smooth: So many bytes at a frame's beginning are of a smooth picture, and packed better as that.

        Raises:
            PolicyError: Another process has it, or it is no store, or one of another version or layout.
            DiskFullError: It cannot be made.
        """
        self._folder, self._seats, self._size = folder, seats, size
        self._most = steps * seats
        self.notes: list[str] = []  # what was found when it was opened
        told = {"format": "wcsim replay", "version": VERSION, "segment_blobs": SEGMENT_BLOBS}
        self._told = {**told, "seats": seats, "frame_bytes": size, "smooth_bytes": smooth, "layout": layout}
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = _locked(folder)
        try:
            _require_same(folder, self._told)
            self._offset = np.zeros(self._most, dtype=np.uint64)
            self._length = np.zeros(self._most, dtype=np.uint32)  # 0 where there is none
            self._crc = np.zeros(self._most, dtype=np.uint32)
            self._codec = BlobCodec(size, smooth)
            self._reader = _SegmentReader(folder)
            self._writer: _SegmentWriter | None = None
            self._unsynced: set[int] = set()
            self._held: int | None = None
            self._next = 0
            self._mend()
            self._list()
        except BaseException:
            os.close(self._lock)
            raise

    def __enter__(self) -> DiskFrames:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close all files; the store can be opened again."""
        if self._lock < 0:
            return
        self._reader.close()
        self._end_segment()
        os.close(self._lock)
        self._lock = -1

    @property
    def next_number(self) -> int:
        """The number of the frame that is written next."""
        return self._next

    @property
    def index_bytes(self) -> int:
        """What it holds in memory, in bytes."""
        return self._offset.nbytes + self._length.nbytes + self._crc.nbytes

    def write(self, index: int, seat: int, frame: U8) -> None:
        """Append a frame (size,) of step `index`; what is there from that step and seat on is cut off first.

        Raises DiskFullError; the store is what it was then.
        """
        number = index * self._seats + seat
        if number != self._next:
            self.cut(number)
        segment = number // SEGMENT_BLOBS
        if self._writer is None or self._writer.segment != segment:
            self._end_segment()
            self._writer = _SegmentWriter(self._folder, segment)
            self._unsynced.add(segment)
            self._drop_old()
        blob = self._codec.pack(frame)
        at = number % self._most
        self._offset[at], self._crc[at] = self._writer.append(number, blob)
        self._length[at] = len(blob)
        self._next = number + 1

    def read(self, index: I64, seats: I64) -> U8:
        """Copies of frames of these steps, (K,) and (K,) -> (K, size); one that is not there reads as zeros.

        Raises PolicyError when one is not what was written.
        """
        out = np.zeros((len(index), self._size), dtype=np.uint8)
        for row, number in enumerate((index * self._seats + seats).tolist()):
            if max(0, self._next - self._most) <= number < self._next and self._length[number % self._most] > 0:
                out[row] = self._frame(number)
        return out

    def hold(self, number: int | None) -> None:
        """Keep the frames from this number on for a checkpoint, whatever else is forgotten; None holds nothing."""
        self._held = number
        self._drop_old()

    def cut(self, number: int) -> None:
        """Forget the frames from this number on; all of them when it is not there to go on from."""
        self._end_segment()
        self._reader.close()
        gap = number > self._next
        for segment in segments_in(self._folder):
            first = segment * SEGMENT_BLOBS
            if gap or first >= number:
                _drop_segment(self._folder, segment)
            elif first + SEGMENT_BLOBS > number:
                records = _sound_records(self._folder, segment)
                _cut_segment(self._folder, segment, records[records["number"] < number])
        self._list()
        self._next = number

    def seal(self, first: int, stop: int) -> int:
        """A checksum over all frames with these numbers, by which a checkpoint knows them again.

        Raises PolicyError when not all of them are there.
        """
        at = np.arange(first, stop) % self._most
        crc, there = self._crc[at], self._length[at] > 0
        if first < self._next - self._most or stop > self._next:  # of a checkpoint before the newest frames
            crc, there = self._listed(first, stop)
        if not there.all():
            raise PolicyError(
                f"the replay in {shown(self._folder)} lacks {int((~there).sum())} of the frames {first} to {stop} that "
                "were saved; expected all of them: restore its folder, or start a new run"
            )
        return zlib.crc32(crc.tobytes())

    def sync(self) -> None:
        """Flush what was written to disk; until then a loss of power, not the end of a process, may lose it."""
        for segment in sorted(self._unsynced):
            _sync_segment(self._folder, segment)
        self._unsynced = set() if self._writer is None else {self._writer.segment}

    def _frame(self, number: int) -> U8:
        at, segment = number % self._most, number // SEGMENT_BLOBS
        try:
            blob = self._reader.read(segment, int(self._offset[at]), int(self._length[at]))
            if zlib.crc32(blob) != int(self._crc[at]):
                raise ValueError("another checksum")
            return self._codec.unpack(blob)
        except (OSError, ValueError, zstandard.ZstdError) as error:
            raise PolicyError(
                f"{shown(blobs_path(self._folder, segment))}: frame {number} is damaged ({error}); expected what was "
                "written: restore the file, or start a new run"
            ) from None

    def _listed(self, first: int, stop: int) -> tuple[npt.NDArray[np.uint32], Bool]:
        """Checksums of these frames, and which of them are there, as the files say."""
        crc, there = np.zeros(stop - first, dtype=np.uint32), np.zeros(stop - first, dtype=bool)
        for segment in segments_in(self._folder):
            if (segment + 1) * SEGMENT_BLOBS > first and segment * SEGMENT_BLOBS < stop:
                records = _sound_records(self._folder, segment)
                numbers = records["number"].astype(np.int64)
                wanted = (numbers >= first) & (numbers < stop)
                crc[numbers[wanted] - first], there[numbers[wanted] - first] = records["crc"][wanted], True
        return crc, there

    def _list(self) -> None:
        """Take up where the frames lie, the last ones that can be read."""
        self._length[:] = 0
        self._next = 0
        for segment in reversed(segments_in(self._folder)):  # the newest one first: it says which is the oldest frame
            records = _sound_records(self._folder, segment)
            numbers = records["number"].astype(np.int64)
            if self._next == 0 and len(records):
                self._next = int(numbers[-1]) + 1
            if (segment + 1) * SEGMENT_BLOBS <= self._next - self._most:
                return
            kept = numbers >= self._next - self._most
            at = numbers[kept] % self._most
            for held, name in ((self._offset, "offset"), (self._length, "length"), (self._crc, "crc")):
                held[at] = records[name][kept]

    def _mend(self) -> None:
        """Cut off what a killed process left torn at the end."""
        segments = segments_in(self._folder)
        if not segments:
            return
        records = self._whole(segments[-1], _sound_records(self._folder, segments[-1]))
        self._reader.close()
        torn = _cut_segment(self._folder, segments[-1], records)
        if torn:
            name = blobs_path(self._folder, segments[-1])
            self.notes.append(f"{name}: {torn} bytes of a truncated frame were removed; all others are intact")

    def _whole(self, segment: int, records: Records) -> Records:
        """The records up to the first one whose blob is not what was written, as after a loss of power."""
        for row, (_, offset, length, crc, _) in enumerate(records.tolist()):
            if zlib.crc32(self._reader.read(segment, offset, length)) != crc:
                return records[:row]
        return records

    def _drop_old(self) -> None:
        floor = self._next - self._most
        if self._held is not None:
            floor = min(floor, self._held)
        for segment in segments_in(self._folder):
            if (segment + 1) * SEGMENT_BLOBS > floor:
                return
            self._reader.forget(segment)
            _drop_segment(self._folder, segment)

    def _end_segment(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def _locked(folder: Path) -> int:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise PolicyError(
            f"the replay in {shown(folder)} is open in another process; wait for its end, or choose another --out"
        ) from None
    except OSError:  # a file system without locks
        pass
    return descriptor


def _require_same(folder: Path, told: dict[str, Any]) -> None:
    """Write down what the store holds, or refuse one that holds something else."""
    path = folder / STORE_JSON
    if not path.exists():
        if any(not files.is_begun(each) for each in folder.iterdir()):
            raise PolicyError(
                f"{shown(folder)} has files but no {STORE_JSON}; expected a replay or an empty folder: restore it, or "
                "start a new run"
            )
        files.write_json(path, told)
        return
    found = read_json(path, _KIND)
    other = sorted(key for key in {*told, *found} if found.get(key) != told.get(key))
    if other:
        differ = ", ".join(f"{key} {shown(found.get(key), 80)} instead of {shown(told.get(key), 80)}" for key in other)
        raise PolicyError(
            f"{shown(path)} is of a replay with {differ}; expected its own configuration and version: use them, or "
            "start a new run"
        )
