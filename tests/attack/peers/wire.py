"""Hostile messages, made from the message classes themselves: a field that is added later is attacked as well."""

import contextlib
import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import msgspec
from msgspec import inspect

from tests.attack.scenarios.twists import Rng, holder_of, integer, pick, places
from wcsim.server.protocol import messages as m

Path = tuple[int | str, ...]  # of indices into nested arrays, and of keys

_INTEGERS = (-1, 0, 1, 2, 64, 1 << 31, (1 << 53) + 1, (1 << 63) - 1, 1 << 63, (1 << 64) - 1, -(1 << 63))
_FLOATS = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1.0001, -1.0001, 5e-324, 1e13, -3.0)
_TEXTS = (
    "", "\0", "a\nb", "\x1b[31mred", "../../x", "/etc/passwd", "recorded:/etc/passwd", "recorded:\0",
    "recorded:/dev/zero", "\u202egnp", "a b", "ä", "x" * 65, "x" * 300, "x" * 5000, "%s%n", "[bold]",
    "inattentive", "final",
)  # fmt: skip
_BYTES = (b"", b"\0" * 15, b"\0" * 17, bytes(range(16)), b"x" * 129, b"x" * 5000, b"x" * 9000)
_BROKEN_TEXT = msgspec.Raw(b"\xa2\xff\xfe")
_ENDLESS = (
    msgspec.Raw(b"\xdb\xff\xff\xff\xff"),
    msgspec.Raw(b"\xdd\x7f\xff\xff\xff"),
    msgspec.Raw(b"\x91" * 3000 + b"\xc0"),
)
_OTHERS = (None, True, [], {}, [[]], {"a": 1}, ["Leave", b"\0" * 16], [None] * 65, [0] * 5000, _BROKEN_TEXT, *_ENDLESS)
_SIZES = {"q_WB": 4, "wheel_radps": 2}  # of arrays, where not 3
NASTY: tuple[Any, ...] = (*_INTEGERS, *_FLOATS, *_TEXTS, *_BYTES, *_OTHERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """A kind of message as it travels: a sound one, and where its fields are."""

    kind: str
    sound: list[Any]
    places: tuple[Path, ...]
    request: bool


def shapes() -> tuple[Shape, ...]:
    """All kinds of messages."""
    requests = {kind.__name__ for kind in m.Request.__args__}
    found = []
    for kind in (*m.Request.__args__, *m.Reply.__args__):
        info = inspect.type_info(kind)
        sound = sound_value(info)
        found.append(
            Shape(kind=kind.__name__, sound=sound, places=tuple(places(sound)), request=kind.__name__ in requests)
        )
    return tuple(found)


def sound_value(info: inspect.Type, depth: int = 0) -> Any:
    """A value that a field of this type takes."""
    match info:
        case inspect.StructType():
            tag = [] if info.tag is None else [info.tag]
            return [*tag, *(sound_value(field.type, depth + 1) for field in info.fields)]
        case inspect.DataclassType():
            return {field.name: _sound_field(field, depth + 1) for field in info.fields}
        case inspect.IntType() | inspect.FloatType():
            return max(0, info.ge or 0)
        case inspect.StrType():
            return "a" * max(1, info.min_length or 0)
        case inspect.BytesType():
            return b"\0" * (info.min_length or 0)
        case inspect.BoolType():
            return False
        case inspect.LiteralType():
            return info.values[0]
        case inspect.TupleType():
            return [sound_value(item, depth + 1) for item in info.item_types]
        case inspect.VarTupleType():
            return [sound_value(info.item_type, depth + 1)] if depth < 6 else []
        case inspect.UnionType():
            inner = [item for item in info.types if not isinstance(item, inspect.NoneType)]
            return sound_value(inner[0], depth + 1) if depth < 6 else None
    raise AssertionError(f"no sound value is known for {info}; teach it here")


def _sound_field(field: inspect.Field, depth: int) -> Any:
    """A value for a field of a dataclass; of an array a row of zeros, or a picture without pixels."""
    if field.name in ("depth_m", "class_id"):
        return [[0, 0], b""]
    if isinstance(field.type, inspect.CustomType):
        return bytes(8 * _SIZES.get(field.name, 3))
    return sound_value(field.type, depth)


def unbounded(info: inspect.Type, where: str, seen: frozenset[type] = frozenset()) -> Iterator[str]:
    """The places in a type that a peer may fill without limit."""
    match info:
        case inspect.StructType() | inspect.DataclassType():
            if info.cls in seen:
                return
            for field in info.fields:
                yield from unbounded(field.type, f"{where}.{field.name}", seen | {info.cls})
        case inspect.IntType() | inspect.FloatType():
            if info.ge is None or info.le is None:
                yield where
        case inspect.StrType() | inspect.BytesType():
            if info.max_length is None:
                yield where
        case inspect.TupleType():
            for item in info.item_types:
                yield from unbounded(item, where, seen)
        case inspect.VarTupleType():
            if info.max_length is None:
                yield where
            yield from unbounded(info.item_type, where, seen)
        case inspect.UnionType():
            for item in info.types:
                yield from unbounded(item, where, seen)
        case inspect.BoolType() | inspect.LiteralType() | inspect.NoneType() | inspect.CustomType():
            return  # an array is as long as its bytes, which the message bounds; the codec knows its shape
        case _:
            yield f"{where} ({type(info).__name__})"


def spoilt(shape: Shape, rng: Rng) -> bytes:
    """A message with one to three nasty fields, with one too many or too few, with flipped bits, or cut off."""
    message = deepcopy(shape.sound)
    for _ in range(int(rng.integers(1, 4))):
        _put(message, pick(rng, shape.places), pick(rng, NASTY))
    way = integer(rng, 12)
    if way == 0:
        message.append(pick(rng, NASTY))
    elif way == 1:
        message.pop()
    data = bytearray(msgspec.msgpack.encode(message))
    if way == 2 and data:
        for _ in range(int(rng.integers(1, 4))):
            data[integer(rng, len(data))] ^= 1 << integer(rng, 8)
    elif way == 3:
        data = data[: integer(rng, len(data))]
    return bytes(data)


def each_field(shape: Shape) -> Iterator[tuple[Path, Any, bytes]]:
    """Every field of a message times every nasty value."""
    for place in shape.places:
        for value in NASTY:
            message = deepcopy(shape.sound)
            _put(message, place, value)
            yield place, value, msgspec.msgpack.encode(message)


def _put(message: Any, place: Path, value: Any) -> None:
    with contextlib.suppress(LookupError, TypeError):  # what was there is spoilt already
        holder_of(message, place)[place[-1]] = deepcopy(value)
