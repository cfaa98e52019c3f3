"""Planned faults: as many as were asked for, spread over a run, each when everybody is back."""

import signal
from dataclasses import replace
from itertools import pairwise

from benchmarks.soak.planned import FaultOrder, PlannedFaults
from tests.benchmarks.soak.test_soak import clock, state


def played(monkeypatch, order, stuck=()):
    """A run of 400 looks half a second apart; the world does not go on in those of `stuck`."""
    sent, now, ticks = [], clock(monkeypatch), [0]
    monkeypatch.setattr("benchmarks.soak.faults._send", lambda pid, number: sent.append((now[0], pid, number)))
    faults = PlannedFaults(order, lambda state: now[0] / 200.0)
    for step in range(400):
        now[0] = 0.5 * step
        ticks[0] += 0 if step in stuck else 4
        faults.act(state(tick=ticks[0]))
    return faults, sent


def test_as_many_kills_and_stops_as_were_planned_and_the_same_for_a_seed(monkeypatch):
    order = FaultOrder(kills=6, stops=5, lease_s=4.0, seed=1)
    faults, sent = played(monkeypatch, order)
    assert [(fault.what) for fault in faults.faults].count("kill") == 6 and len(faults.faults) == 11
    assert [what for _, what in faults.planned] == [fault.what for fault in faults.faults]
    again, _ = played(monkeypatch, order)
    assert again.planned == faults.planned
    times = [fault.time_s for fault in faults.faults]
    assert min(times) > 10.0 and max(times) < 190.0
    assert min(b - a for a, b in pairwise(times)) >= 5.0
    stopped = [pid for _, pid, number in sent if number == signal.SIGSTOP and pid != 1]
    assert [pid for _, pid, number in sent if number == signal.SIGCONT] == stopped, "a world that hangs is not woken"
    assert len(faults.recovered) == 11 and all(each.after_s <= 1.0 for each in faults.recovered)


def test_the_next_fault_waits_until_the_last_one_is_got_over(monkeypatch):
    order = FaultOrder(kills=8, stops=0, lease_s=4.0, seed=2)
    free, _ = played(monkeypatch, order)
    first_s = free.faults[0].time_s
    stuck = range(int(2 * first_s) + 1, int(2 * first_s) + 121)
    faults, _ = played(monkeypatch, order, stuck)
    assert len(faults.faults) == 8
    assert sum(first_s < fault.time_s < first_s + 60.0 for fault in faults.faults) == 0
    assert max(each.after_s for each in faults.recovered) > 60.0


def struck(monkeypatch, said, who):
    """After how many seconds a kill of `who` was got over, by what the world said so many seconds after it."""
    now = clock(monkeypatch, 100.0)
    monkeypatch.setattr("benchmarks.soak.faults._send", lambda pid, number: None)
    monkeypatch.setattr("benchmarks.soak.planned._TARGETS", ((who, 1.0),))
    faults = PlannedFaults(FaultOrder(kills=1, stops=0, lease_s=4.0), lambda state: 0.5)
    faults.act(state(tick=40))
    assert len(faults.faults) == 1
    for after_s, tick, ticks in said:
        now[0] = 100.0 + after_s
        told = state(tick=tick)
        faults.act(replace(told, world=replace(told.world, ticks=ticks)))
    return [each.after_s for each in faults.recovered]


def test_word_from_before_a_fault_tells_of_no_recovery(monkeypatch):
    said = [(0.2, 41, 41), (0.5, 43, 43), (1.0, 43, 43), (5.0, 44, 44), (5.5, 45, 45)]  # all waits for the lease
    assert struck(monkeypatch, said, "client") == [5.5]


def test_a_world_that_was_made_again_has_recovered_with_its_first_tick(monkeypatch):
    said = [(0.2, 41, 41), (6.0, 44, 0), (7.0, 44, 0), (8.0, 45, 1)]
    assert struck(monkeypatch, said, "world") == [8.0]
