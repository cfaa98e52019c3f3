"""The pictures of a seat in shared memory: the server's cameras write them in place, its client reads them there.

One file a seat. A file has two slots, for even and odd ticks, so that a frame stands while the next one is drawn; a
slot has two sets of pictures, because the tick that ends an episode takes those of the next one's first frame too.
"""

from __future__ import annotations

import mmap
import os
import secrets
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from wcsim.config import CameraConfig
from wcsim.core.reading import PICTURES, opened
from wcsim.errors import ConfigError, DiskFullError, PicturesError, ProtocolError
from wcsim.physics.buffers import Images, SeatBuffers
from wcsim.types.arrays import U8

_SLOTS = 2
MAGIC = b"wcsimpix"
VERSION = 1
MAX_CAMERAS = 64
MAX_SIDE_PX = 1 << 16
_HEAD = struct.Struct("<8sII")  # magic, version, cameras
_CAMERA = struct.Struct("<III")  # width, height, 1 with colours
_PAGE, _LINE = 4096, 64


class _Picture(NamedTuple):
    """The size of a camera's pictures."""

    width_px: int
    height_px: int
    rgb: bool

    @property
    def pixels(self) -> int:
        """How many pixels a picture has."""
        return self.width_px * self.height_px

    @property
    def parts_bytes(self) -> tuple[int, int, int]:
        """Room for the depth, the classes and the colours, each up to the next cache line."""
        return (
            _whole(4 * self.pixels),
            _whole(self.pixels),
            _whole(3 * self.pixels) if self.rgb else 0,
        )


class RingSink:
    """The server's side: where the pictures of all seats go; an `ImageSink` with slots.

    See `server/host/world_host.py`.
    """

    def __init__(self, folder: Path, seats: int, cameras: Sequence[CameraConfig]) -> None:
        """Make a new file for each seat; one of an earlier server lives on for those who still read it.

        Raises:
            ConfigError: There are more cameras, or larger ones, than a ring has places for.
            DiskFullError: There is no room for the pictures.
        """
        pictures = tuple(_Picture(c.width_px, c.height_px, c.rgb) for c in cameras)
        fault = _fault(pictures)
        if fault:
            raise ConfigError(f"cameras: {fault}; use fewer or smaller ones")
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._paths = tuple(folder / f"seat-{seat}" for seat in range(seats))
        self._buffers = tuple(_sets(_new_file(path, pictures), pictures) for path in self._paths)
        self._slot = 0

    def turn(self, tick: int) -> None:
        """The next pictures are of this tick."""
        self._slot = self.slot(tick)

    def slot(self, tick: int) -> int:
        """Where those of a tick are."""
        return tick % _SLOTS

    def buffers(self, seat: int, first: bool) -> SeatBuffers:
        """Where the next pictures of a seat go; see `ImageSink.buffers`."""
        return self._buffers[seat][_set(self._slot, first)]

    def path(self, seat: int) -> Path:
        """The file of a seat."""
        return self._paths[seat]


class RingView:
    """A client's side: the pictures of its seat, read-only; they live as long as somebody holds one of them."""

    def __init__(self, path: Path) -> None:
        """Map a seat's file.

        Raises:
            ProtocolError: It cannot be opened, as while a world is made anew.
            PicturesError: It is not one of this version; it will not be another time.
        """
        try:
            with opened(path, PICTURES) as file:
                memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ConfigError as error:
            raise ProtocolError(
                f"the pictures cannot be opened ({error}); is this the same machine?"
            ) from None
        self._sets = _sets(memory, _read_head(path, memory))

    def pictures(self, slot: int, first: bool) -> Sequence[Images]:
        """Those of a slot; see `decode_reply`."""
        if not 0 <= slot < _SLOTS:
            raise ProtocolError(f"pictures in slot {slot}; expected 0 to {_SLOTS - 1}")
        return self._sets[_set(slot, first)]


def _set(slot: int, first: bool) -> int:
    """Number of a set of pictures: a first frame, which has no step behind it, lies beside the last one before it."""
    return 2 * slot + first


def _new_file(path: Path, pictures: tuple[_Picture, ...]) -> mmap.mmap:
    """A file of its own under this name, as large as it will ever be: writing to it cannot fail later."""
    size = _PAGE + 2 * _SLOTS * sum(sum(picture.parts_bytes) for picture in pictures)
    part = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
    try:
        number = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            os.posix_fallocate(number, 0, size)
            memory = mmap.mmap(number, size)
        finally:
            os.close(number)
        _write_head(memory, pictures)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise DiskFullError(
            f"{path}: no room for {size} bytes of pictures ({error.strerror}); make room"
        ) from None
    return memory


def _write_head(memory: mmap.mmap, pictures: tuple[_Picture, ...]) -> None:
    _HEAD.pack_into(memory, 0, MAGIC, VERSION, len(pictures))
    for number, picture in enumerate(pictures):
        at = _HEAD.size + number * _CAMERA.size
        _CAMERA.pack_into(memory, at, *picture)


def _read_head(path: Path, memory: mmap.mmap) -> tuple[_Picture, ...]:
    if len(memory) < _PAGE:
        raise PicturesError(
            f"{path}: is not a shared memory of pictures; expected at least {_PAGE} bytes"
        )
    magic, version, count = _HEAD.unpack_from(memory)
    if (magic, version) != (MAGIC, VERSION):
        raise PicturesError(
            f"{path}: starts with {magic!r}, version {version}; expected {MAGIC!r}, {VERSION}"
        )
    if count > MAX_CAMERAS:
        raise PicturesError(f"{path}: is of {count} cameras; expected {MAX_CAMERAS} at most")
    rows = (
        _CAMERA.unpack_from(memory, _HEAD.size + number * _CAMERA.size) for number in range(count)
    )
    pictures = tuple(_Picture(width_px, height_px, bool(rgb)) for width_px, height_px, rgb in rows)
    needed = _PAGE + 2 * _SLOTS * sum(sum(picture.parts_bytes) for picture in pictures)
    if len(memory) != needed:
        raise PicturesError(f"{path}: has {len(memory)} bytes; expected {needed} for its cameras")
    fault = _fault(pictures)
    if fault:
        raise PicturesError(f"{path}: {fault}")
    return pictures


def _fault(pictures: tuple[_Picture, ...]) -> str:
    """Why no ring can hold such pictures, "" when one can; the same for who writes and who reads it."""
    if len(pictures) > MAX_CAMERAS:
        return f"{len(pictures)} of them; expected {MAX_CAMERAS} at most"
    wrong = next(
        (
            p
            for p in pictures
            if not (0 < p.width_px <= MAX_SIDE_PX and 0 < p.height_px <= MAX_SIDE_PX)
        ),
        None,
    )
    return (
        ""
        if wrong is None
        else f"{wrong.width_px} x {wrong.height_px} px; expected 1 to {MAX_SIDE_PX} each"
    )


def _sets(memory: mmap.mmap, pictures: tuple[_Picture, ...]) -> tuple[tuple[Images, ...], ...]:
    """All sets as arrays over the memory, writable when that is."""
    whole, at = np.frombuffer(memory, np.uint8), _PAGE
    found = []
    for _ in range(2 * _SLOTS):
        row = []
        for picture in pictures:
            row.append(_images(whole[at:], picture))
            at += sum(picture.parts_bytes)
        found.append(tuple(row))
    return tuple(found)


def _images(part: U8, picture: _Picture) -> Images:
    depth, classes, _ = picture.parts_bytes
    shape, n = (picture.height_px, picture.width_px), picture.pixels
    colours = part[depth + classes :][: 3 * n].reshape(*shape, 3) if picture.rgb else None
    return Images(
        depth_m=part[: 4 * n].view(np.float32).reshape(shape),
        class_id=part[depth:][:n].reshape(shape),
        rgb=colours,
    )


def _whole(size: int) -> int:
    return -(-size // _LINE) * _LINE
