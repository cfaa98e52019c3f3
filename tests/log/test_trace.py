import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.framing import chained, payloads_of, write_log
from wcsim.errors import WcsimError
from wcsim.log.diff import find_golden_difference
from wcsim.log.reader import read_trace_states
from wcsim.log.records import Header, WorldState, with_fields

HEADER = Header(town="t", seed=1, tick_s=0.1, seats=2, fingerprint="a")


def record(tick: int, shift: float = 0.0, actors: tuple[str, ...] = ("v:a", "p:b")) -> WorldState:
    rng = np.random.Generator(np.random.Philox(tick))
    return WorldState(
        epoch=0,
        tick=tick,
        commands=rng.random((2, 2)),
        plants=rng.random((2, 15)) + shift,
        actor_ids=actors,
        actors=rng.random((len(actors), 8)),
        state_hash=f"{tick}-{shift}",
    )


def write(path, records):
    return write_log(path, HEADER, records)


@pytest.fixture
def difference(tmp_path_factory):
    """What tells a trace of records from a golden one."""

    def told(golden, records, header=HEADER) -> str:
        folder = tmp_path_factory.mktemp("traces")
        return find_golden_difference(write_log(folder / "a", header, records), write(folder / "golden", golden))

    return told


def test_a_tick_of_a_great_city_is_read_and_names_with_any_blank(tmp_path):
    names = tuple(f"v:Gare\u00a0Sud.{number:060d}" for number in range(20_000))
    write(tmp_path / "a", [record(0, actors=names)])
    assert read_trace_states(tmp_path / "a")[1][0].actor_ids == names


def test_what_was_written_is_read(tmp_path):
    records = [record(0), record(1, actors=())]
    write(tmp_path / "a", records)
    header, back = read_trace_states(tmp_path / "a")
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
    assert [item.tick for item in read_trace_states(path)[1]] == list(range(len(read_trace_states(path)[1])))
    assert len(read_trace_states(path)[1]) < 5


def test_a_tick_that_holds_what_no_writer_writes_is_refused(tmp_path, monkeypatch):
    write(tmp_path / "a", [record(0)])
    head, payload = payloads_of(tmp_path / "a")
    sound = msgspec.msgpack.decode(payload)
    for place, other, says in (
        (0, "s", ""),
        (1, -1, "does not belong"),
        (4, [[2, 15], 8, bytes(239)], "does not belong"),
        (4, [[1, 15], 8, bytes(120)], "does not belong"),
        (4, [[2, 15], 8, b"\xff" * 240], "does not belong"),
        (6, [[3, 8], 8, bytes(192)], "does not belong"),
        (9, [["v:a", "car", [1.0, 1.0, 1.0], 0]], "has no size of actor 'p:b'"),
        (9, [["v:a", "tank", [1.0, 1.0, 1.0], 0]], "does not belong"),
        (10, [0, 64], "does not belong"),
        (10, [0], "does not belong"),
    ):
        changed_record = [*sound[:place], other, *sound[place + 1 :]]
        (tmp_path / "b").write_bytes(chained([head, msgspec.msgpack.encode(changed_record)]))
        if says:
            with pytest.raises(WcsimError, match=says):
                read_trace_states(tmp_path / "b")
        else:
            assert len(read_trace_states(tmp_path / "b")[1]) == 1
    monkeypatch.setattr("wcsim.log.records._STATE_BYTES", 300)
    with pytest.raises(WcsimError, match="bytes; expected at most 300"):
        read_trace_states(tmp_path / "a")


@pytest.mark.parametrize("name", ["v:\x00", "v:a\x1b[2J", "p:\u202e", "v:a\nb"])
def test_a_name_that_no_xml_can_hold_is_refused(tmp_path, name):
    write(tmp_path / "a", [record(0, actors=(name, "p:b"))])
    with pytest.raises(WcsimError, match="does not belong in a log"):
        read_trace_states(tmp_path / "a")


def test_difference_is_exact_within_a_version_and_tolerant_across(difference):
    golden, near = [record(1), record(2)], [record(1), record(2, shift=1e-5)]
    assert difference(golden, golden) == ""
    assert "tick 2" in difference(golden, near)
    other = with_fields(HEADER, fingerprint="b")
    assert difference(golden, near, other) == ""
    assert "chair" in difference(golden, [record(1), record(2, shift=0.1)], other)


def test_difference_tells_how_far_two_traces_go(difference):
    golden = [record(10), record(20)]
    told = difference(golden, golden[:1])
    assert told == "its records are 1, up to tick 10, those of the golden trace 2, up to tick 20"
    assert "up to tick 22, those" in difference(golden, [record(10), record(22)])
    assert "its records are none, those" in difference(golden, [])


@pytest.mark.parametrize("chairs", [1, 3])
@pytest.mark.parametrize("fingerprint", ["a", "b"])
def test_difference_tells_another_number_of_chairs(difference, chairs, fingerprint):
    """One chair against two would be compared with each of them, three against two with nothing."""
    of_two = record(1)
    plants = np.repeat(of_two.plants[:1], chairs, axis=0)
    other = with_fields(of_two, plants=plants, commands=np.zeros((chairs, 2)), state_hash="0")
    header = with_fields(HEADER, seats=chairs, fingerprint=fingerprint)
    told = difference([with_fields(of_two, plants=plants[[0, 0]])], [other], header)
    assert told == f"tick 1: the number of chairs is {chairs}, golden 2"
