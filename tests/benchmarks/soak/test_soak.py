"""Soaks: the proof with real processes, and the arithmetic that it rests on."""

import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scripts.soak import faults_of, result
from benchmarks.soak.faults import Chaos, Fault, Striker
from benchmarks.soak.growth import GrowthLog, LongRun, Slope
from benchmarks.soak.soak import (
    RecoveryTimes,
    SoakFacts,
    SoakOrder,
    _Watch,
    overlapping,
    recovery_bars,
    recovery_s,
    rejoin_s,
    soak,
)
from benchmarks.soak.stub_client import StubSight
from tests.support.worlds import quick_config
from wcsim.server.launch.states import ClientProcessState, LaunchProcessStates, LaunchResult, WorldStatusReport
from wcsim.server.ledger import LedgerAuditResult

A_KILLED = Fault(time_s=10.0, what="kill", who="a", others=("b",))


def sights(*entries: tuple[float, int, int]) -> list[StubSight]:
    return [StubSight(*entry) for entry in entries]


def test_a_tick_that_was_under_way_is_no_recovery():
    seen = {
        "a": sights((9.9, 0, 50)),
        "b": sights((9.9, 0, 50), (10.01, 0, 51), (12.5, 0, 52)),
    }
    assert recovery_s(A_KILLED, seen) == 2.5
    assert rejoin_s(A_KILLED, seen) is None
    assert recovery_s(Fault(time_s=10.0, what="kill", who="a"), seen) is None, "nobody else had a seat"


def test_a_new_epoch_is_a_recovery_and_its_first_frame_a_rejoin():
    fault = Fault(time_s=10.0, what="kill", who="world", others=("a", "b"))
    seen = {"a": sights((9.9, 0, 50), (14.0, 1, 0)), "b": sights((9.9, 0, 50), (13.0, 1, 0))}
    assert recovery_s(fault, seen) == 3.0
    assert rejoin_s(fault, seen) is None
    assert rejoin_s(A_KILLED, seen) == 4.0
    assert recovery_s(A_KILLED, {"a": sights((9.0, 0, 1)), "b": []}) is None


def test_faults_overlap_when_they_share_a_moment():
    assert overlapping([(0.0, 3.0), (3.5, 4.0), (2.0, 2.1), (9.0, 9.0)]) == (True, False, True, False)
    assert overlapping([(0.0, 1.0), (1.0, 2.0)]) == (False, False)
    assert overlapping([(0.0, 5.0), (1.0, 1.0)]) == (True, True), "one without an end of its own"
    assert overlapping([]) == ()


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(1, 9)), max_size=12))
def test_every_pair_that_shares_a_moment_is_found(lengths):
    spans = [(float(begin), float(begin + length)) for begin, length in lengths]
    each = tuple(any(a[0] < b[1] and b[0] < a[1] for b in spans[:k] + spans[k + 1 :]) for k, a in enumerate(spans))
    assert overlapping(spans) == each


def state(tick: int, epoch: int = 0) -> LaunchProcessStates:
    names = ("a", "b", "c")
    return LaunchProcessStates(
        elapsed_s=1.0,
        world_standing="running",
        world_pid=1,
        world_restarts=0,
        world=WorldStatusReport(stage="collect", epoch=epoch, tick=tick, ticks=tick, members=names, master="a"),
        clients=tuple(
            ClientProcessState(name=name, seat=i, standing="running", pid=i + 2) for i, name in enumerate(names)
        ),
    )


def clock(monkeypatch, at_s=0.0):
    """The time that a test sets, as the only item of a list."""
    now = [at_s]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_faults_come_one_after_another_and_only_while_the_world_goes_on(monkeypatch):
    sent, now = [], clock(monkeypatch)
    monkeypatch.setattr("benchmarks.soak.faults._send", lambda pid, number: sent.append((pid, number)))
    chaos = Chaos(7, until_s=300.0, lease_s=3.0)
    for step in range(1400):
        now[0] = 0.25 * step
        stuck = 100.0 < now[0] < 120.0
        chaos.act(state(tick=400 if stuck else 4 * step))
    times = [fault.time_s for fault in chaos.faults]
    assert len(times) > 60 and max(times) <= 300.5
    assert sum(102.0 < t < 120.0 for t in times) <= 1
    assert {(fault.what, fault.who == "world") for fault in chaos.faults} >= {
        ("kill", False), ("stop", False), ("pause", False), ("kill", True)
    }  # fmt: skip
    assert any(fault.master for fault in chaos.faults)
    assert all(len(fault.others) == 2 + (fault.who == "world") for fault in chaos.faults)
    paused = sum(fault.what == "pause" or (fault.what == "stop" and fault.who != "world") for fault in chaos.faults)
    assert sum(number == signal.SIGCONT for _, number in sent) == paused


@pytest.mark.parametrize("lease_s, least_s, most_s", [(3.0, 4.0, 8.0), (60.0, 80.0, 160.0)])
def test_a_stopped_client_wakes_when_it_was_given_up_whatever_the_lease(monkeypatch, lease_s, least_s, most_s):
    asked_s, now = [], clock(monkeypatch)

    def strike(striker, fault, pid, wakes_s=None):
        striker.faults.append(fault)
        asked_s.append(wakes_s)

    monkeypatch.setattr(Striker, "strike", strike)
    monkeypatch.setattr("benchmarks.soak.faults._MENU", (("client", "stop", 1.0),))
    chaos = Chaos(7, until_s=300.0, lease_s=lease_s)
    for step in range(1000):
        now[0] = 0.25 * step
        chaos.act(state(tick=4 * step))
    assert len(asked_s) > 30
    assert least_s <= min(asked_s) < 1.1 * least_s and 0.9 * most_s < max(asked_s) <= most_s


@pytest.mark.parametrize("lease_s, slow", [(3.0, ["recovery_client_p99_s"]), (60.0, [])])
def test_a_recovery_is_slow_by_the_lease_that_was_asked_for(tmp_path, lease_s, slow):
    order = SoakOrder(town="", config=quick_config(), seconds=60.0, folder=tmp_path, lease_s=lease_s)
    times = RecoveryTimes(client_s=(lease_s, 40.0), world_s=(12.0,), overlap_s=(), rejoin_s=())
    faults = tuple(Fault(time_s=1.0, what="kill", who=who, others=("c",)) for who in ("a", "b", "world"))
    facts = SoakFacts(
        audit=LedgerAuditResult(ticks=100, lost=0, doubled=0, phantom=0),
        faults=faults,
        times=times,
        bars=recovery_bars(order),
        orphans=0,
        leaked=0,
        memory={},
        disk=Slope(),
        bounds=LongRun(memory_gb=1.0, disk_gb=1.0, recovery_s=1.0),
        outcome=LaunchResult(code=0, message="", stopped=True, clients=()),
    )
    assert faults_of(facts) == slow


class Asked:
    """Stands in for a launcher that is asked to stop."""

    def stop(self):
        pass


def test_an_epoch_is_reckoned_at_the_pace_of_the_run_and_not_of_a_world_that_ends(monkeypatch, tmp_path):
    now = clock(monkeypatch)
    monkeypatch.setattr("benchmarks.soak.faults._send", lambda pid, number: None)
    order = SoakOrder(town="", config=quick_config(), seconds=60.0, folder=tmp_path)
    watch = _Watch(order, lambda done_s: None)
    watch.launcher = Asked()
    for step in range(400):
        now[0] = 0.25 * step
        ending = replace(state(tick=1_000 + step), stopping=True)  # its last ticks come slowly
        life = state(tick=1 + 3 * (step % 100))  # 12 ticks a second
        watch.show(ending if step >= 240 else replace(life, world_pid=100 + step // 100))
    assert watch.pace.ticks_per_s == pytest.approx(12.0)
    shown = [state(tick=0), replace(state(tick=9), world=None), replace(state(tick=9), world_pid=0)]
    for number, each in enumerate(shown):
        watch.pace.look(each, 1000.0 + number)
    watch.pace.look(state(tick=10_000), 2000.0)
    watch.pace.look(state(tick=10_001), 2100.0, settled=False)
    assert watch.pace.ticks_per_s == pytest.approx(12.0)


def test_memory_is_looked_at_before_a_process_is_killed(monkeypatch, tmp_path):
    done, now, killed = [], clock(monkeypatch), 0
    monkeypatch.setattr("benchmarks.soak.faults._send", lambda pid, number: done.append(number))
    monkeypatch.setattr(GrowthLog, "look", lambda *given: done.append("look"))
    watch = _Watch(SoakOrder(town="", config=quick_config(), seconds=60.0, folder=tmp_path), lambda done_s: None)
    for step in range(100):
        now[0] = 0.25 * step
        done.clear()
        watch.show(state(tick=4 * step))
        assert done[0] == "look"
        killed += signal.SIGKILL in done
    assert killed > 2


def soaked(corner: Path, folder: Path, seconds: float, seed: int) -> SoakFacts:
    return soak(SoakOrder(town=str(corner), config=quick_config(), seconds=seconds, folder=folder, seed=seed))


def test_some_seconds_of_faults_lose_nothing(corner: Path, tmp_path: Path):
    facts = soaked(corner, tmp_path / "run", 10.0, seed=1)
    assert facts.outcome.code == 0, facts.outcome.message
    assert len(facts.faults) >= 2 and facts.audit.ticks > 50
    exact = ("lost", "doubled", "phantom", "orphans", "leaked_shm", "unrecovered")
    assert {key: result(facts)[key] for key in exact} == dict.fromkeys(exact, 0)


@pytest.mark.proof
def test_five_minutes_of_faults_lose_nothing_and_everybody_recovers_in_time(corner: Path, tmp_path: Path):
    facts = soaked(corner, tmp_path / "run", 300.0, seed=2)
    assert facts.outcome.code == 0, facts.outcome.message
    assert len(facts.faults) >= 30
    assert not faults_of(facts), result(facts)
