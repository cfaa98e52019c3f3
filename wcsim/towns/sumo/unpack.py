"""Unpacking gzip and bzip2 that others made: never more than was asked for, in a time that the result's size bounds."""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Callable
from typing import BinaryIO, Protocol

MAX_MEMBERS = 1 << 15  # packed one behind the other in a file; those who pack in blocks of 64 KiB need 16 for a MiB
_CHUNK_BYTES = 1 << 16


class _Machine(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    @property
    def needs_input(self) -> bool: ...
    def decompress(self, data: bytes, max_length: int) -> bytes: ...


class _Gunzip:
    """A member of a gzip file, with the interface that bzip2's has."""

    def __init__(self) -> None:
        self._machine, self._tail = zlib.decompressobj(31), b""

    @property
    def eof(self) -> bool:
        return self._machine.eof

    @property
    def unused_data(self) -> bytes:
        return self._machine.unused_data

    @property
    def needs_input(self) -> bool:
        return not self._tail

    def decompress(self, data: bytes, max_length: int) -> bytes:
        part = self._machine.decompress(self._tail + data, max_length)
        self._tail = self._machine.unconsumed_tail
        return part


def gunzip(file: BinaryIO, most: int) -> bytes:
    """The first `most` bytes of what a gzip file holds. Raises EOFError, OSError or zlib.error when it is broken."""
    return _unpack(file, most, _Gunzip)


def bunzip2(file: BinaryIO, most: int) -> bytes:
    """The first `most` bytes of what a bzip2 file holds. Raises EOFError or OSError when it is broken."""
    return _unpack(file, most, bz2.BZ2Decompressor)


def _unpack(file: BinaryIO, most: int, make: Callable[[], _Machine]) -> bytes:
    found, left, members, machine = list[bytes](), most, 1, make()
    data = file.read(_CHUNK_BYTES)
    while left > 0:
        part = machine.decompress(data, left)
        found.append(part)
        left, data = left - len(part), b""
        if machine.eof:
            data = machine.unused_data or file.read(_CHUNK_BYTES)
            if not data:
                break
            machine, members = make(), members + 1
            if members > MAX_MEMBERS:
                raise EOFError(f"it is packed in more than {MAX_MEMBERS} pieces")
        elif machine.needs_input:
            data = file.read(_CHUNK_BYTES)
            if not data:
                raise EOFError("it ends too early")
    return b"".join(found)
