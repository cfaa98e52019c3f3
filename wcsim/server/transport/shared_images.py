"""The pictures of a seat in shared memory: the server's cameras write them, its client reads them.

Each seat has a file. A file has two slots, for even and odd ticks, so that a frame stays while the
next one is drawn. A slot has two sets of pictures: the tick that ends an episode also has those of
the next one's first frame.
"""

import mmap
import os
import secrets
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from wcsim.config import CameraConfig
from wcsim.core.reading import PICTURES, open_regular_file
from wcsim.errors import ConfigError, DiskFullError, PicturesError, ProtocolError
from wcsim.physics.buffers import Images, SeatBuffers
from wcsim.types.arrays import U8

MAGIC: Final = b"wcsimpix"
VERSION: Final = 1
MAX_CAMERAS: Final = 64
MAX_SIDE_PX: Final = 1 << 16
_SLOTS: Final = 2
_HEAD: Final = struct.Struct("<8sII")  # magic, version, cameras
_CAMERA: Final = struct.Struct("<III")  # width, height, 1 with colours
_PAGE: Final = 4096  # bytes
_LINE: Final = 64  # bytes of a cache line


class SharedImageWriter:
    """The server's side: where the pictures of all seats go; an `ImageSink` with slots.

    See `server/host/world_host.py`.
    """

    def __init__(self, folder: Path, seats: int, cameras: Sequence[CameraConfig]) -> None:
        """Make a new file for each seat.

        A file of an earlier server lives on for clients that still read it.

        Raises:
            ConfigError: There are more cameras, or larger ones, than a file has room for.
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

    def select_slot(self, tick: int) -> None:
        """Let the next pictures be those of this tick."""
        self._slot = self.slot(tick)

    def slot(self, tick: int) -> int:
        """The slot of a tick's pictures."""
        return tick % _SLOTS

    def buffers(self, seat: int, first: bool) -> SeatBuffers:
        """Where the next pictures of a seat go; see `ImageSink.buffers`."""
        return self._buffers[seat][_set(self._slot, first)]

    def path(self, seat: int) -> Path:
        """The file of a seat."""
        return self._paths[seat]


class SharedImageReader:
    """A client's side: the pictures of its seat, read-only; valid as long as any is referenced."""

    def __init__(self, path: Path) -> None:
        """Map a seat's file.

        Raises:
            ProtocolError: It cannot be opened, as while a world is made anew.
            PicturesError: It is not of this version, and another try would not help.
        """
        try:
            with open_regular_file(path, PICTURES) as file:
                memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ConfigError as error:
            raise ProtocolError(
                f"the pictures cannot be opened ({error}); is this the same machine?"
            ) from None
        self._sets = _sets(memory, _read_head(path, memory))

    def pictures(self, slot: int, first: bool) -> Sequence[Images]:
        """The pictures in a slot; see `decode_reply`."""
        if not 0 <= slot < _SLOTS:
            raise ProtocolError(f"pictures in slot {slot}; expected 0 to {_SLOTS - 1}")
        return self._sets[_set(slot, first)]


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
        colours = 3 * self.pixels if self.rgb else 0
        return _whole_lines(4 * self.pixels), _whole_lines(self.pixels), _whole_lines(colours)


def _set(slot: int, first: bool) -> int:
    """The number of a set of pictures.

    A first frame has no step before it. Its pictures are beside those of the last frame.
    """
    return 2 * slot + first


def _file_bytes(pictures: tuple[_Picture, ...]) -> int:
    return _PAGE + 2 * _SLOTS * sum(sum(picture.parts_bytes) for picture in pictures)


def _new_file(path: Path, pictures: tuple[_Picture, ...]) -> mmap.mmap:
    """Make a file under this name, of its full size, so that writing to it cannot fail later."""
    size = _file_bytes(pictures)
    part = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
    try:
        number = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            os.posix_fallocate(number, 0, size)
            memory = mmap.mmap(number, size)
        finally:
            os.close(number)
        _HEAD.pack_into(memory, 0, MAGIC, VERSION, len(pictures))
        for index, picture in enumerate(pictures):
            _CAMERA.pack_into(memory, _HEAD.size + index * _CAMERA.size, *picture)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise DiskFullError(
            f"{path}: no room for {size} bytes of pictures ({error.strerror}); make room"
        ) from None
    return memory


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
    rows = [_CAMERA.unpack_from(memory, _HEAD.size + n * _CAMERA.size) for n in range(count)]
    pictures = tuple(_Picture(width_px, height_px, bool(rgb)) for width_px, height_px, rgb in rows)
    needed = _file_bytes(pictures)
    if len(memory) != needed:
        raise PicturesError(f"{path}: has {len(memory)} bytes; expected {needed} for its cameras")
    fault = _fault(pictures)
    if fault:
        raise PicturesError(f"{path}: {fault}")
    return pictures


def _fault(pictures: tuple[_Picture, ...]) -> str:
    """Why no file can hold such pictures, "" when one can; for the writer and the reader."""
    if len(pictures) > MAX_CAMERAS:
        return f"{len(pictures)} of them; expected {MAX_CAMERAS} at most"
    for p in pictures:
        if not (0 < p.width_px <= MAX_SIDE_PX and 0 < p.height_px <= MAX_SIDE_PX):
            return f"{p.width_px} x {p.height_px} px; expected 1 to {MAX_SIDE_PX} each"
    return ""


def _sets(memory: mmap.mmap, pictures: tuple[_Picture, ...]) -> tuple[tuple[Images, ...], ...]:
    """All sets as arrays over the memory, writable when that is."""
    whole = np.frombuffer(memory, np.uint8)
    start = _PAGE
    sets = []
    for _ in range(2 * _SLOTS):
        images = []
        for picture in pictures:
            images.append(_images(whole[start:], picture))
            start += sum(picture.parts_bytes)
        sets.append(tuple(images))
    return tuple(sets)


def _images(part: U8, picture: _Picture) -> Images:
    depth, classes, _ = picture.parts_bytes
    shape = (picture.height_px, picture.width_px)
    n = picture.pixels
    colours = part[depth + classes :][: 3 * n].reshape(*shape, 3) if picture.rgb else None
    return Images(
        depth_m=part[: 4 * n].view(np.float32).reshape(shape),
        class_id=part[depth:][:n].reshape(shape),
        rgb=colours,
    )


def _whole_lines(size: int) -> int:
    return -(-size // _LINE) * _LINE
