"""Every state that the real cores can get into, with faults, within a bound: safe, and never without a way on."""

from dataclasses import replace

import pytest

from tests.server.model import bugs
from tests.server.model.scope import Notice, Scope
from tests.server.model.search import Report, Search

QUICK = {
    "no fault": Scope(last_tick=2),
    "crash": Scope(crash=1),
    "crash, noticed by leases": Scope(crash=1, notice=Notice.LEASE),
    "crash, noticed by its connection": Scope(crash=1, notice=Notice.CONNECTION),
    "connection lost, and that told": Scope(cut=1, notice=Notice.CONNECTION),
    "end of an epoch": Scope(ends_at=1),
    "hang and wake": Scope(hang=1, wake=1),
    "suspicion": Scope(suspect=1),
    "twice": Scope(duplicate=1, split_step=True, last_tick=2),
    "one message lost": Scope(lose=1),
    "connection lost": Scope(cut=1),
    "new epoch": Scope(world=1),
    "new epoch, any seat": Scope(world=1, any_seat=True),
    "respawn": Scope(respawn=1),
    "rebuild": Scope(rebuild=1),
    "leave": Scope(leave=1),
    "one seat for two": Scope(leave=1, capacity=1),
}

FULL = {
    "crash and suspicion": Scope(crash=1, suspect=1),
    "crash and new epoch": Scope(crash=1, world=1, any_seat=True),
    "hang and twice": Scope(hang=1, wake=1, duplicate=1),
    "new epoch and suspicion on one seat": Scope(world=1, suspect=1, capacity=1),
    "new epoch and connection": Scope(world=1, cut=1),
    "lost and suspicion": Scope(lose=1, suspect=1),
    "respawn and rebuild": Scope(respawn=1, rebuild=1, cut=1),
    "leases alone": Scope(crash=1, suspect=1, notice=Notice.LEASE),
    "new epoch, and a message lost": Scope(world=1, lose=1),
    "two connections": Scope(cut=2, notice=Notice.CONNECTION),
    "connection and crash": Scope(cut=1, crash=1, notice=Notice.CONNECTION),
    "end of an epoch and connection": Scope(cut=1, ends_at=1, notice=Notice.CONNECTION),
    "end of an epoch and of its world": Scope(world=1, ends_at=1),
    "end of an epoch and leave": Scope(leave=1, ends_at=1),
    "three clients": Scope(clients=3, capacity=3, starts=1),
}

CUT = Scope(cut=1, notice=Notice.CONNECTION)
DEAD = Scope(crash=1, starts=1, notice=Notice.CONNECTION)
ENDS = Scope(leave=1, ends_at=1)

BUGS = {
    "a lost connection forgotten": (replace(DEAD, server=bugs.ForgetsTheCut), "no way on"),
    "barrier not looked at again for a connection": (replace(DEAD, server=bugs.NotLookedAtAgain), "no way on"),
    "who was cut off is evicted": (replace(CUT, server=bugs.EvictsTheCut), "the driver gets EvictedError"),
    "one session for two chairs": (replace(CUT, server=bugs.BeginsTheCutAnew), "frame"),
    "a cut without a word": (replace(CUT, client=bugs.SaysNoCut), "frame"),
    "an epoch that ends before its last tick is seen": (replace(ENDS, server=bugs.EndsUnseen), "the epoch ends at"),
    "a chair left over at the end of an epoch": (replace(ENDS, server=bugs.KeepsChairs), "the epoch ends with"),
    "an end of an epoch without a word": (replace(ENDS, client=bugs.SaysNoCut), "frame"),
    "a tick before the barrier is full": (Scope(server=bugs.TooEarly), "step"),
    "an action lost": (Scope(server=bugs.LosesAnAction), "step"),
    "a double step": (Scope(server=bugs.StepsTwice), "step twice"),
    "an old action taken for one of now": (Scope(duplicate=1, server=bugs.AnyTick), "step"),
    "no lease": (Scope(hang=1, server=bugs.NoLease), "no way on"),
    "no heir": (Scope(crash=1, server=bugs.NoHeir), "the master"),
    "barrier not looked at again": (Scope(crash=1, server=bugs.NotLookedAtAgain), "no way on"),
    "a frame taken twice": (Scope(cut=1, client=bugs.ShowsAnyFrame), "frame"),
    "never asks again": (Scope(cut=1, client=bugs.NeverAsksAgain), "no way on"),
}


def holds(scope: Scope) -> Report:
    report = Search(scope).run()
    assert not report.wrong, f"{report}"
    return report


@pytest.mark.parametrize("name", QUICK)
def test_every_state_is_safe_and_has_a_way_on(name: str) -> None:
    assert holds(QUICK[name]).states > 100


@pytest.mark.proof
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", FULL)
def test_two_kinds_of_faults_at_once(name: str) -> None:
    assert holds(FULL[name]).states > 10_000


@pytest.mark.parametrize("name", BUGS)
def test_a_core_with_a_fault_is_found(name: str) -> None:
    scope, kind = BUGS[name]
    report = Search(scope).run()
    assert report.wrong.startswith(kind), f"{report}"
    assert report.trace
