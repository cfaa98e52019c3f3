"""Ways to damage bytes and JSON, drawn from a generator; shared by the attacks on files."""

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.attack.scenarios.twists import Rng, holder_of, integer, pick, places

Damage = Callable[[bytes, Rng], bytes]

NASTY: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2**31, 2**63, 2**64, -(2**70), 10**400, 0.5, -0.0, 1e308, float("nan"), float("inf"),
    "", "0", "\x00", "\x1b[31m", "../../etc/passwd", "a" * 5000, [], [1], {}, {"a": 1}, [[[[]]]],
)  # fmt: skip


def flipped(data: bytes, rng: Rng) -> bytes:
    """One bit is another."""
    return flipped_at(data, integer(rng, 8 * max(len(data), 1)))


def flipped_at(data: bytes, bit: int) -> bytes:
    """This bit is another."""
    changed = bytearray(data)
    if changed:
        changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def cut(data: bytes, rng: Rng) -> bytes:
    """The end is missing."""
    return data[: integer(rng, len(data) + 1)]


def holed(data: bytes, rng: Rng) -> bytes:
    """A part in the middle is missing."""
    begin, end = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    return data[:begin] + data[end:]


def longer(data: bytes, rng: Rng) -> bytes:
    """Something follows."""
    return data + rng.bytes(int(rng.integers(1, 300)))


def zeroed(data: bytes, rng: Rng) -> bytes:
    """A part is zeros, as after a loss of power."""
    begin, end = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    return data[:begin] + bytes(end - begin) + data[end:]


def emptied(data: bytes, rng: Rng) -> bytes:
    """Nothing is left."""
    del data, rng
    return b""


def noise(data: bytes, rng: Rng) -> bytes:
    """Something else of the same length."""
    return rng.bytes(len(data))


ANY: tuple[Damage, ...] = (flipped, flipped, flipped, cut, cut, holed, longer, zeroed, emptied, noise)


def edited(text: bytes, rng: Rng) -> bytes:
    """JSON with another value in one place, a place more or a place less."""
    data = json.loads(text)
    at = pick(rng, places(data))
    holder, key = holder_of(data, at), at[-1]
    what = integer(rng, 8)
    if what == 0 and isinstance(holder, dict):
        del holder[key]
    elif what == 1 and isinstance(holder, dict):
        holder[f"{key}x"] = holder[key]
    elif what == 2 and isinstance(holder[key], int):
        holder[key] = int(holder[key]) + pick(rng, (-1, 1, 2**32, -(2**32)))
    else:
        holder[key] = pick(rng, NASTY)
    return json.dumps(data, indent=2).encode()


def bomb(rng: Rng) -> bytes:
    """Text that some readers of JSON do not survive."""
    return bytes(
        pick(
            rng,
            (
                b"[" * 200_000, b'{"a":' * 100_000, b"9" * 6000, b"{", b"null", b"[]", b"\xff\xfe{\x00}\x00", b"NaN",
                b'{"a":1e999}', b'{"a":1,"a":2}', b"\x00" * 1000, b"{}", b'"' + b"a" * 2_000_000 + b'"',
            ),
        )
    )  # fmt: skip


def swollen(sound: bytes, rng: Rng, framed: Callable[[bytes], bytes]) -> bytes:
    """Records, and after them one that unpacks to much or says much, or an end in which very many streams begin."""
    what = integer(rng, 5)
    if what == 0:
        return sound + framed(bytes(pick(rng, (1 << 20, 60 << 20, 240 << 20))))
    if what == 1:
        return sound + framed(b'{"magic": [' + b"[]," * 2_000_000 + b"[]]}")
    if what == 2:
        return framed(b'{"magic": "wcsim-drive-1", "town": "' + b"a" * pick(rng, (1 << 20, 30 << 20)) + b'"}')
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    bomb = packer.compress(bytes(50 << 20))  # and no end
    heads = b""
    for _ in range(pick(rng, (0, 1, 3, 20, 1000, 9000))):
        heads = b"\x78\x9c\0" + struct.pack("<HH", len(heads) % 65_536, ~len(heads) % 65_536) + heads[:65_535]
    return sound + struct.pack("<II", 1 << 17, 0) + (heads + bomb)[: pick(rng, (65_000, 70_000))]


def again(part: str, before: str = "", after: str = "") -> Callable[[int], str]:
    """Makes a text of about n bytes of the same part."""
    return lambda n: before + part * (n // len(part.encode())) + after


def numbered(part: str, before: str = "", after: str = "") -> Callable[[int], str]:
    """The same of parts that differ."""
    return lambda n: before + "".join(part.format(number) for number in range(n // (len(part) + 3))) + after


EMOJI = "\U0001f600"
LIST = ('{"a":[', "0]}")
# Texts of about n bytes that take more to read than they look.
CHEAP: dict[str, Callable[[int], str]] = {
    "commas": again(","),
    "newlines": again("\n"),
    "spaces": again(" "),
    "brackets": again("["),
    "holes": again("\0"),
    "lists": again("[],", *LIST),
    "tables": again('{"":0},', *LIST),
    "numbers": again("1,", *LIST),
    "decimals": again("1.5,", *LIST),
    "pairs": again("[1.5,2.5],", *LIST),
    "lists of one": again("[1.5],", *LIST),
    "wide texts": again(f'"{EMOJI}a",', *LIST),
    "Latin texts": again('"\u00e9a",', *LIST),
    "tables of texts": numbered('"{:x}":"ab",', "{", '"":0}'),
    "tables of Latin texts": numbered('"\u00e9{:x}":"\u00e9b",', "{", '"":0}'),
    "texts": again('"ab",', *LIST),
    "digits": again("9" * 400 + ",", *LIST),
    "keys": numbered('"{:x}":0,', "{", '"":0}'),
    "one key": again('"a":0,', "{", '"a":0}'),
    "a wide text": again("x", '{"a":"' + EMOJI, '"}'),
    "wide letters": again(EMOJI, '{"a":"', '"}'),
    "lists of TOML": again("[],", "a=[", "]"),
    "keys of TOML": numbered("a{:x}=1\n"),
    "tables of TOML": numbered("[a{:x}]\n"),
}


def cheap(rng: Rng) -> tuple[bytes, str]:
    """One of these texts, of 16 KiB to 32 MiB, and its name."""
    told = pick(rng, sorted(CHEAP))
    return CHEAP[told](1 << 14 + integer(rng, 12)).encode(), told


def change(path: Path, how: Damage, rng: Rng) -> bool:
    """Damage a file; False when it is what it was."""
    before = path.read_bytes()
    after = how(before, rng)
    path.unlink()
    path.write_bytes(after)
    return after != before
