from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.bridge.recording.trace import TickRecord, TraceHeader, TraceWriter
from wcsim.bridge.recording.trace_diff import difference
from wcsim.bridge.recording.trace_file import read_trace
from wcsim.errors import WcsimError
from wcsim.users.recording.framing import framed, whole_records

HEADER = TraceHeader(name="t", seed=1, tick_s=0.1, seats=2, fingerprint="a")


def record(tick: int, shift: float = 0.0, actors: tuple[str, ...] = ("v:a", "p:b")) -> TickRecord:
    rng = np.random.Generator(np.random.Philox(tick))
    return TickRecord(
        epoch=0,
        tick=tick,
        commands=rng.random((2, 2)),
        plants=rng.random((2, 15)) + shift,
        actor_ids=actors,
        actors=rng.random((len(actors), 8)),
        state_hash=f"{tick}-{shift}",
    )


def write(path, records, header=HEADER):
    with TraceWriter(path, header) as writer:
        for item in records:
            writer.append(item)


def test_a_tick_of_a_great_city_is_read_and_names_with_any_blank(tmp_path):
    names = tuple(f"v:Gare\u00a0Sud.{number:060d}" for number in range(20_000))
    write(tmp_path / "a", [record(0, actors=names)])
    assert read_trace(tmp_path / "a")[1][0].actor_ids == names


def test_what_was_written_is_read(tmp_path):
    records = [record(0), record(1, actors=())]
    write(tmp_path / "a", records)
    header, back = read_trace(tmp_path / "a")
    assert header == HEADER
    for old, new in zip(records, back, strict=True):
        assert (old.tick, old.actor_ids, old.state_hash) == (new.tick, new.actor_ids, new.state_hash)
        assert np.array_equal(old.plants, new.plants)
        assert np.array_equal(old.actors, new.actors)
        assert np.array_equal(old.commands, new.commands)


@given(cut=st.integers(min_value=1, max_value=400))
def test_a_torn_end_loses_the_last_records_only(tmp_path_factory, cut):
    path = tmp_path_factory.mktemp("torn") / "a"
    write(path, [record(i) for i in range(5)])
    data = path.read_bytes()
    path.write_bytes(data[:-cut])
    assert [item.tick for item in read_trace(path)[1]] == list(range(len(read_trace(path)[1])))
    assert len(read_trace(path)[1]) < 5


def test_a_tick_that_holds_what_no_writer_writes_is_refused(tmp_path):
    write(tmp_path / "a", [record(0)])
    first = next(whole_records(io.BytesIO((tmp_path / "a").read_bytes())))
    line = json.dumps({"epoch": 0, "tick": 0, "seats": 0, "actors": [], "hash": ""})
    many = f', "at": {list(range(1_500_000))}'
    for more, says in (("", ""), (', "more": [1]', "of this version"), (many, "characters of JSON")):
        data = (tmp_path / "a").read_bytes()[: first.end] + framed((line[:-1] + more + "}\n").encode())
        (tmp_path / "b").write_bytes(data)
        if says:
            with pytest.raises(WcsimError, match=says):
                read_trace(tmp_path / "b")
        else:
            assert len(read_trace(tmp_path / "b")[1]) == 1


@pytest.mark.parametrize("name", ["v:\x00", "v:a\x1b[2J", "p:\u202e", "v:a\nb"])
def test_a_name_that_no_xml_can_hold_is_refused(tmp_path, name):
    write(tmp_path / "a", [record(0, actors=(name, "p:b"))])
    with pytest.raises(WcsimError, match="not a trace of this version"):
        read_trace(tmp_path / "a")


def test_something_else_is_refused(tmp_path):
    (tmp_path / "a").write_text("hello")
    with pytest.raises(WcsimError, match="not a trace"):
        read_trace(tmp_path / "a")


def test_difference_is_exact_within_a_version_and_tolerant_across(tmp_path):
    write(tmp_path / "a", [record(1), record(2)])
    write(tmp_path / "same", [record(1), record(2)])
    write(tmp_path / "near", [record(1), record(2, shift=1e-5)])
    assert difference(tmp_path / "same", tmp_path / "a") == ""
    assert "tick 2" in difference(tmp_path / "near", tmp_path / "a")
    other = TraceHeader(name="t", seed=1, tick_s=0.1, seats=2, fingerprint="b")
    write(tmp_path / "far", [record(1), record(2, shift=0.1)], other)
    write(tmp_path / "near", [record(1), record(2, shift=1e-5)], other)
    assert difference(tmp_path / "near", tmp_path / "a") == ""
    assert "chair" in difference(tmp_path / "far", tmp_path / "a")


def test_difference_tells_how_far_two_traces_go(tmp_path):
    write(tmp_path / "a", [record(10), record(20)])
    write(tmp_path / "short", [record(10)])
    write(tmp_path / "longer", [record(10), record(22)])
    write(tmp_path / "none", [])
    told = difference(tmp_path / "short", tmp_path / "a")
    assert told == "its records are 1, up to tick 10, those of the golden trace 2, up to tick 20"
    assert "up to tick 22, those" in difference(tmp_path / "longer", tmp_path / "a")
    assert "its records are none, those" in difference(tmp_path / "none", tmp_path / "a")


@pytest.mark.parametrize("chairs", [1, 3])
@pytest.mark.parametrize("fingerprint", ["a", "b"])
def test_difference_tells_another_number_of_chairs(tmp_path, chairs, fingerprint):
    """One chair against two would be compared with each of them, three against two with nothing."""
    of_two = record(1)
    plants = np.repeat(of_two.plants[:1], chairs, axis=0)
    write(tmp_path / "a", [replace(of_two, plants=plants[[0, 0]])])
    changed = replace(of_two, plants=plants, commands=np.zeros((chairs, 2)), state_hash="0")
    write(tmp_path / "other", [changed], replace(HEADER, seats=chairs, fingerprint=fingerprint))
    assert difference(tmp_path / "other", tmp_path / "a") == f"tick 1: the number of chairs is {chairs}, golden 2"
