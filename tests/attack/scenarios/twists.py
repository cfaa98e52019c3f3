"""Ways to spoil a file: its bytes, what its fields hold, and what lies at its path."""

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

Rng = np.random.Generator
Data = dict[str, Any]
_KEY = re.compile(rb'"[^"\\]{1,40}": ')


class Raw(str):
    """A value that is written as it stands, whatever the format says."""


NASTY: tuple[Any, ...] = (
    *(True, False, -1, 0, 1, 2, 7, 65, 10**6, 2**31, 2**63, 2**64, -(2**63)),
    *(0.5, 1.5, -0.0, 1e9, 1e308, -1e308, 5e-324),
    *("", "x", "a b", "1", "1e999", "\0", "x\0y", "\x1b[31mred", "\n"),
    *("../../x", "/dev/zero", "/etc/passwd", "[/bold]"),
    *("none", "typical", "a" * 500, "a" * 40_000, "é\u202e", "os:system", "." * 300, "1" * 5000),
    *("recorded:/dev/zero", "recorded:x\0", "recorded:/etc/passwd", "recorded:/nowhere/x.csv"),
    *("x\0.toml", "/dev/zero.toml"),
    *([], {}, [1], [1, 2], [2, 1], [0.0, 0.0, 0.0], [1] * 1000, {"a": 1}, {"0": {}}, [[]], [{}], ["a", "a"]),
    *(Raw("9" * 5000), Raw("-" + "9" * 5000), Raw("nan"), Raw("inf"), Raw("NaN"), Raw("-Infinity"), Raw("null")),
    *(Raw("1e5000"), Raw("[" * 40 + "]" * 40), Raw("[" * 3000 + "]" * 3000), Raw("[" * 100_000), Raw("{" * 5000)),
    *(Raw('"\\ud800"'), Raw("'"), Raw('"'), Raw('"""'), Raw("0x7f"), Raw("1_000"), Raw("")),
    Raw("1979-05-27T07:32:00Z"),
)


def draws(count: int, seed: int) -> Iterator[tuple[int, Rng]]:
    """So many numbers, each with a generator of its own."""
    for number in range(count):
        yield number, np.random.default_rng((seed, number))


def integer(rng: Rng, below: int) -> int:
    """Less than `below`."""
    return int(rng.integers(max(below, 1)))


def pick(rng: Rng, items: Any) -> Any:
    """One of them."""
    return items[integer(rng, len(items))]


# --- formats ---


def json_text(value: Any) -> str:
    """JSON, but for `Raw`."""
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(key))}: {json_text(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(json_text, value)) + "]"
    return json.dumps(value)


def toml_value(value: Any) -> str:
    """A value in TOML, but for `Raw`; tables stand in braces."""
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return json.dumps(value, ensure_ascii=True) if isinstance(value, (str, bool)) else repr(value)


def toml_text(data: Data) -> str:
    """A table a section; a value that is missing (None) is left out."""
    lines = [f"{key} = {toml_value(value)}" for key, value in data.items() if not isinstance(value, dict)]
    for name, table in data.items():
        if isinstance(table, dict):
            lines += [f"[{name}]", *(f"{json.dumps(key)} = {toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def without_none(value: Any) -> Any:
    """TOML has no null."""
    if isinstance(value, dict):
        return {key: without_none(item) for key, item in value.items() if item is not None}
    return [without_none(item) for item in value] if isinstance(value, (list, tuple)) else value


# --- fields ---


def places(data: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where the values of a table are, tables and lists included."""
    inside = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    found = [above] if above else []
    for key, value in inside:
        found += places(value, (*above, key))
    return found


def holder_of(data: Any, at: tuple[Any, ...]) -> Any:
    """The table or list that holds the value at this place."""
    return reduce(getitem, at[:-1], data)


def twisted(data: Data, rng: Rng, nasty: tuple[Any, ...] = NASTY) -> tuple[Data, str]:
    """A copy with one or two fields changed, and what was changed."""
    copy, told = msgspec.msgpack.decode(msgspec.msgpack.encode(data)), []
    for _ in range(1 + (integer(rng, 4) == 0)):
        at = pick(rng, places(copy))
        holder, last = holder_of(copy, at), at[-1]
        match integer(rng, 8):
            case 0:
                del holder[last]
                told.append(f"no {at}")
            case 1 if isinstance(holder, dict):
                holder[f"{last}x"] = holder.pop(last)
                told.append(f"{at} renamed")
            case 2 if isinstance(holder, list):
                holder.append(holder[last])
                told.append(f"{at} twice")
            case 3 if integer(rng, 4) == 0:
                many = 10 ** (2 + integer(rng, 4))
                if isinstance(holder, list):
                    holder += [pick(rng, ({}, 0, holder[last]))] * many
                else:
                    holder.update((f"{last}{number}", 0) for number in range(many))
                told.append(f"{at} and {many} more")
            case _:
                number = integer(rng, len(nasty))
                holder[last] = deepcopy(nasty[number])
                told.append(f"{at} = nasty {number}")
    return copy, ", ".join(told)


# --- bytes ---


def _flip(data: bytes, rng: Rng) -> bytes:
    out = bytearray(data)
    for _ in range(1 + integer(rng, 3)):
        out[integer(rng, len(out))] ^= 1 << integer(rng, 8)
    return bytes(out)


def _splice(data: bytes, rng: Rng) -> bytes:
    start, length = integer(rng, len(data)), integer(rng, 60)
    return pick(rng, (data[:start] + data[start + length :], data + data[start : start + length], data + data))


def _insert(data: bytes, rng: Rng) -> bytes:
    at = integer(rng, len(data) + 1)
    what = pick(
        rng,
        (b"\0", b"\xff\xfe", b"[" * 50, b"{" * 5000, b"9" * 5000, b'"', b"'", b"\n", b"\r", b"=", b".", b"a.a.a." * 30,
         b"\xed\xa0\x80", b"\xf0\x9f\x98\x80", b"\x1b[2J", b",", b"1e999", b"nan", b"#", bytes(rng.bytes(8))),
    )  # fmt: skip
    return data[:at] + what + data[at:]


def _encoded(data: bytes, rng: Rng) -> bytes:
    text = data.decode("latin-1")
    return text.encode(pick(rng, ("utf-16", "utf-16-le", "utf-32", "utf-7", "utf-8-sig", "cp037", "utf-8")))


def _a_line_twice(data: bytes, rng: Rng) -> bytes:
    lines = data.splitlines(keepends=True)
    at = integer(rng, len(lines))
    return b"".join([*lines[: at + 1], lines[at], *lines[at + 1 :]])


def _a_key_twice(data: bytes, rng: Rng) -> bytes:
    keys = list(_KEY.finditer(data))
    if not keys:
        return _a_line_twice(data, rng)
    key = pick(rng, keys)
    return data[: key.start()] + key[0] + pick(rng, (b"0, ", b'"x", ', b"{}, ", b"[], ")) + data[key.start() :]


BYTES: tuple[Callable[[bytes, Rng], bytes], ...] = (
    _flip, _flip, _splice, _insert, _insert, _encoded, _a_line_twice, _a_key_twice,
    lambda data, rng: data[: integer(rng, len(data))],
    lambda data, rng: data[integer(rng, len(data)) :],
    lambda data, rng: bytes(rng.bytes(integer(rng, 200))),
)  # fmt: skip


def spoiled(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """Other bytes, and what was done."""
    number = integer(rng, len(BYTES))
    return BYTES[number](data, rng), f"bytes {number}"


# --- what lies there ---


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(5 << 30)


def _loop(path: Path) -> None:
    path.symlink_to(path.name)


PLACES: dict[str, Callable[[Path], object]] = {
    "nothing": lambda path: None,
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a link to endless zeros": lambda path: path.symlink_to("/dev/zero"),
    "a link to a terminal": lambda path: path.symlink_to("/dev/tty"),
    "a link to nothing": lambda path: path.symlink_to("none"),
    "a link to itself": _loop,
    "a link to memory": lambda path: path.symlink_to("/proc/self/mem"),
    "a link to the environment": lambda path: path.symlink_to("/proc/self/environ"),
    "a link to passwords": lambda path: path.symlink_to("/etc/passwd"),
    "five empty gigabytes": _sparse,
    "an empty file": Path.touch,
}


def cleared(path: Path) -> None:
    """Remove whatever is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
