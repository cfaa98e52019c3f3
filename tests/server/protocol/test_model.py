"""Every state that the real cores can get into, with faults, within a bound: safe, and never without a way on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.server.model import bugs
from tests.server.model.scope import Budget, Scope
from tests.server.model.search import Report, Search

QUICK = {
    "no fault": Scope(budget=Budget()),
    "crash": Scope(budget=Budget(crash=1), last_tick=1),
    "crash, noticed by leases": Scope(budget=Budget(crash=1), last_tick=1, remote=True),
    "hang and wake": Scope(budget=Budget(hang=1, wake=1), last_tick=1),
    "suspicion": Scope(budget=Budget(suspect=1), last_tick=1),
    "twice": Scope(budget=Budget(duplicate=1), split_step=True),
    "one message lost": Scope(budget=Budget(lose=1), last_tick=1),
    "connection lost": Scope(budget=Budget(cut=1), last_tick=1),
    "new epoch": Scope(budget=Budget(world=1), last_tick=1),
    "new epoch, any seat": Scope(budget=Budget(world=1), last_tick=1, any_seat=True),
    "respawn": Scope(budget=Budget(respawn=1), last_tick=1),
    "rebuild": Scope(budget=Budget(rebuild=1), last_tick=1),
    "leave": Scope(budget=Budget(leave=1), last_tick=1),
    "one seat for two": Scope(budget=Budget(leave=1), capacity=1, last_tick=1),
}

FULL = {
    "crash and suspicion": Scope(budget=Budget(crash=1, suspect=1), last_tick=1),
    "crash and new epoch": Scope(budget=Budget(crash=1, world=1), any_seat=True, last_tick=1),
    "hang and twice": Scope(budget=Budget(hang=1, wake=1, duplicate=1), last_tick=1),
    "new epoch and suspicion on one seat": Scope(budget=Budget(world=1, suspect=1), capacity=1, last_tick=1),
    "new epoch and connection": Scope(budget=Budget(world=1, cut=1), last_tick=1),
    "lost and suspicion": Scope(budget=Budget(lose=1, suspect=1), last_tick=1),
    "respawn and rebuild": Scope(budget=Budget(respawn=1, rebuild=1, cut=1), last_tick=1),
    "leases alone": Scope(budget=Budget(crash=1, suspect=1), remote=True, last_tick=1),
    "new epoch, and a message lost": Scope(budget=Budget(world=1, lose=1), last_tick=1),
    "three clients": Scope(budget=Budget(), clients=3, capacity=3, starts=1, last_tick=1),
}

BUGS = {
    "a tick before the barrier is full": (Scope(budget=Budget(), server=bugs.TooEarly), "step"),
    "an action lost": (Scope(budget=Budget(), server=bugs.LosesAnAction), "step"),
    "a double step": (Scope(budget=Budget(), server=bugs.StepsTwice), "step twice"),
    "an old action taken for one of now": (Scope(budget=Budget(duplicate=1), server=bugs.AnyTick), "step"),
    "no lease": (Scope(budget=Budget(hang=1), server=bugs.NoLease), "no way on"),
    "no heir": (Scope(budget=Budget(crash=1), server=bugs.NoHeir), "the master"),
    "barrier not looked at again": (Scope(budget=Budget(crash=1), server=bugs.NotLookedAtAgain), "no way on"),
    "a frame taken twice": (Scope(budget=Budget(cut=1), client=bugs.ShowsAnyFrame), "frame"),
    "never asks again": (Scope(budget=Budget(cut=1), client=bugs.NeverAsksAgain), "no way on"),
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
    report = Search(replace(scope, last_tick=1)).run()
    assert report.wrong.startswith(kind), f"{report}"
    assert report.trace
