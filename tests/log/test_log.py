import math
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.framing import chained, last_crc, read_whole, write_log
from wcsim.errors import ConfigError, DiskFullError, WcsimError
from wcsim.log.diff import find_log_difference
from wcsim.log.framing import frame_payload
from wcsim.log.reader import hash_log, iter_journal_inputs, iter_journal_part_inputs, read_header
from wcsim.log.records import (
    Admitted,
    Dismissed,
    Ended,
    EpochBegun,
    Header,
    Input,
    Respawned,
    Ticked,
    header_from_bytes,
    header_to_bytes,
    make_ticked_record,
    record_from_bytes,
    with_fields,
)
from wcsim.log.writer import LogWriter
from wcsim.types import Command, Joystick, SeatSpec, StartSpec

pack = msgspec.msgpack.encode
HEADER = Header(
    name="run",
    town="/somewhere/corner",
    town_sha256="ab" * 32,
    config='{"world": {"tick_s": 0.1}}',
    seed=7,
    seats=3,
    tick_s=0.1,
    fingerprint="numpy-1",
)
START = StartSpec(p_W_m=(1.5, -0.1), yaw_rad=0.1 + 0.2, goal_W_m=(1e-300, 3.0))


def tick(number: int, seats: tuple[int, ...] = (0, 1, 2), epoch: int = 0) -> Ticked:
    sticks = np.random.Generator(np.random.Philox(number)).uniform(-1.0, 1.0, (len(seats), 2)).tolist()
    commands = tuple(
        Command(seat=seat, tick=number - 1, joystick=Joystick(x, y)) for seat, (x, y) in zip(seats, sticks, strict=True)
    )
    return make_ticked_record(epoch, number, commands, f"{number * 0x9E3779B97F4A7C15:016x}"[-16:])


RECORDS: tuple[Input, ...] = (
    EpochBegun(epoch=0, seed=11),
    Admitted(epoch=0, tick=0, seat=1, spec=SeatSpec(max_steps=9, truth=True, start=START), name="zoë \n"),
    tick(1, (1,)),
    Respawned(epoch=0, tick=1, seat=1),
    tick(2, (1,)),
    Dismissed(epoch=0, tick=2, seat=1, reason="left"),
    tick(3, ()),
    EpochBegun(epoch=1, seed=12, fresh=True),
    Ended(reason="done"),
)


def write(path: Path, records=RECORDS, header=HEADER) -> str:
    return hash_log(write_log(path, header, records))


def test_commands_come_back_to_the_last_bit(path):
    sticks = [(-0.0, 5e-324), (0.1 + 0.2, -1.0), (1.0, 0.25)]
    commands = tuple(Command(seat=i, tick=4, joystick=Joystick(x, y)) for i, (x, y) in enumerate(sticks))
    write(path, [make_ticked_record(0, 5, commands, "ff")])
    (got,) = read_whole(path).records
    assert isinstance(got, Ticked)
    assert [(c.seat, c.tick) for c in got.commands] == [(0, 4), (1, 4), (2, 4)]
    assert [(c.joystick.x.hex(), c.joystick.y.hex()) for c in got.commands] == [(x.hex(), y.hex()) for x, y in sticks]


def test_text_that_would_fill_the_memory_is_not_parsed():
    bomb = b'{"a": [' + b"[]," * (1 << 19) + b"[]]}"
    with pytest.raises(WcsimError, match="bytes of JSON; expected at most"):
        header_from_bytes(header_to_bytes(HEADER)[:-1] + b", " + bomb[1:])
    with pytest.raises(WcsimError, match="is not a log"):
        header_from_bytes(bomb)
    for record in (pack(["a", *[[]] * (1 << 21)]), pack(["t", 0, 1, [0] * (1 << 21), [], "ff"])):
        with pytest.raises(WcsimError, match="bytes; expected at most"):
            record_from_bytes(record)


def test_a_tick_of_three_seats_is_small(tmp_path):
    write(tmp_path / "none", ())
    write(tmp_path / "many", [tick(n) for n in range(9000, 9100)])
    assert ((tmp_path / "many").stat().st_size - (tmp_path / "none").stat().st_size) / 100 <= 150


def test_the_digest_is_that_of_what_happened_and_of_nothing_else(tmp_path):
    digest = write(tmp_path / "a")
    elsewhere = with_fields(HEADER, name="other", town="/elsewhere", fingerprint="numpy-2")
    assert write(tmp_path / "b", header=elsewhere) == digest == hash_log(tmp_path / "a")
    renamed = {1: with_fields(RECORDS[1], name="4711"), 5: with_fields(RECORDS[5], reason="silent for 1.2 s")}
    assert write(tmp_path / "c", [renamed.get(number, record) for number, record in enumerate(RECORDS)]) == digest
    assert find_log_difference(tmp_path / "a", tmp_path / "b") == ""
    assert find_log_difference(tmp_path / "a", tmp_path / "c") == ""
    others = [
        write(tmp_path / "shorter", RECORDS[:-1]),
        write(tmp_path / "swapped", (*RECORDS[:-2], *RECORDS[:-3:-1])),
        write(tmp_path / "hash", [with_fields(r, state_hash="0") if isinstance(r, Ticked) else r for r in RECORDS]),
        *(
            write(tmp_path / name, header=with_fields(HEADER, **{name: value}))
            for name, value in {"seed": 8, "config": "{}", "town_sha256": "", "seats": 4, "hook": "a:B"}.items()
        ),
    ]
    assert len({digest, *others}) == 1 + len(others)


def test_a_journal_is_gone_on_with_where_it_was_torn(tmp_path, path):
    whole = tmp_path / "whole"
    digest = write(whole)
    for cut in (1, 7, 20):
        path.write_bytes(whole.read_bytes()[:-cut])
        assert read_whole(path).torn
        assert read_whole(path).records == RECORDS[:-1]
        with LogWriter.append_to(path) as writer:
            writer.append(RECORDS[-1])
            assert hash_log(path) == digest
        assert path.read_bytes() == whole.read_bytes()
    path.write_bytes(whole.read_bytes() + bytes(3 * 4096))  # pages that a machine had no time to write
    LogWriter.append_to(path).close()
    assert path.read_bytes() == whole.read_bytes()


def test_a_journal_is_never_written_over(tmp_path, path):
    write(path)
    before = path.read_bytes()
    with pytest.raises(ConfigError, match="exists"):
        LogWriter(path, HEADER)
    with pytest.raises(ConfigError, match="choose the name of a new file"):
        LogWriter(path / "k", HEADER)
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match="link"):
        LogWriter(tmp_path / "link", HEADER)
    assert path.read_bytes() == before


def test_a_closed_journal_says_so(path):
    writer = LogWriter(path, HEADER)
    writer.close()
    writer.close()
    with pytest.raises(WcsimError, match="closed"):
        writer.append(RECORDS[0])


def test_every_record_can_be_read_as_soon_as_it_is_written(path):
    with LogWriter(path, HEADER) as writer:
        reading = iter_journal_inputs(path)
        for count, record in enumerate(RECORDS, start=1):
            writer.append(record)
            assert next(reading) == record
            assert len(read_whole(path).records) == count


@pytest.mark.parametrize(
    "data", [b"", b"hello", bytes(64), frame_payload(b"{}"), frame_payload(b"[1]"), frame_payload(b"\xff"), None]
)
def test_something_else_is_refused(path, data):
    if data is not None:
        path.write_bytes(data)
    for read in (read_header, read_whole, hash_log, LogWriter.append_to):
        with pytest.raises(WcsimError, match=r"j: .*(not a log|cannot be read)"):
            read(path)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        pack([]),
        pack(["q", {}]),
        pack(["e", 1]),
        pack(["e", "1", 2, False]),
        pack(["e", 1, 2, False, 0]),
        pack(["e", 1, -1, False]),
        pack(["a", 0, 0, 0, {"max_steps": "many"}, "", ""]),
        pack(["a", 0, 0, 0, {"start": {"p_W_m": [1.0, math.nan], "yaw_rad": 0.0, "goal_W_m": [0.0, 1.0]}}, "", ""]),
        pack(["t", 0, 1, [0], [], "ab"]),
        pack(["t", 0, 1, 0, [], "ab"]),
        pack(["t", 0, 1, [64], [[0.0, 0.0]], "ab"]),
        pack(["t", 0, 1, [0], [[math.nan, 0.0]], "ab"]),
        pack(["t", 0, 1, list(range(64)) * 2, [[0.0, 0.0]] * 128, "ab"]),
        b"\x91" * 4_000,
        pack(["z", b"\xff"]),
    ],
)
def test_a_whole_record_that_is_none_is_refused(path, payload):
    write(path, RECORDS[:2])
    last = last_crc(path)
    with path.open("ab") as file:
        file.write(chained([payload], last))
    with pytest.raises(WcsimError, match=r"j: after \d+ bytes"):
        read_whole(path)


@given(data=st.binary(max_size=200))
def test_no_payload_raises_anything_else(data):
    for payload in (data, b"\x96\xa1t" + data, b"\x97\xa1a" + data, b"\x9b\xa1s" + data):
        try:
            record_from_bytes(payload)
        except WcsimError:
            continue


@given(cut=st.integers(min_value=0, max_value=2000), flips=st.lists(st.integers(min_value=0, max_value=16000)))
def test_damage_leaves_a_prefix_or_an_error_of_ours(tmp_path_factory, cut, flips):
    path = tmp_path_factory.mktemp("damaged") / "j"
    write(path)
    data = bytearray(path.read_bytes())
    for bit in flips:
        data[bit // 8 % len(data)] ^= 1 << bit % 8
    path.write_bytes(bytes(data[: max(0, len(data) - cut)]))
    try:
        journal = read_whole(path)
    except WcsimError:
        return
    assert journal.records == RECORDS[: len(journal.records)]
    assert journal.torn or journal.records == RECORDS or cut


FILL = """
import resource, sys
from pathlib import Path
from tests.log.test_log import HEADER, tick
from wcsim.errors import DiskFullError
from tests.support.framing import read_whole
from wcsim.log.reader import hash_log
from wcsim.log.writer import LogWriter
path = Path(sys.argv[1])
soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
with LogWriter(path, HEADER) as writer:
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 1000, hard))
    written = 0
    try:
        while written < 100:
            writer.append(tick(written + 1))
            written += 1
    except DiskFullError as error:
        print(error)
    journal = read_whole(path)
    assert (len(journal.records), journal.torn) == (written, False), journal
    assert 5 < written < 20
    assert hash_log(path) == hash_log(path)
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    writer.append(tick(written + 1))
assert len(read_whole(path).records) == written + 1
assert hash_log(path) == hash_log(path)
"""


def apart(code: str, path: Path) -> subprocess.CompletedProcess[str]:
    """Run this in a process of its own."""
    words = [sys.executable, "-c", code, str(path)]
    return subprocess.run(words, capture_output=True, text=True, cwd=Path(__file__).parents[3], check=False)


def test_a_full_disk_leaves_whole_records_and_can_be_gone_on_with(path):
    done = apart(FILL, path)
    assert done.returncode == 0, done.stderr
    assert "could not be written (File too large)" in done.stdout


def test_a_journal_that_cannot_begin_leaves_no_file(path, monkeypatch):
    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fdatasync", fails)
    with pytest.raises(DiskFullError, match="No space left"):
        LogWriter(path, HEADER)
    assert not path.exists()


KILLED = """
import os, signal, sys
from pathlib import Path
from tests.log.test_log import HEADER, tick
from wcsim.log.writer import LogWriter
writer = LogWriter(Path(sys.argv[1]), HEADER)
for number in range(1, 200):
    writer.append(tick(number))
    os.write(1, b"%d\\n" % number)
    if number == 123:
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_process_loses_nothing_that_was_acknowledged(path):
    done = apart(KILLED, path)
    assert done.returncode == -9, done.stderr
    acknowledged = int(done.stdout.split()[-1])
    assert acknowledged == 123
    assert read_whole(path).records == tuple(tick(n) for n in range(1, acknowledged + 1))


def test_a_journal_has_one_writer_at_a_time(path):
    with LogWriter(path, HEADER) as writer:
        writer.append(RECORDS[0])
        with pytest.raises(ConfigError, match="another process is writing this log"):
            LogWriter.append_to(path)
        writer.append(RECORDS[1])
    with LogWriter.append_to(path) as writer:
        writer.append(RECORDS[2])
    assert read_whole(path).records == RECORDS[:3]


def test_a_journal_is_read_without_its_ticks(path):
    write(path)
    assert list(iter_journal_part_inputs(path, ticks=False)) == [r for r in RECORDS if not isinstance(r, Ticked)]
