"""Reading XML of any author, and writing compressed XML whose bytes depend on the content alone.

SUMO has another parser than this process. What passes here means the same to both: XML 1.0 in an
encoding that holds ASCII as it is, without a document type, nested as deep as a scenario needs.

gzip and bzip2 files are unpacked here too: never more than was requested, in a time that the
result's size bounds.
"""

import bz2
import codecs
import gzip
import hashlib
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO
from xml.etree import ElementTree
from xml.parsers import expat

from wcsim.core.reading import XML, escape, open_regular_file
from wcsim.errors import TownError

# A file may have so many packed members. One that is packed in blocks of 64 KiB has 16 for a MiB.
MAX_MEMBERS = 1 << 15
_CHUNK_BYTES = 1 << 16
_GZIP = b"\x1f\x8b"
MAX_XML_BYTES = XML.limit_bytes
MAX_NESTING = 100  # elements inside each other; SUMO's own files need ten
MAX_TAGS = 10_000_000  # each takes memory, however short it is
# The limit of one tag, comment or text: parsers that get a file in pieces begin each of them anew.
MAX_TAG_BYTES = 1 << 20
_SPACE = re.compile(rb"\s*")
_DECLARATION = re.compile(
    rb"""<\?xml\s+version\s*=\s*(["'])1\.0\1"""
    rb"""(?:\s+encoding\s*=\s*(["'])(?P<encoding>[A-Za-z0-9._-]+)\2)?"""
    rb"""(?:\s+standalone\s*=\s*(["'])(?:yes|no)\4)?\s*\?>"""
)
_ENCODING = re.compile(
    r"utf-?8|(us-)?ascii|iso-?8859-\d{1,2}|latin-?1|windows-125\d", re.IGNORECASE
)
_DECLARED = re.compile(rb"<\?[xX][mM][lL][\s?]")
_BLANKS = b" \t\r\n"
_TRUE = frozenset(("1", "yes", "true", "on", "x", "t"))
Visit = Callable[[str, list[str]], None]


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


def unpack(file: BinaryIO, most: int) -> bytes:
    """The first `most` bytes of what a gzip, bzip2 or plain file holds. Raises as `_unpack`."""
    head = file.read(3)
    file.seek(0)
    if head == b"BZh":
        return _unpack(file, most, bz2.BZ2Decompressor)
    return _unpack(file, most, _Gunzip) if head[:2] == _GZIP else file.read(most)


def _unpack(file: BinaryIO, most: int, make: Callable[[], _Gunzip | bz2.BZ2Decompressor]) -> bytes:
    """The first `most` bytes of what a file holds.

    Raises EOFError, OSError or zlib.error when it is broken.
    """
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


def is_true(text: str) -> bool:
    """Whether SUMO takes a boolean of an attribute or option for true, in letters of any size."""
    return text.strip().lower() in _TRUE


def read_bytes(path: Path, limit: int = MAX_XML_BYTES) -> bytes:
    """Content of a plain or gzip-compressed file, at most `limit` bytes after decompression.

    Raises TownError.
    """
    data = read_head(path, limit + 1)
    if len(data) > limit:
        raise TownError(
            f"{escape(path)}: more than {limit >> 20} MiB of XML; expected less: "
            "clip it to a smaller area"
        )
    return data


def read_head(path: Path, size: int) -> bytes:
    """The first `size` bytes of a plain or gzip-compressed file's content. Raises TownError."""
    try:
        with open_regular_file(path, XML) as file:
            packed = file.read(2) == _GZIP
            file.seek(0)
            return _unpack(file, size, _Gunzip) if packed else file.read(size)
    except (EOFError, zlib.error) as error:
        raise TownError(f"{escape(path)}: cannot be read ({error}); expected {XML.what}") from None


def read_root(path: Path, limit: int = MAX_XML_BYTES) -> ElementTree.Element:
    """Root element of an XML file; document type definitions are refused. Raises TownError."""
    return parse_root(read_bytes(path, limit), escape(path))


def parse_root(data: bytes, where: str) -> ElementTree.Element:
    """Root element of XML text that every parser reads alike, see `check_plain_xml`.

    Raises TownError.
    """
    check_plain_xml(data, where)
    try:
        root = ElementTree.fromstring(data)  # noqa: S314 - entity declarations are refused above
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise _malformed(where, error) from None
    level = [root]
    for _ in range(MAX_NESTING):
        level = [child for element in level for child in element]
        if not level:
            return root
    raise _too_deep(where)


def xml_bytes(root: ElementTree.Element) -> bytes:
    """XML text in UTF-8 with a declaration, as `ElementTree.tostring` gives it for that one."""
    # The library encodes each word on its own, which takes twice as long.
    text: str = ElementTree.tostring(root, encoding="unicode")
    return b"<?xml version='1.0' encoding='utf-8'?>\n" + text.encode("utf-8", "xmlcharrefreplace")


def scan(data: bytes, where: str, visit: Visit) -> None:
    """Go through XML text without keeping it.

    `visit` gets each tag and its attributes (name, value, name, ...).

    Raises:
        TownError: It is not well-formed, or not what every parser reads alike, see
            `check_plain_xml`.
    """
    check_plain_xml(data, where)
    parser, depth = expat.ParserCreate(), 0
    parser.ordered_attributes = True

    def begin(tag: str, attributes: list[str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_NESTING:
            raise _too_deep(where)
        visit(tag, attributes)

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise _malformed(where, error) from None


def check_plain_xml(data: bytes, where: str, most_tags: int = MAX_TAGS) -> None:
    """Refuse what parsers may read in different ways, or only in a very long time.

    That is: another encoding than UTF-8, ASCII, or one of their 8-bit relatives, whatever the
    declaration says; another version of XML, where more letters are blanks; document types, whose
    entities hide or blow up; and endless tags.

    Raises:
        TownError: It is so.
    """
    start = data.removeprefix(codecs.BOM_UTF8)
    head = start[:MAX_TAG_BYTES].lstrip(_BLANKS)
    if head[:1] != b"<" or b"\0" in data:
        raise TownError(
            f"{where}: is not well-formed XML in UTF-8, expected to begin with <; "
            "export or build it again"
        )
    if _DECLARED.match(head):
        found = _DECLARATION.match(head)
        if found is None or not _ENCODING.fullmatch(
            (found["encoding"] or b"utf-8").decode("ascii")
        ):
            beginning = escape(ascii(head.partition(b">")[0][:120])[2:-1], 120)
            raise TownError(
                f"{where}: begins with {beginning}; expected XML 1.0 in UTF-8: save it so"
            )
    if b"<!DOCTYPE" in data:
        raise TownError(
            f"{where}: has a document type definition; expected plain UTF-8 XML: remove it"
        )
    if data.count(b"<") > most_tags:
        raise TownError(
            f"{where}: has more than {most_tags} tags; expected fewer: clip it to a smaller area"
        )
    if any(
        data.find(b">", place, place + MAX_TAG_BYTES) < 0
        for place in range(0, len(start) - MAX_TAG_BYTES, MAX_TAG_BYTES)
    ):
        raise TownError(
            f"{where}: has a tag or a text of more than {MAX_TAG_BYTES} bytes; "
            "expected shorter ones: remove it"
        )


def _malformed(where: str, error: Exception) -> TownError:
    return TownError(f"{where}: is not well-formed XML ({error}); export or build the file again")


def _too_deep(where: str) -> TownError:
    return TownError(
        f"{where}: has elements more than {MAX_NESTING} levels inside each other; "
        "remove the innermost"
    )


def without_comments(data: bytes) -> bytes:
    """XML text without comments: SUMO's tools write the date and their options into one."""
    parts, place = list[bytes](), 0
    while (begin := data.find(b"<!--", place)) >= 0 and (end := data.find(b"-->", begin + 4)) >= 0:
        parts.append(data[place:begin])
        found = _SPACE.match(data, end + 3)
        place = found.end() if found else end + 3
    return b"".join((*parts, data[place:]))


def write_gzip(path: Path, data: bytes) -> None:
    """Write `data` gzip-compressed, without a time stamp or file name: equal data, equal bytes."""
    with (
        path.open("wb") as raw,
        gzip.GzipFile("", "wb", compresslevel=9, fileobj=raw, mtime=0) as file,
    ):
        file.write(data)


def content_digest(path: Path) -> str:
    """SHA-256 (hex) of a file's uncompressed content, comments stripped."""
    return hashlib.sha256(without_comments(read_bytes(path))).hexdigest()
