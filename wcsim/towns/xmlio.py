"""Reading XML that others wrote, and writing compressed XML whose bytes depend on nothing but the content."""

from __future__ import annotations

import gzip
import hashlib
import re
import zlib
from pathlib import Path
from xml.etree import ElementTree

from wcsim.errors import TownError

MAX_XML_BYTES = 200 << 20
_COMMENT = re.compile(rb"<!--.*?-->\s*", re.DOTALL)


def read_bytes(path: Path, limit: int = MAX_XML_BYTES) -> bytes:
    """Content of a plain or gzip-compressed file, at most `limit` bytes after decompression. Raises TownError."""
    try:
        with path.open("rb") as file:
            packed = file.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rb") if packed else path.open("rb") as file:
            data = file.read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise TownError(f"{path}: cannot be read ({error}); expected an XML file, plain or gzip-compressed") from None
    if len(data) > limit:
        raise TownError(f"{path}: more than {limit >> 20} MiB of XML; expected less: clip it to a smaller area")
    return bytes(data)


def is_there(path: Path) -> bool:
    """Whether a path that somebody wrote names a file; one that no system could hold does not."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether a path that somebody wrote names a folder."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def shown(path: Path) -> str:
    """A path that somebody wrote, for a message: at most 160 letters, its end where it is longer."""
    text = str(path)
    return text if len(text) <= 160 else "..." + text[-157:]


def read_head(path: Path, size: int) -> bytes:
    """The first `size` bytes of a plain or gzip-compressed file's content. Raises TownError."""
    try:
        with path.open("rb") as file:
            packed = file.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rb") if packed else path.open("rb") as file:
            return bytes(file.read(size))
    except (OSError, EOFError, zlib.error) as error:
        raise TownError(f"{path}: cannot be read ({error}); expected an XML file, plain or gzip-compressed") from None


def read_root(path: Path, limit: int = MAX_XML_BYTES) -> ElementTree.Element:
    """Root element of an XML file; document type definitions are refused. Raises TownError."""
    return parse_root(read_bytes(path, limit), str(path))


def parse_root(data: bytes, where: str) -> ElementTree.Element:
    """Root element of XML text; document type definitions are refused, so entities cannot blow up. Raises TownError."""
    if b"<!DOCTYPE" in data or b"\0" in data:
        raise TownError(f"{where}: has a document type definition or NUL bytes; expected plain UTF-8 XML: remove them")
    try:
        return ElementTree.fromstring(data)  # noqa: S314 - entity declarations are refused above
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise TownError(f"{where}: is not well-formed XML ({error}); export or build the file again") from None


def without_comments(data: bytes) -> bytes:
    """XML text without comments: SUMO's tools write the date and their options into one."""
    return _COMMENT.sub(b"", data)


def write_gzip(path: Path, data: bytes) -> None:
    """Write `data` gzip-compressed, without a time stamp or file name, so that equal content gives equal bytes."""
    with path.open("wb") as raw, gzip.GzipFile("", "wb", compresslevel=9, fileobj=raw, mtime=0) as file:
        file.write(data)


def content_digest(path: Path) -> str:
    """SHA-256 (hex) of a file's uncompressed content, comments stripped."""
    return hashlib.sha256(without_comments(read_bytes(path))).hexdigest()
