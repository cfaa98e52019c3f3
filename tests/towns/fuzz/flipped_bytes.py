"""Changes to the bytes of any file, or to what lies in its place."""

import gzip
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from numpy.random import Generator

T = TypeVar("T")
Raw = Callable[[bytes, Generator], bytes]
Disk = Callable[[Path], None]

_BOMB = b"""<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;">]><net>&c;</net>"""
_FOREIGN = b"""<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]><net>&x;</net>"""


def pick(rng: Generator, items: tuple[T, ...] | list[T]) -> T:
    """One of them."""
    return items[int(rng.integers(len(items)))]


def deadly(path: Path) -> None:
    """SUMO ends by a signal on a net without connections."""
    path.write_bytes(re.sub(rb"<connection [^>]*>", b"", path.read_bytes()))


def _flipped(data: bytes, rng: Generator) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(len(data), size=pick(rng, (1, 3, 40))):
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _undeclared(data: bytes) -> bytes:
    return data.partition(b"?>")[2] if data.startswith(b"<?") else data


def _declared(data: bytes, encoding: str) -> bytes:
    return f'<?xml version="1.0" encoding="{encoding}"?>\n'.encode() + _undeclared(data)


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


RAW: dict[str, Raw] = {
    "cut": lambda data, rng: data[: int(rng.integers(len(data)))],
    "flip": _flipped,
    "nothing": lambda data, rng: b"",
    "nul": lambda data, rng: data.replace(b"<", b"\0<", 3),
    "packed": lambda data, rng: gzip.compress(data, mtime=0),
    "packed_and_cut": lambda data, rng: gzip.compress(data, mtime=0)[: -int(rng.integers(1, 200))],
    "packed_twice": lambda data, rng: gzip.compress(gzip.compress(data, mtime=0), mtime=0),
    "no_gzip": lambda data, rng: b"\x1f\x8b" + data,
    "utf16": lambda data, rng: data.decode().encode("utf-16"),
    "latin1": lambda data, rng: _declared(data.replace(b' id="', b' id="\xe4', 3), "iso-8859-1"),
    "unknown_encoding": lambda data, rng: _declared(data, "klingon"),
    "no_utf8": lambda data, rng: data.replace(b' id="', b' id="\xe4', 3),
    "bomb": lambda data, rng: _BOMB,
    "foreign": lambda data, rng: _FOREIGN,
    "html": lambda data, rng: b"<!doctype html><html><body>404</body></html>",
    "blanks": lambda data, rng: b" " * 100_000 + data,
    "two_roots": lambda data, rng: data + _undeclared(data),
}
DISK: dict[str, Disk] = {"missing": Path.unlink, "folder": _folder, "pipe": _pipe}
