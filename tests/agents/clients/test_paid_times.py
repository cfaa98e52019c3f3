"""Who waited for whom, and what each client paid, over all lives of all processes."""

from __future__ import annotations

import pytest

from wcsim.agents.clients.paid_times import WAITS, PaidShares, PaidTimesLog, read_paid_times
from wcsim.errors import PolicyError
from wcsim.server.launch.states import ClientState, LaunchState
from wcsim.server.specs import ClientStatus, WorldStatus
from wcsim.view.live_table import PAYS, pays_of
from wcsim.view.report.training.waiting import HEADINGS, waiting_rows


def state(learned_s, waited_s, pid=1, names=("a", "b")):
    """Both clients have learned so long in this life, and a has waited so long for b in this life of the world."""
    status = {
        name: ClientStatus(name=name, inference_s=1.0, learning_s=s, simulation_s=2.0, barrier_s=3.0, overlap_s=1.0)
        for name, s in zip(names, learned_s, strict=True)
    }
    return LaunchState(
        elapsed_s=1.0,
        world_standing="running",
        world_pid=pid,
        world_restarts=0,
        world=WorldStatus(stage="collect", members=names, waited_s=((0.0, waited_s), (0.25, 0.0))),
        clients=tuple(ClientState(name=n, seat=k, standing="running", status=status[n]) for k, n in enumerate(names)),
    )


def test_lives_of_clients_and_worlds_add_up(tmp_path):
    log = PaidTimesLog(tmp_path)
    log.add(state((5.0, 6.0), 2.0))
    log.add(state((5.0, 6.0), 2.0))
    log.add(state((7.0, 1.0), 3.0))  # b was killed and has begun again
    log.add(state((7.5, 1.0), 0.5, pid=2))  # the world, too
    log.write()
    times = read_paid_times(tmp_path)
    assert times == log.times
    assert times.clients["a"] == PaidShares(acting_s=1.0, learning_s=7.5, overlap_s=1.0, world_s=2.0, others_s=3.0)
    assert (times.clients["b"].learning_s, times.clients["b"].waiting_s) == (7.0, 8.0)
    assert times.waited_s == {"a": {"b": 3.5}, "b": {"a": 0.5}}
    again = PaidTimesLog(tmp_path)
    again.add(state((1.0, 1.0), 1.0, pid=3))
    assert again.times.clients["a"].learning_s == 8.5 and again.times.waited_s["a"]["b"] == 4.5


def test_a_table_says_who_waits_for_whom(tmp_path):
    log = PaidTimesLog(tmp_path)
    log.add(state((5.0, 6.0), 2.0))
    headings, rows = waiting_rows(log.times)
    assert headings == (*HEADINGS, "for a s", "for b s")
    assert rows == [["a", 1.0, 5.0, 1.0, 4.0, 2.0, None, 2.0], ["b", 1.0, 6.0, 1.0, 4.0, 2.0, 0.2, None]]
    assert PAYS.startswith("acts") and pays_of(ClientStatus(name="a")) == "-"


def test_what_is_no_such_file_is_refused_and_none_is_none(tmp_path):
    assert read_paid_times(tmp_path) is None
    for text in ("{", '{"clients": {}}', '{"clients": {"a": {"b": 1}}, "waited_s": {}}', "1"):
        (tmp_path / WAITS).write_text(text)
        with pytest.raises(PolicyError, match=WAITS):
            PaidTimesLog(tmp_path)
