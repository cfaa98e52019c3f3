"""A drive on disk: what is recorded is read, a killed one keeps what was driven, what cannot be a drive is refused."""

import json
import math
import struct

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.log.drives import drive_header, tick, write_drive
from tests.support.framing import chained
from wcsim.config import resolve
from wcsim.errors import ConfigError, JournalError, WcsimError
from wcsim.log.drive import read_drive
from wcsim.log.framing import frame_payload
from wcsim.log.reader import is_log_file, read_header
from wcsim.log.records import (
    Ended,
    Note,
    header_to_bytes,
    make_ticked_record,
    record_from_bytes,
    record_to_bytes,
    with_fields,
)
from wcsim.log.writer import LogWriter
from wcsim.types import Joystick

FLAGS = ("warning", "intervening", "overruled", "helped", "arrived", "gave_up", "crashed", "truncated")
FAR = {"p_W_m": [1.0, 1e300], "yaw_rad": 0.0, "goal_W_m": [0.0, 0.0]}
STARTS = ({"p_W_m": [1.0], "yaw_rad": 0.0}, FAR)
UNIT = st.floats(-1.0, 1.0)


def test_what_is_recorded_is_read(tmp_path):
    ticks = [tick(1), tick(2, intent=None, helped=True), tick(3, crashed=True), tick(4, episode=1)]
    events = (Note(tick=0, time_s=0.0, kind="help", detail="a" * 1000),)
    path = write_drive(tmp_path / "deep" / "a.drive", ticks, events)
    drive = read_drive(path)
    assert drive.header == drive_header() == read_header(path)
    assert [item.tick for item in drive.ticks] == [1, 2, 3, 4]
    assert drive.ticks[0] == with_fields(ticks[0], sticks=ticks[0].sticks)
    assert drive.events == events
    assert (drive.ticks[1].intent, drive.ticks[1].helped, drive.knows_intents, drive.has_truncated_end) == (
        None,
        True,
        False,
        False,
    )
    assert [len(part) for part in drive.episodes] == [3, 1]
    assert [item.ends for item in drive.ticks] == [False, False, True, False]
    assert is_log_file(path)
    path.write_bytes(path.read_bytes()[:-7])
    drive = read_drive(path)
    assert (len(drive.ticks) + len(drive.events), drive.has_truncated_end) == (4, True)


def test_a_tick_with_as_many_steps_as_a_world_may_have_is_kept_whole(tmp_path):
    steps = resolve("quick", ("world.tick_s=1.0", "world.substeps=480")).world.finest_substeps
    sticks = np.linspace(-0.5, 0.5, 2 * steps).reshape(steps, 2)
    (kept,) = read_drive(write_drive(tmp_path / "a.drive", [tick(1, sticks=sticks)], tick_s=1.0)).ticks
    assert np.allclose(kept.sticks, sticks, atol=1e-7) and kept.sticks.shape == (480, 2)


@pytest.mark.parametrize("wrong", [{"seed": 1 << 63}, {"seed": -1}, {"tick_s": float("nan")}])
def test_a_header_that_could_not_be_read_again_begins_no_recording(tmp_path, wrong):
    with pytest.raises(ConfigError, match=r"a\.drive: its header is out of bounds .*change seed, tick or steps"):
        LogWriter(tmp_path / "a.drive", drive_header(**wrong))
    assert not list(tmp_path.iterdir())


@given(UNIT, UNIT, st.sets(st.sampled_from(FLAGS)), st.integers(-1, 80), st.integers(0, 30))
def test_a_tick_is_the_same_after_it_was_bytes(x, y, flags, action, samples):
    sticks = np.linspace(-1.0, 1.0, 2 * samples).reshape(-1, 2).astype(np.float32).astype(float)
    made = tick(5, stick=Joystick(x, y), action=action, sticks=sticks, **dict.fromkeys(flags, True))
    assert record_from_bytes(record_to_bytes(made)) == made


@pytest.mark.parametrize(
    "change, says",
    [
        ({"magic": "wcsim-log-2"}, "is of format 'wcsim-log-2'; expected 'wcsim-log-1'"),
        ({"tick_s": 0.0}, "header cannot be used"),
        ({"tick_s": "0.1"}, "header cannot be used"),
        ({"seed": -1}, "header cannot be used"),
        ({"seed": True}, "header cannot be used"),
        ({"town": 3}, "header cannot be used"),
        ({"seats": 65}, "header cannot be used"),
        ({"seats": 0}, "header cannot be used"),
        ({"config": ""}, "header cannot be used"),
        ({"drive": {"wcsim": "1", "profile": "p", "max_steps": 1}}, "header cannot be used"),
        ({"more": 1}, "header cannot be used"),
        ({"drive": None}, "is not a drive but a journal"),
        ({"drive": None, "config": ""}, "is not a drive but a trace"),
        ({"magic": "other"}, "is not a log"),
    ],
)
def test_a_header_that_cannot_be_is_refused(tmp_path, change, says):
    data = json.loads(header_to_bytes(drive_header())) | change
    (tmp_path / "a.drive").write_bytes(chained([json.dumps(data).encode(), record_to_bytes(tick(1))]))
    with pytest.raises(JournalError, match=says):
        read_drive(tmp_path / "a.drive")


def with_field(place, value):
    """A second tick whose record has something else at one place."""
    fields = msgspec.msgpack.decode(record_to_bytes(tick(2)))
    fields[place] = value
    return msgspec.msgpack.encode(fields)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"X",
        b"\xdc\x00\x18\xa1k" + bytes(20),
        record_to_bytes(tick(2))[:-3],
        record_to_bytes(tick(2)) + bytes(8),
        msgspec.msgpack.encode(["n"]),
        msgspec.msgpack.encode(["n", 1, 0.1, 3, ""]),
        msgspec.msgpack.encode(["n", 1, 0.1, "a" * 99, ""]),
        with_field(3, math.nan),
        with_field(3, -0.1),
        with_field(4, {"x": 1.1, "y": 0.0}),
        with_field(6, [[2, 2], 4, bytes(15)]),
        with_field(6, [[481, 2], 4, bytes(481 * 8)]),
        with_field(6, [[1, 2], 8, struct.pack("<2d", 1.1, 0.0)]),
        with_field(6, [[2, 1], 4, bytes(8)]),
        with_field(6, [[0, -1], 4, b""]),
        with_field(6, [[1 << 62, 0], 4, b""]),
        with_field(9, 1 << 20),
        with_field(10, [[3], 8, struct.pack("<3d", math.inf, 0.0, 0.0)]),
        with_field(10, [[2], 8, bytes(16)]),
        *(msgspec.msgpack.encode(["r", 0, 1, 0, start]) for start in STARTS),
        record_to_bytes(Ended()),
        record_to_bytes(make_ticked_record(0, 2, (), "")),
        record_to_bytes(tick(7)),
        record_to_bytes(tick(2, time_s=0.05)),
    ],
)
def test_a_record_that_cannot_be_is_refused(tmp_path, payload):
    records = [header_to_bytes(drive_header()), record_to_bytes(tick(1)), payload]
    (tmp_path / "a.drive").write_bytes(chained(records))
    with pytest.raises(JournalError, match=r"does not belong in a log|belongs in no drive|does not follow tick 1"):
        read_drive(tmp_path / "a.drive")


def test_numbers_that_no_reader_takes_are_not_written(tmp_path):
    with LogWriter(tmp_path / "a.drive", drive_header()) as recorder:
        recorder.append(tick(1))
        for wrong in ({"yaw_rad": np.nan}, {"stick": Joystick(1.1, 0.0)}, {"p_WB_m": np.array([1e12, 0.0, 0.0])}):
            with pytest.raises(WcsimError, match="a number is not finite or out of its bounds"):
                recorder.append(tick(2, **wrong))
        recorder.append(tick(2))
    assert len(read_drive(tmp_path / "a.drive").ticks) == 2
    with pytest.raises(WcsimError, match="closed"):
        recorder.append(tick(3))


def test_what_is_no_log_is_not_taken_for_a_drive(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,x,y\n0,0,0\n")
    (tmp_path / "a.txt").write_bytes(frame_payload(b"{}"))
    assert not any(is_log_file(path) for path in (*tmp_path.iterdir(), tmp_path, tmp_path / "none"))
    for path in tmp_path.iterdir():
        with pytest.raises(JournalError, match="is not a log"):
            read_drive(path)


def test_a_drive_is_never_longer_than_what_can_be_read(tmp_path, monkeypatch):
    monkeypatch.setattr("wcsim.log.writer.MOST_RECORDS", 3)
    monkeypatch.setattr("wcsim.log.drive.MOST_RECORDS", 3)
    with LogWriter(tmp_path / "a.drive", drive_header()) as recorder:
        for number in range(3):
            recorder.append(tick(number + 1))
        with pytest.raises(WcsimError, match="is full, with 3 records"):
            recorder.append(tick(4))
    assert len(read_drive(tmp_path / "a.drive").ticks) == 3
