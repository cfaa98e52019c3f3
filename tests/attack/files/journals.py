"""Attacks on what runs write down: journals, ledgers, metrics, events. No whole record goes without a word."""

import shutil
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.attack.files.damage import ANY, bomb, flipped, flipped_at, swollen
from tests.attack.outcomes import Case
from tests.attack.scenarios.twists import Rng, cleared, draws, integer, pick
from tests.log.test_log import HEADER, RECORDS, tick
from tests.support.events import read_events
from tests.support.framing import chained, pieces, read_whole, write_log
from wcsim.agents.runs.metrics import COLUMNS, MetricsFile, read_metrics
from wcsim.log.framing import MAX_RECORD_BYTES, frame_payload
from wcsim.log.reader import hash_log, iter_journal_inputs
from wcsim.log.records import Ended, Input, LogRecord, SeenFrame, header_to_bytes
from wcsim.log.writer import LogWriter
from wcsim.server.launch.event_log import EVENTS, EventLogWriter
from wcsim.server.ledger import iter_ledger_frames, open_ledger_writer

TICKS = tuple(tick(number, epoch=1) for number in range(1, 240))
LONG: tuple[Input, ...] = (*RECORDS[:-1], *TICKS, Ended(reason="x"))
FRAMES = tuple(SeenFrame(epoch=0, tick=number, stepped=number % 30 > 0) for number in range(60))
DEEP = b"\x94\xa1e" + b"\x91" * 50_000
Pieces = list[bytes]
Spoil = Callable[[Pieces, Rng], bytes]
"""Makes another file of the pieces of a sound one."""


def cases(count: int, seed: int, work: Path, areas: tuple[str, ...] = ("journals",)) -> Iterator[Case]:
    """So many attacks on some of "journals", "ledgers", "metrics" and "events"."""
    folder = work / "case"
    sound = {area: MAKERS[area](work / f"sound-{area}") for area in areas}
    for area in areas:
        cleared(work / f"sound-{area}")
    for number, rng in draws(count, seed):
        area = areas[number % len(areas)]
        spoil = pick(rng, SPOILS[area])
        data = spoil(sound[area], rng)
        yield Case(
            area=area,
            name=f"{number} {spoil.__name__}",
            feed=lambda a=area, d=data: _feed(a, d, b"".join(sound[a]), folder),  # type: ignore[misc]
        )


def other_cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """So many attacks on the others than journals."""
    return cases(count, seed, work, ("ledgers", "metrics", "events"))


def _feed(area: str, data: bytes, whole: bytes, folder: Path) -> bool:
    folder.mkdir()
    path = folder / (EVENTS if area == "events" else "x")
    path.write_bytes(data)
    try:
        return CHECKS[area](path, data, whole)
    finally:
        shutil.rmtree(folder)


# --- journals ---


def a_journal(path: Path) -> Pieces:
    """The pieces of a sound one."""
    return pieces(write_log(path, HEADER, LONG))


def a_ledger(path: Path) -> Pieces:
    """The pieces of a sound one."""
    with open_ledger_writer(path, "c0") as ledger:
        for frame in FRAMES:
            ledger.append(frame)
    return pieces(path)


def check_log(path: Path, data: bytes, whole: bytes) -> bool:
    """Reading it, and going on with it; a refusal leaves it as it was."""
    try:
        seen = read_whole(path)
        digest, ledger = hash_log(path), seen.header.kind == "ledger"
        sound: tuple[LogRecord, ...] = FRAMES if ledger else LONG
        read: tuple[LogRecord, ...] = tuple(iter_ledger_frames(path) if ledger else iter_journal_inputs(path))
        if seen.records != sound[: len(seen.records)] or read != seen.records:
            return False
        with LogWriter.append_to(path) as writer:
            cut = writer.cut_bytes
            if hash_log(path) != digest or seen.torn != (cut > 0):
                return False
            writer.append(sound[0])
    except Exception:
        if path.read_bytes() != data or len(list(path.parent.iterdir())) > 1:
            return False
        raise
    kept = path.with_name("x.torn").read_bytes() if path.with_name("x.torn").exists() else bytes(cut)
    rest = path.read_bytes()
    begun = len(data) - cut
    prefix = whole.startswith(data[:begun]) and data[:begun] + kept == data and rest.startswith(data[:begun])
    return prefix and not _holds_another_record(kept, whole, begun) and read_whole(path).records[-1] == sound[0]


def _holds_another_record(kept: bytes, whole: bytes, begun: int) -> bool:
    """Whether what was cut off holds more than one record that was damaged."""
    return any(piece in kept for piece in _CONTENTS.setdefault(whole, _contents(whole)))


_CONTENTS: dict[bytes, tuple[bytes, ...]] = {}


def _contents(whole: bytes) -> tuple[bytes, ...]:
    found, at = [], 0
    while at < len(whole):
        size = struct.unpack_from("<I", whole, at)[0]
        found.append(whole[at + 8 : at + 8 + size])
        at += 8 + size
    return tuple(found)


def any_damage(parts: Pieces, rng: Rng) -> bytes:
    return bytes(pick(rng, ANY)(b"".join(parts), rng))


def a_flip_near_the_end(parts: Pieces, rng: Rng) -> bytes:
    data = b"".join(parts)
    return flipped_at(data, 8 * len(data) - 1 - integer(rng, 8 * 2000))


def a_flipped_length(parts: Pieces, rng: Rng) -> bytes:
    number = len(parts) - 1 - integer(rng, min(len(parts), 220))
    bit = integer(rng, 32)
    return b"".join([*parts[:number], flipped_at(parts[number], bit), *parts[number + 1 :]])


def lengths_and_contents(parts: Pieces, rng: Rng) -> bytes:
    """Several bits of some of the last records."""
    parts = list(parts)
    for _ in range(int(rng.integers(2, 5))):
        number = len(parts) - 1 - integer(rng, 6)
        parts[number] = flipped(parts[number], rng)
    return b"".join(parts)


def doubled(parts: Pieces, rng: Rng) -> bytes:
    number = integer(rng, len(parts))
    place = int(rng.integers(1, len(parts) + 1))
    return b"".join([*parts[:place], parts[number], *parts[place:]])


def swapped(parts: Pieces, rng: Rng) -> bytes:
    one, other = rng.choice(len(parts), 2, replace=False)
    parts = list(parts)
    parts[one], parts[other] = parts[other], parts[one]
    return b"".join(parts)


def left_out(parts: Pieces, rng: Rng) -> bytes:
    """A record that others follow."""
    number = int(rng.integers(1, len(parts) - 1))
    return b"".join([*parts[:number], *parts[number + 1 :]])


def strange_records(parts: Pieces, rng: Rng) -> bytes:
    """Whole ones that say what no journal says, in the chain and out of it."""
    short_tick = b"\x96\xa1t\0\1\x91\0\x90\xa1a"
    payload = pick(rng, (DEEP, b"", b"\x90", b"\xc0", short_tick, b"\x92\xa1q\x80", bomb(rng), rng.bytes(40)))
    place = int(rng.integers(1, len(parts) + 1))
    after = struct.unpack_from("<I", parts[place - 1], 4)[0]
    strange = pick(rng, (frame_payload(payload), chained([payload], after), frame_payload(payload, after)[:-1]))
    return b"".join([*parts[:place], strange, *(parts[place:] if rng.random() < 0.5 else [])])


def huge_lengths(parts: Pieces, rng: Rng) -> bytes:
    size = pick(rng, (0, 1, 7, 1 << 16, MAX_RECORD_BYTES, MAX_RECORD_BYTES + 1, (1 << 31) - 1, (1 << 32) - 1))
    rest = pick(rng, (b"", rng.bytes(50), bytes(70_000), zlib.compress(bytes(1 << 20)), rng.bytes(70_000)))
    return b"".join([*parts, struct.pack("<II", size, integer(rng, 1 << 32)), rest])


def a_swollen_end(parts: Pieces, rng: Rng) -> bytes:
    after = struct.unpack_from("<I", parts[-1], 4)[0]
    return swollen(b"".join(parts), rng, lambda payload: frame_payload(payload, after))


def another_header(parts: Pieces, rng: Rng) -> bytes:
    head = header_to_bytes(HEADER)
    other = pick(rng, (bomb(rng), head.replace(b"log-1", b"log-2"), head[:-5], head.replace(b"wcsim", b"xcsim"), DEEP))
    return b"".join([frame_payload(other), *parts[1:]])


# --- metrics and events ---


def some_metrics(path: Path) -> Pieces:
    """The lines of a sound file."""
    metrics = MetricsFile(path)
    for step in range(10, 200, 10):
        row = {"step": step, "episode": step // 10, "kpi1": step / 7.0, "crash_reason": "a,b"}
        metrics.add({**dict.fromkeys(COLUMNS), **row})
    return path.read_bytes().splitlines(keepends=True)


def check_metrics(path: Path, data: bytes, whole: bytes) -> bool:
    """What can be read is all that is there, and is there again after it was gone on with."""
    del whole
    try:
        rows = read_metrics(path)
        last = int(rows[-1]["step"]) if rows else 0
        MetricsFile(path, last_step=last)
    except Exception:
        if path.read_bytes() != data:
            return False
        raise
    return read_metrics(path) == rows


def some_events(path: Path) -> Pieces:
    path.mkdir()
    log = EventLogWriter(path)
    for number in range(20):
        log.add("death", who=f"c{number}", code=-9)
    return (path / EVENTS).read_bytes().splitlines(keepends=True)


def check_events(path: Path, data: bytes, whole: bytes) -> bool:
    """Every line is told, and the next one is a line of its own."""
    del whole
    before = read_events(path.parent)
    EventLogWriter(path.parent).add("recovery", who="a")
    after = read_events(path.parent)
    torn = bool(data) and not data.endswith(b"\n")
    return (
        len(before) == data.count(b"\n")
        and after[: len(before)] == before
        and len(after) == len(before) + torn + 1
        and after[-1]["event"] == "recovery"
    )


def a_bomb(parts: Pieces, rng: Rng) -> bytes:
    place = integer(rng, len(parts) + 1)
    return b"".join([*parts[:place], bomb(rng), b"\n", *parts[place:]])


MAKERS: dict[str, Callable[[Path], Pieces]] = {
    "journals": a_journal, "ledgers": a_ledger, "metrics": some_metrics, "events": some_events,
}  # fmt: skip
SPOILS: dict[str, tuple[Spoil, ...]] = {
    "journals": (
        any_damage, any_damage, any_damage, a_flip_near_the_end, a_flipped_length, a_flipped_length,
        lengths_and_contents, doubled, swapped, left_out, strange_records, huge_lengths,
        a_swollen_end, another_header,
    ),
    "ledgers": (any_damage, any_damage, any_damage, lengths_and_contents, doubled, swapped, left_out),
    "metrics": (any_damage, any_damage, doubled, swapped, a_bomb),
    "events": (any_damage, any_damage, doubled, a_bomb),
}  # fmt: skip
CHECKS: dict[str, Callable[[Path, bytes, bytes], bool]] = {
    "journals": check_log, "ledgers": check_log, "metrics": check_metrics, "events": check_events,
}  # fmt: skip
