from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.framing import read_whole, write_log
from tests.support.journals import SPEC, JournaledWorld, eventful_run, nudged, rewritten
from wcsim.bridge.recording.convert import convert_to_fcd
from wcsim.bridge.replay.player import Seats
from wcsim.bridge.replay.replayed import replayed, verify, worlds_of
from wcsim.bridge.sumo.session import world_in_this_process
from wcsim.drive.playing.sources.replay_source import _replay_about
from wcsim.errors import ConfigError, ReplayMismatchError, TownError, WcsimError
from wcsim.log.diff import find_log_difference
from wcsim.log.reader import hash_log, read_header, read_trace_states
from wcsim.log.records import (
    Admitted,
    Dismissed,
    Ended,
    EpochBegun,
    Header,
    Respawned,
    Ticked,
    make_ticked_record,
    with_fields,
)
from wcsim.towns.scenario.town import find_town, towns_hash
from wcsim.towns.scene_folders.build import build_scene, find_scene


@pytest.fixture(scope="module")
def run(corner, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("journaled")
    facts = eventful_run(corner, folder)
    assert facts["episodes"] >= 2  # that ended within a tick
    assert facts["digest"] == hash_log(folder / "journal")
    return folder


@pytest.fixture(scope="module")
def records(run):
    return read_whole(run / "journal").records


def test_who_is_in_after_the_records_of_a_journal():
    def came(seat, tick, name):
        return Admitted(epoch=0, tick=tick, seat=seat, spec=SPEC, name=name)

    seats = Seats()

    def kept(*records):
        for record in records:
            seats.note(record)
        return [(seat, one.name) for seat, one in sorted(seats.taken.items())]

    begun = EpochBegun(epoch=0, seed=1, fresh=True)
    assert kept(begun, came(1, 0, "b"), came(0, 0, "a")) == [(0, "a"), (1, "b")]
    assert seats.specs(3) == (SPEC, SPEC, None)
    assert kept(make_ticked_record(0, 1, (), ""), Dismissed(epoch=0, tick=1, seat=0)) == [(1, "b")]
    assert kept(Respawned(epoch=0, tick=1, seat=1), EpochBegun(epoch=1, seed=2)) == [(1, "b")]
    assert kept(Dismissed(epoch=1, tick=0, seat=1), came(1, 0, "c")) == [(1, "c")]
    assert kept(EpochBegun(epoch=2, seed=2, fresh=True)) == []


def place_of(records, epoch: int, tick: int) -> int:
    return next(i for i, r in enumerate(records) if isinstance(r, Ticked) and (r.epoch, r.tick) == (epoch, tick))


def test_a_whole_run_is_made_again_state_by_state(run, records):
    assert [record for _, record in replayed(run / "journal")] == list(records)
    result = verify(run / "journal")
    assert (result.ticks, result.mismatches) == (150, 0)
    assert not world_in_this_process()


def test_a_part_is_compared_from_the_beginning_of_its_epoch(run):
    done: list[int] = []
    result = verify(run / "journal", 1, 31, 40, done.append)
    assert (result.ticks, result.mismatches, result.first, done) == (10, 0, None, list(range(1, 11)))
    assert [record.epoch for _, record in replayed(run / "journal", 1, until_tick=3)] == [1] * 4


def test_one_bit_of_a_command_is_found_at_its_tick(run, records, tmp_path):
    at = place_of(records, 1, 12)
    other = rewritten(run / "journal", tmp_path / "journal", {at: nudged(records[at])})
    result = verify(other, 1, 0, None)
    assert result.first is not None
    assert (result.first.tick, result.ticks) == (12, 60)
    assert 1 <= result.mismatches <= 49
    assert verify(other, 1, 0, 11).mismatches == 0
    told = find_log_difference(run / "journal", other)
    assert told.startswith("Ticked (epoch 1, tick 12): seat 0 is commanded (")
    with pytest.raises(ReplayMismatchError):
        convert_to_fcd(other, tmp_path / "x.xml", 1)
    assert not world_in_this_process()


def test_a_new_world_after_a_crash_has_free_seats(corner, tmp_path):
    (tmp_path / "run").mkdir()
    with JournaledWorld(corner, tmp_path / "run") as it:
        it.admit(1)
        it.tick(3)
        it.world.rebuild(9)
        it.world.dismiss(1)
        it.writer.append(EpochBegun(epoch=1, seed=9, fresh=True))
        it.admit(2)
        it.tick(3)
        it.writer.append(Ended(reason="done"))
    assert verify(tmp_path / "run" / "journal", 1, 0, None).mismatches == 0
    assert verify(tmp_path / "run" / "journal", None, 0, None).ticks == 6


def test_a_run_is_the_same_floating_car_data_from_trace_and_journal(run, tmp_path):
    assert convert_to_fcd(run / "beside.trace", tmp_path / "trace.xml") == 90
    assert convert_to_fcd(run / "journal", tmp_path / "journal.xml") == 90
    assert (tmp_path / "trace.xml").read_bytes() == (tmp_path / "journal.xml").read_bytes()
    text = (tmp_path / "journal.xml").read_text()
    steps = text.split("<timestep")[1:]
    assert [name for name in ("wheelchair.0", "wheelchair.1") if name in steps[10]] == ["wheelchair.1"]
    with pytest.raises(WcsimError, match=r"no epoch 7; expected one of \[0, 1\]"):
        convert_to_fcd(run / "journal", tmp_path / "x.xml", 7)


def test_records_that_do_not_follow_from_each_other_are_refused(run, records, tmp_path):
    at = place_of(records, 0, 30)
    for change, told in (
        (with_fields(records[at], tick=31), "tick 31 follows epoch 0, tick 29; expected the next tick"),
        (Dismissed(epoch=0, tick=29, seat=2), "seat 2 is free"),
        (Admitted(epoch=0, tick=28, seat=2, spec=records[1 + 5].spec), "expected this one"),
    ):
        broken = rewritten(run / "journal", tmp_path / "journal", {at: change})
        with pytest.raises(WcsimError, match=told):
            list(replayed(broken, 0))
        assert not world_in_this_process()


def test_what_a_journal_is_made_of_must_still_be_there(run, tmp_path):
    header = read_header(run / "journal")
    for change, kind, told in (
        ({"town": "atlantis"}, TownError, "atlantis"),
        ({"town_sha256": "0"}, TownError, "a net has changed"),
        ({"config": "{"}, ConfigError, "the configuration in the journal"),
        ({"config": '{"wrld": 1}'}, ConfigError, "wrld"),
    ):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        write_log(path, with_fields(header, **change), ())
        with pytest.raises(kind, match=told):
            list(replayed(path))
    empty = write_log(tmp_path / "empty", header, ())
    with pytest.raises(WcsimError, match="no epoch: it is truncated"):
        list(replayed(empty))


def test_worlds_of_a_journal_of_several_towns_take_turns(run, corner, tmp_path, monkeypatch):
    words = (str(corner), build_scene(find_scene("two-chairs"), tmp_path / "two-chairs")[0].address)
    towns = [find_town(word) for word in words]
    header = with_fields(
        read_header(run / "journal"), town=words[0], more_towns=words[1:], town_sha256=towns_hash(towns)
    )
    monkeypatch.setattr("wcsim.bridge.replay.replayed.World", lambda town, *given, epoch, find_user: town)
    make = worlds_of(header)
    assert [make((None,), 0, epoch) for epoch in range(3)] == [*towns, towns[0]]
    about = [_replay_about(header, 9, epoch=epoch) for epoch in (None, 1)]
    assert [film.town for film in about] == [town.address for town in towns]
    assert all("change towns" in film.unknown[-1] for film in about)
    with pytest.raises(TownError, match="a net has changed"):
        worlds_of(with_fields(header, more_towns=words[:1]))


def test_the_first_difference_of_two_journals_is_told_in_words(run, records, tmp_path):
    header = read_header(run / "journal")

    def against(change=None, kept=records, head=header) -> str:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        changed = ((change or {}).get(number, record) for number, record in enumerate(kept))
        return find_log_difference(run / "journal", write_log(path, head, changed))

    last = len(records) - 1
    assert against() == ""
    assert against(head=with_fields(header, name="other", fingerprint="x")) == ""
    assert against(head=with_fields(header, seed=6)) == "header: seed is 5 and 6"
    assert "ends after Ticked (epoch 1, tick 59); the other one continues with Ticked (epoch 1, tick 60)" in against(
        kept=records[:-1]
    )
    assert against({last: with_fields(records[last], state_hash="ff")}).startswith(
        "Ticked (epoch 1, tick 60): state_hash"
    )
    one = place_of(records, 1, 60)
    assert "commands for seats [0, 1, 2] and [1, 2]" in against(
        {one: with_fields(records[one], seats=records[one].seats[1:], sticks=records[one].sticks[1:])}
    )
    assert against({1: Ended()}) == "Ticked (epoch 0, tick 1) against Ended"
    assert against({6: with_fields(records[6], name="x")}) == ""
    told = against({6: with_fields(records[6], spec=replace(records[6].spec, truth=True))})
    assert told.startswith("Admitted (epoch 0, tick 5, seat 1): spec is SeatSpec(profile='competent'")


def test_the_first_difference_of_two_traces_is_told_in_words(run, tmp_path):
    header, ticks = read_trace_states(run / "beside.trace")

    def against(kept=ticks, head: Header = header) -> str:
        (tmp_path / "other").unlink(missing_ok=True)
        return find_log_difference(run / "beside.trace", write_log(tmp_path / "other", head, kept))

    def with_other(**fields) -> list:
        return [*ticks[:40], with_fields(ticks[40], **fields), *ticks[41:]]

    assert against() == ""
    assert against(head=with_fields(header, fingerprint="x", name="y")) == ""
    assert against(head=with_fields(header, seed=6)) == "header: seed is 5 and 6"
    assert "ends after WorldState (epoch 0, tick 89); the other one continues with WorldState" in against(
        kept=ticks[:-1]
    )
    assert against(with_other(state_hash="0")).startswith("WorldState (epoch 0, tick 41): state ")
    assert against(with_other(commands=ticks[40].commands + 0.5)).startswith(
        "WorldState (epoch 0, tick 41): seat 0 is commanded ("
    )
    assert against(with_other(plants=ticks[40].plants + 0.5)).endswith("tick 41): seat 0 is 0.5 m away from the other")
    body, *others = ticks[40].bodies
    ids = ("v:x", *ticks[40].actor_ids[1:])
    told = against(with_other(actor_ids=ids, bodies=(with_fields(body, id="v:x"), *others)))
    assert told == f"WorldState (epoch 0, tick 41): actors {sorted([body.id, 'v:x'])} are in one trace only"
    assert against(with_other(epoch=1)) == "WorldState (epoch 0, tick 41) against WorldState (epoch 1, tick 41)"


def test_habits_that_were_drawn_for_episodes_are_drawn_again(corner, tmp_path):
    words = ("vary.attention={all=[0.0,1.0]}", "vary.reaction={all=[0.2,3.0]}")
    with JournaledWorld(corner, tmp_path, *words) as it:
        for number in (0, 1):
            it.admit(number)
        it.tick(30)
        it.respawn(0)
        it.tick(30)
        drawn = [client.drawn for client in it.now.clients]
    for world, record in replayed(tmp_path / "journal"):
        again, last = [client.drawn for client in world.snapshot.clients], record
    assert again == drawn
    assert last == read_whole(tmp_path / "journal").records[-1]
    assert len({one.reaction_s for one in drawn}) == len({one.attention for one in drawn}) == 2
