"""The one way to read files that others may have written.

They must be regular, of bounded size, depth and numbers, in UTF-8. A `FileSpec` is what a file
should be; whatever is wrong with one, its reader raises the kind's error and no other. Nothing here
executes or follows a file's content.
"""

from __future__ import annotations

import codecs
import gzip
import io
import json
import math
import os
import re
import stat
import sys
import tomllib
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NoReturn

from wcsim.errors import ConfigError, FileError, JournalError, PolicyError, TownError

if TYPE_CHECKING:
    import zstandard

JsonObject = dict[str, Any]  # or a TOML table
# In a record; sound ones have up to 6 kB, and decoding takes 60 times as much memory.
MOST_JSON_BYTES: Final = 1 << 20
MOST_MEMORY_BYTES: Final = 120 << 20  # that reading a text may take, with all that is made of it
MOST_LINE: Final = 1 << 16  # characters
MOST_LINES: Final = 4_500_000
MAX_DEPTH: Final = 32  # of tables and lists inside each other
MAX_INTEGER: Final = (1 << 64) - 1  # by magnitude; no number in any of wcsim's files is larger
MAX_DOTTED: Final = 16  # parts of a TOML key; tomllib takes a time that grows with their square
_MIB: Final = 1 << 20
# Most bytes of what is made of a character, beside it: a list, a table, a row or a value.
_COSTS: Final = {character: 110 for character in "[{,=\n"}
# A value of a table has all but the brackets.
_JSON_COSTS: Final = {"[": 95, "{": 200, ",": 40, ":": 110, '"': 22}
_DOTTED: Final = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{MAX_DOTTED}}}"""
)
_MESSAGE_CHARACTERS: Final = 200


@dataclass(frozen=True, slots=True)
class FileSpec:
    """What a file is expected to be."""

    what: str  # "a TOML file", for messages
    limit_bytes: int
    error: type[FileError] = ConfigError
    memory_bytes: int = MOST_MEMORY_BYTES  # of a text


# Every kind of file that others may have written. The bytes are those of the file, and again of its
# unpacked content; a text may take `MOST_MEMORY_BYTES` with all that is made of it. What is read in
# lines or pieces may be larger.

# Settings, and what people write.
SETTINGS: Final = FileSpec("a TOML file of at most a megabyte", _MIB)
CONFIG: Final = FileSpec("a configuration", _MIB)
VALUE: Final = FileSpec("a value in TOML's syntax", _MIB)
PROFILE: Final = FileSpec("a user's profile as TOML", _MIB // 16)
STUDY_TABLE: Final = FileSpec("a study's table", 16 * _MIB)
STICK: Final = FileSpec("a recorded joystick", 64 * _MIB)  # in lines
# In lines.
CHAIR: Final = FileSpec("CSV of at most 64 MiB, plain or compressed by gzip", 64 * _MIB)

# Towns and scenes.
TOWN: Final = FileSpec("a town.toml", _MIB, TownError)
SCENE: Final = FileSpec("a scene.toml", _MIB, TownError)
XML: Final = FileSpec("an XML file, plain or gzip-compressed", 200 * _MIB, TownError)
SCENARIO: Final = FileSpec("a file of a scenario", 200 * _MIB, TownError)
EDGES: Final = FileSpec("a list of edges", 16 * _MIB, TownError)
NOTICE: Final = FileSpec("a notice", _MIB, TownError)
HEIGHTS: Final = FileSpec("a GeoTIFF of heights", 100 * _MIB, TownError)
EXTRACT: Final = FileSpec(
    what="an OpenStreetMap extract: .osm, .osm.xml, plain, .gz or .bz2, or .osm.pbf",
    limit_bytes=1 << 40,  # by a child with limits of its own
    error=TownError,
)

# Runs, data and policies.
RUN: Final = FileSpec("a file of `wcsim train`: restore it or train again", _MIB, PolicyError)
METRICS: Final = FileSpec("the log of a run", 16 * _MIB, PolicyError)
# Where a run goes on with it.
METRIC_LINES: Final = FileSpec("the log of a run", 64 * _MIB, PolicyError)
CLAIM: Final = FileSpec("a client's claim", 1 << 10, PolicyError)
LEARNED: Final = FileSpec("the learned_data.json of a run", 16 * _MIB, PolicyError)
ORDERS: Final = FileSpec("the orders.json of a data folder", 16 * _MIB, PolicyError)
DATA: Final = FileSpec("the data.json of a data folder", 16 * _MIB, PolicyError)
SEGMENT: Final = FileSpec("a segment of recorded driving", 1 << 30, PolicyError)
STATE: Final = FileSpec("the state.json of a checkpoint", 16 * _MIB, PolicyError)
ARRAYS: Final = FileSpec("the arrays of a checkpoint", 64 << 30, PolicyError)
POLICY: Final = FileSpec("the policy.json of a policy folder", _MIB, PolicyError)
HASHES: Final = FileSpec("the files.json of the shipped policy", _MIB, PolicyError)
WEIGHTS: Final = FileSpec("the weights of a policy", 1 << 30, PolicyError)
MEANING: Final = FileSpec("the meaning.json of an exported policy", 4 * _MIB, PolicyError)
ONNX_TOML: Final = FileSpec("the policy.toml of an ONNX folder", _MIB)
ANSWER: Final = FileSpec("an answer of a policy", 1 << 16, PolicyError)
KEY: Final = FileSpec("a key of 32 bytes", 32, PolicyError)

# Tests and what a world writes.
EPISODES: Final = FileSpec("a list of test episodes", 16 * _MIB)
BLOCK: Final = FileSpec("a saved block of `wcsim test`: remove it", 16 * _MIB)
RESULT: Final = FileSpec("a file of `wcsim test`: run it again", 32 * _MIB)
# In records.
LOG: Final = FileSpec("a log written by wcsim", 1 << 62, JournalError)
WHOLE_LOG: Final = FileSpec("a log whose ticks are read at once", 256 * _MIB, JournalError)
PICTURES: Final = FileSpec("the pictures of a seat", 1 << 50)  # shared memory
ORDER: Final = FileSpec("an order to a process of wcsim", 16 * _MIB)


@contextmanager
def open_regular_file(path: Path, kind: FileSpec) -> Iterator[BinaryIO]:
    """A regular file, open for reading; what fails while it is open becomes `kind.error`.

    A pipe, a device or a folder is refused unread, so that none can hang or fill this process.

    Raises:
        FileError: Of the kind's class: no such file, no regular one, or reading it failed.
    """
    try:
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        with os.fdopen(number, "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise kind.error(f"{escape(path)}: is not a regular file; expected {kind.what}")
            yield file
    except (OSError, ValueError) as error:  # the second for NUL in the path
        reason = getattr(error, "strerror", None) or error
        raise _unreadable(path, kind, reason) from None


def read_bytes(path: Path, kind: FileSpec) -> bytes:
    """The whole content of a file. Raises FileError, of the kind's class."""
    with open_regular_file(path, kind) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(kind.limit_bytes + 1) if size <= kind.limit_bytes else b""
    if max(size, len(data)) > kind.limit_bytes:
        raise kind.error(
            f"{escape(path)}: is larger than {kind.limit_bytes} bytes; expected {kind.what}"
        )
    return data


def read_text(path: Path, kind: FileSpec, costs: Mapping[str, int] = _COSTS) -> str:
    """The content of a file in UTF-8, with or without its mark, or packed as .gz.

    `costs` are the bytes of what is made of the text, by character. Raises FileError of its kind.
    """
    data = read_bytes(path, kind)
    if path.suffix == ".gz":
        data = _gunzipped(data, path, kind)
    try:
        text = data.removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as error:
        raise kind.error(
            f"{escape(path)}: is not in UTF-8 ({error.reason} at byte {error.start}); "
            "save it as UTF-8"
        ) from None
    # One character beyond Latin makes all others wider, and what is made of them holds them again.
    made = sum(cost * text.count(character) for character, cost in costs.items())
    if 2 * sys.getsizeof(text) + made > kind.memory_bytes:
        raise kind.error(
            f"{escape(path)}: would take more than {kind.memory_bytes >> 20} MiB to read; "
            f"expected {kind.what}"
        )
    return text


def read_lines(path: Path, kind: FileSpec) -> Iterator[str]:
    """The lines of a text in UTF-8, plain or packed as .gz; it is never held as a whole.

    Raises:
        FileError: Of the kind's class; also for more than `MOST_LINES` lines, or one of more than
            `MOST_LINE` characters.
    """
    with open_regular_file(path, kind) as file:
        left = kind.limit_bytes
        lines = 0
        try:
            packed = gzip.GzipFile(fileobj=file) if path.suffix == ".gz" else file
            text = io.TextIOWrapper(packed, encoding="utf-8-sig", newline="")
            while line := text.readline(MOST_LINE + 1):
                left -= len(line)
                lines += 1
                if left < 0 or lines > MOST_LINES or len(line) > MOST_LINE:
                    raise kind.error(
                        f"{escape(path)}:{lines}: more than {kind.limit_bytes} bytes or "
                        f"{MOST_LINES} lines, or a line of more than {MOST_LINE} letters; "
                        f"expected {kind.what}"
                    )
                yield line
        except UnicodeDecodeError:
            raise kind.error(
                f"{escape(path)}:{lines + 1}: is not in UTF-8; save it as UTF-8"
            ) from None
        except (EOFError, zlib.error) as error:
            raise _unreadable(path, kind, error) from None


def read_json(path: Path, kind: FileSpec) -> JsonObject:
    """A JSON object from a file. Raises FileError, of the kind's class."""
    return parse_json(read_text(path, kind, _JSON_COSTS), escape(path), kind, kind.limit_bytes)


def read_toml(path: Path, kind: FileSpec) -> JsonObject:
    """The table of a TOML file. Raises FileError, of the kind's class."""
    return parse_toml(read_text(path, kind), escape(path), kind)


def parse_json(
    text: str, where: str, kind: FileSpec, most_bytes: int = MOST_JSON_BYTES
) -> JsonObject:
    """JSON text as an object; a key must not occur twice, as readers differ in which one counts.

    Raises:
        FileError: Of the kind's class, beginning with `where`; also for text that is too long to be
            parsed.
    """
    if len(text) > most_bytes:
        raise kind.error(
            f"{where}: has {len(text)} characters of JSON; expected at most {most_bytes} for "
            f"{kind.what}"
        )
    try:
        data = json.loads(text, object_pairs_hook=_unique, parse_constant=_no_constant)
    except (ValueError, RecursionError, MemoryError) as error:
        raise kind.error(f"{where}: is not JSON: {_short(error)}; expected {kind.what}") from None
    if not isinstance(data, dict):
        raise kind.error(
            f"{where}: contains a {type(data).__name__}; expected {kind.what}, which is a JSON "
            "object"
        )
    _require_bounded(data, where, kind)
    return data


def parse_toml(text: str, where: str, kind: FileSpec) -> JsonObject:
    """TOML text as a table. Raises FileError, of the kind's class, beginning with `where`."""
    if _DOTTED.search(text):
        raise kind.error(
            f"{where}: has a name with more than {MAX_DOTTED} dotted parts; expected {kind.what}"
        )
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError, MemoryError) as error:
        raise kind.error(f"{where}: is not TOML: {_short(error)}") from None
    _require_bounded(data, where, kind)
    return data


def decompress_zstd(
    packed: bytes, most_bytes: int, unpacker: zstandard.ZstdDecompressor | None = None
) -> bytes:
    """The content of a zstd frame, at most so many bytes; for many frames pass one `unpacker`.

    Raises:
        ValueError: Its header names more than `most_bytes`.
        zstandard.ZstdError: It is no whole frame, or holds more than its header names.
    """
    # Imported here, as commands that only read text need not wait for it.
    import zstandard

    limit = max(most_bytes, 1)
    # Zstd itself takes the size in the header for the limit.
    if zstandard.frame_content_size(packed) > limit:
        raise ValueError(f"more than {most_bytes} bytes")
    return (unpacker or zstandard.ZstdDecompressor()).decompress(packed, max_output_size=limit)


def read_file_size(path: Path, kind: FileSpec) -> int:
    """Bytes of a file that a library will read itself. Raises FileError when it must not."""
    with open_regular_file(path, kind) as file:
        size = os.fstat(file.fileno()).st_size
    if size > kind.limit_bytes:
        raise kind.error(
            f"{escape(path)}: is larger than {kind.limit_bytes} bytes; expected {kind.what}"
        )
    return size


def is_file(path: Path) -> bool:
    """Whether a user's path names a regular file; one that no system could hold does not."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether a user's path names a folder."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def require_no_outward_links(folder: Path, error: type[FileError]) -> None:
    """Refuse a folder that others may have made when a name in it leads out of it.

    It will be written to, and writing would follow the link. Two names in the folder for one file
    are allowed: checkpoints share a replay.

    Raises:
        FileError: Of the class `error`: a symbolic link, or a file that has another name elsewhere.
    """
    names: dict[tuple[int, int, int], list[str]] = {}
    waiting = [folder]
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                known = entry.stat(follow_symlinks=False)
                if entry.is_symlink():
                    raise _link_refused(entry.path, error)
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(Path(entry.path))
                elif known.st_nlink > 1:
                    names.setdefault((known.st_dev, known.st_ino, known.st_nlink), []).append(
                        entry.path
                    )
    for (_, _, links), paths in names.items():
        if len(paths) < links:
            raise _link_refused(paths[0], error)


def escape(text: object, most: int = 160) -> str:
    r"""A foreign path or text for a message: printable, of at most `most` characters, else its end.

    >>> escape("a\x1b[31mb")
    'a\\x1b[31mb'
    """
    printable = "".join(
        character if character.isprintable() else ascii(character)[1:-1]
        for character in str(text)[-2 * most :]
    )
    return printable if len(printable) <= most else "..." + printable[3 - most :]


def pluralize(count: int, one: str, several: str = "") -> str:
    """A number with its noun.

    >>> pluralize(1, "crash"), pluralize(2, "crash"), pluralize(0, "tick")
    ('1 crash', '2 crashes', '0 ticks')
    >>> pluralize(3, "policy", "policies")
    '3 policies'
    """
    if count == 1:
        return f"1 {one}"
    return f"{count} {several or one + ('es' if one.endswith(('s', 'sh', 'ch')) else 's')}"


def join_names(names: Collection[str], most: int) -> str:
    """Names for a message, at most `most` of them.

    >>> join_names(["a", "b", "c"], 2), join_names(["a", "b"], 2)
    ('a, b and more', 'a, b')
    """
    return ", ".join(list(names)[:most]) + " and more" * (len(names) > most)


def escape_repr(value: object, most: int = 60) -> str:
    """An argument of a function, for a message, as Python writes it."""
    try:
        return escape(repr(value), most)
    except ValueError:  # an integer of thousands of digits
        return f"a very large {type(value).__name__}"


def read_module_toml(module: str | Path) -> JsonObject:
    """The TOML file beside a module of wcsim, of the same name; `module` is its `__file__`."""
    return tomllib.loads(Path(module).with_suffix(".toml").read_text(encoding="utf-8"))


def has_surrogates(text: str) -> bool:
    """Whether a text holds surrogates, which UTF-8 cannot encode.

    Python makes them of those bytes of an argument that are no text.
    """
    return not text.isascii() and any("\ud800" <= character <= "\udfff" for character in text)


def _unreadable(path: Path, kind: FileSpec, reason: object) -> FileError:
    return kind.error(f"{escape(path)}: cannot be read ({reason}); expected {kind.what}")


def _gunzipped(data: bytes, path: Path, kind: FileSpec) -> bytes:
    unpack = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)  # gzip alone
    unpacked = b""
    with suppress(zlib.error):
        unpacked = unpack.decompress(data, kind.limit_bytes)
    if not unpack.eof or unpack.unused_data:
        raise kind.error(
            f"{escape(path)}: is no single gzip file of at most {kind.limit_bytes} bytes "
            f"unpacked; expected {kind.what}"
        )
    return unpacked


def _require_bounded(
    data: Any, where: str, kind: FileSpec, name: object = "it", depth: int = 0
) -> None:
    """Refuse nesting beyond `MAX_DEPTH`, and what `_require_plain` refuses.

    Raises:
        FileError: Of the kind's class.
    """
    if not isinstance(data, dict | list):
        _require_plain(data, where, name, kind)
        return
    if depth > MAX_DEPTH:
        raise kind.error(
            f"{where}: is nested more than {MAX_DEPTH} levels deep; expected {kind.what}"
        )
    if isinstance(data, list):
        for item in data:
            _require_bounded(item, where, kind, name, depth + 1)
        return
    for key in data:
        _require_plain(key, where, name, kind)
    for key, value in data.items():
        _require_bounded(value, where, kind, key, depth + 1)


def _require_plain(value: Any, where: str, name: object, kind: FileSpec) -> None:
    """Refuse a number that is not finite or beyond `MAX_INTEGER`, and text that is no Unicode."""
    fault = ""
    if isinstance(value, str) and has_surrogates(value):
        fault = f"contains half a character, {escape(value, 40)!r}; expected text in valid UTF-8"
    if isinstance(value, int) and abs(value) > MAX_INTEGER:
        fault = f"is a number of {value.bit_length()} bits; expected at most 64"
    if isinstance(value, float) and not math.isfinite(value):
        fault = f"is the number {value}; expected a finite one"
    if fault:
        raise kind.error(f"{where}: {escape(name, 40)} {fault}")


def _unique(pairs: list[tuple[str, Any]]) -> JsonObject:
    data = dict(pairs)
    if len(data) < len(pairs):
        seen = set[str]()
        for key, _ in pairs:
            if key in seen:
                raise ValueError(f"the key {escape(key, 40)!r} occurs twice")
            seen.add(key)
    return data


def _link_refused(path: str, error: type[FileError]) -> FileError:
    return error(f"{escape(path)}: is a link; expected a file, as writing would follow the link")


def _no_constant(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a JSON number")


def _short(error: BaseException) -> str:
    return escape(str(error)[:_MESSAGE_CHARACTERS], _MESSAGE_CHARACTERS) or type(error).__name__
