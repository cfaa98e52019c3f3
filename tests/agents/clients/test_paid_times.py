"""Who waited for whom, and what each client paid, over all lives of all processes."""

from dataclasses import replace

import pytest

from wcsim.agents.clients.paid_times import (
    WAITS,
    ClientTimeTotals,
    GroupRunTimes,
    GroupRunTimesFile,
    read_group_run_times,
)
from wcsim.errors import PolicyError
from wcsim.server.host.status import _names_of, _WaitingTimes
from wcsim.server.launch.states import ClientProcessState, ClientStatusReport, LaunchProcessStates, WorldStatusReport
from wcsim.server.protocol.members import RosterClient
from wcsim.types import SeatSpec
from wcsim.view.live_table import PAYS, _pays_of
from wcsim.view.report import training_page
from wcsim.view.report.training_page import _PAID, _waiting


def state(learned_s, waited_s, pid=1, names=("a", "b"), lives=(7, 8)):
    """Both clients have learned so long in this life, and a has waited so long for b in this life of the world."""
    times = {"inference_s": 1.0, "simulation_s": 2.0, "barrier_s": 3.0, "overlap_s": 1.0}
    status = {
        name: ClientStatusReport(name=name, learning_s=s, pid=life, **times)
        for name, s, life in zip(names, learned_s, lives, strict=True)
    }
    return LaunchProcessStates(
        elapsed_s=1.0,
        world_standing="running",
        world_pid=pid,
        world_restarts=0,
        world=WorldStatusReport(stage="collect", members=names, waited_s=((0.0, waited_s), (0.25, 0.0))),
        clients=tuple(
            ClientProcessState(name=n, seat=k, standing="running", status=status[n]) for k, n in enumerate(names)
        ),
    )


def test_lives_of_clients_and_worlds_add_up(tmp_path):
    log = GroupRunTimesFile(tmp_path)
    log.add(state((5.0, 6.0), 2.0))
    log.add(state((5.0, 6.0), 2.0))
    log.add(state((7.0, 8.0), 3.0, lives=(7, 9)))  # b was killed, and has learned more since than in the life before
    log.add(state((7.5, 8.0), 0.5, pid=2, lives=(7, 9)))  # the world, too
    log.save()
    times = read_group_run_times(tmp_path)
    assert times == log.times
    assert times.clients["a"] == ClientTimeTotals(
        acting_s=1.0, learning_s=7.5, overlap_s=1.0, world_s=2.0, others_s=3.0
    )
    assert (times.clients["b"].learning_s, times.clients["b"].waiting_s) == (14.0, 8.0)
    assert times.waited_s == {"a": {"b": 3.5}, "b": {"a": 0.5}}
    again = GroupRunTimesFile(tmp_path)
    again.add(state((1.0, 1.0), 1.0, pid=3))
    assert again.times.clients["a"].learning_s == 8.5 and again.times.waited_s["a"]["b"] == 4.5


def test_two_clients_of_one_name_are_told_apart():
    mates = [
        RosterClient(seat=seat, session=b"s", peer=b"door", claim=b"", name="a", spec=SeatSpec()) for seat in (1, 0)
    ]
    assert _names_of(mates) == ["a (seat 1)", "a"]


def test_the_last_words_of_a_world_that_is_down_are_no_other_worlds(tmp_path):
    log = GroupRunTimesFile(tmp_path)
    for pid, waited_s in ((1, 60.0), (0, 60.0), (0, 60.0), (2, 1.0), (0, 1.0), (3, 0.5)):
        log.add(state((5.0, 6.0), waited_s, pid=pid))
    assert log.times.waited_s["a"]["b"] == 61.5


def test_who_comes_back_is_not_waited_for_again_in_what_it_was_waited_for_before(tmp_path):
    waits, now, log = _WaitingTimes(), [0.0], GroupRunTimesFile(tmp_path)

    def seen(*members):
        world = WorldStatusReport(stage="collect", members=members, waited_s=waits.table(members))
        log.add(replace(state((5.0, 6.0), 0.0), world=world))

    def wait(waiting_s, *after):
        """b lets a wait for so long; these are in afterwards."""
        waits.update(("a", "b"), ("a", "b"), now[0])
        waits.update(("a", "b"), ("b",), now[0])
        now[0] += waiting_s
        waits.update(after, (), now[0])
        seen(*after)

    wait(100.0, "a", "b")
    for _ in range(3):  # b is given up after a second, and comes back
        wait(1.0, "a")
        seen("a", "b")
    assert log.times.waited_s["a"]["b"] == 103.0
    seen("b")  # a was away, and the world has forgotten what it paid
    wait(2.0, "a", "b")
    assert log.times.waited_s["a"]["b"] == 105.0


def test_a_table_says_who_waits_for_whom(tmp_path):
    log = GroupRunTimesFile(tmp_path)
    log.add(state((5.0, 6.0), 2.0))
    log.save()
    shown = _waiting(tmp_path, "")
    assert shown.columns == (*_PAID, "for a s", "for b s")
    assert shown.rows == [
        ["a", 1.0, 5.0, 2.0, 3.0, 1.0, 4.0, None, 2.0],
        ["b", 1.0, 6.0, 2.0, 3.0, 1.0, 4.0, 0.2, None],
    ]
    assert PAYS.startswith("acts") and _pays_of(ClientStatusReport(name="a")) == "-"


def test_parts_of_waiting_sum_to_it_where_most_of_it_was_spent_on_learning(monkeypatch, tmp_path):
    paid = ClientTimeTotals(acting_s=10.0, learning_s=50.0, overlap_s=35.0, world_s=40.0)
    monkeypatch.setattr(
        training_page, "read_group_run_times", lambda _: GroupRunTimes(clients={"a": paid}, waited_s={})
    )
    shown = _waiting(tmp_path, "")
    row = dict(zip(shown.columns[1:], shown.rows[0][1:], strict=True))
    assert (row["waiting for the world s"], row["of both learning s"], row["idle s"]) == (40.0, 35.0, 5.0)
    waited_s = row["waiting for the world s"] + row["for others and messages s"]
    assert row["of both learning s"] + row["idle s"] == waited_s
    assert row["acting s"] + row["learning s"] + row["idle s"] == 10.0 + 50.0 + 40.0 - 35.0


def test_what_is_no_such_file_is_refused_and_none_is_none(tmp_path):
    assert read_group_run_times(tmp_path) is None
    for text in ("{", '{"clients": {}}', '{"clients": {"a": {"b": 1}}, "waited_s": {}}', "1"):
        (tmp_path / WAITS).write_text(text)
        with pytest.raises(PolicyError, match=WAITS):
            GroupRunTimesFile(tmp_path)
