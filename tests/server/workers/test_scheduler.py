"""A scheduler: every piece is done, whoever dies, hangs or goes; what cannot be done is told in a line."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.support.cluster.workpieces import always_die, blunder, die_once, echo, hang_once, refuse, workers
from tests.support.yardstick import waited
from wcsim.core.processes import kill_workers, start_single_worker_pool
from wcsim.errors import DiskFullError, TownError, WorkersError
from wcsim.server.workers.machines import WorkPiece, WorkResult, _ProcessWorkers
from wcsim.server.workers.scheduler import MOST_FAILURES, WorkScheduler, _Piece, _Task


def work(key: str, call: Callable[..., bytes] = echo, piece: Any = "") -> WorkPiece:
    return WorkPiece(key=key, call=call, piece=piece or key)


def drop(key: str, data: bytes) -> None:
    """A result that no test reads."""


def done_by(scheduler: WorkScheduler, keys: set[str]) -> None:
    until_s, left = time.monotonic() + 60.0, set(keys)
    while left and time.monotonic() < until_s:
        left -= scheduler.wait(left, 0.2)
    assert not left


def do(scheduler: WorkScheduler, keys: str) -> None:
    scheduler.submit([work(key) for key in keys])
    done_by(scheduler, set(keys))


def test_ctrl_c_is_not_heard_by_a_worker_not_even_while_it_starts(capfd):
    workers = _ProcessWorkers(1)
    try:
        for key in ("first", "second"):
            workers.begin("process 1", work(key))
            (pid,) = workers._pools["process 1"]._processes
            os.kill(pid, signal.SIGINT)  # as a terminal does, to all
            found = waited(lambda: workers.collect(0.2), 60.0)
            assert [(end.key, end.data is not None) for end in found] == [(key, True)]
    finally:
        workers.close()
    assert capfd.readouterr().err == ""


class Scripted:
    """Workers whose ends are written down: by worker, a list of what becomes of each of its pieces."""

    def __init__(self, **ends: list[str]) -> None:
        self.ends = {name: list(rest) for name, rest in ends.items()}
        self.at: dict[str, str] = {}
        self.begun: list[tuple[str, str]] = []
        self.stopped: list[str] = []

    def names(self) -> tuple[str, ...]:
        return tuple(self.ends)

    def begin(self, worker: str, work: WorkPiece) -> None:
        self.begun.append((worker, work.key))
        self.at[worker] = work.key

    def collect(self, timeout_s: float) -> list[WorkResult]:
        time.sleep(0.005)
        found = []
        for worker, key in list(self.at.items()):
            rest = self.ends.get(worker, [])
            how = rest.pop(0) if rest else "done"
            if how == "hang" and worker not in self.stopped:
                rest.insert(0, how)
                continue
            del self.at[worker]
            data = key.encode() if how == "done" else None
            found.append(WorkResult(worker=worker, key=key, data=data, lost=how, counts=how == "dead"))
        return found

    def stop(self, worker: str) -> None:
        self.stopped.append(worker)

    def close(self) -> None:
        self.ends = {}


class Hanging(Scripted):
    """Workers whose every piece has to be stopped."""

    def collect(self, timeout_s: float) -> list[WorkResult]:
        time.sleep(0.005)
        found = [WorkResult(worker=name, key=self.at.pop(name), lost="killed") for name in self.stopped]
        self.stopped = []
        return found


class HangingBeside(Hanging):
    """The same, of sick machines; what others are given is done."""

    def collect(self, timeout_s: float) -> list[WorkResult]:
        well = [name for name in self.at if not name.startswith("sick")]
        done = [WorkResult(worker=name, key=self.at[name], data=self.at.pop(name).encode()) for name in well]
        return [*super().collect(timeout_s), *done]


def test_processes_do_all_pieces_and_go_on_after_one_has_died(tmp_path):
    kept: dict[str, bytes] = {}
    with WorkScheduler(_ProcessWorkers(2), kept.__setitem__) as scheduler:
        scheduler.submit([work("a"), work("b", die_once, str(tmp_path / "once")), work("c")])
        done_by(scheduler, {"a", "b", "c"})
        assert [each.name for each in scheduler.workers_now()] == ["process 1", "process 2"]
    assert kept == {"a": b"a", "b": b"lived", "c": b"c"}


def test_a_process_that_was_stopped_is_killed_and_its_piece_done_again(tmp_path):
    kept: dict[str, bytes] = {}
    with WorkScheduler(_ProcessWorkers(1), kept.__setitem__, least_late_s=2.0) as scheduler:
        scheduler.submit([work("a", hang_once, str(tmp_path / "once"))])
        done_by(scheduler, {"a"})
    assert kept == {"a": b"lived"}


def test_what_is_asked_for_twice_is_done_once():
    workers, kept = Scripted(w=[]), []
    with WorkScheduler(workers, lambda key, data: kept.append(key)) as scheduler:
        scheduler.submit([work("a")])
        scheduler.submit([work("a"), work("b")])
        done_by(scheduler, {"a", "b"})
    assert kept == ["a", "b"]


def test_a_piece_that_is_late_goes_to_another_worker_and_counts_once():
    workers, kept = Scripted(slow=["hang"], quick=[]), []
    with WorkScheduler(workers, lambda key, data: kept.append(key), least_late_s=0.1) as scheduler:
        do(scheduler, "abc")
    assert sorted(kept) == ["a", "b", "c"]
    assert workers.stopped == ["slow"]
    assert sum(key == "a" for _, key in workers.begun) == 2


@pytest.mark.parametrize("workers, late_s", [(Scripted(w=["dead"] * 5), 180.0), (Hanging(w=[]), 0.05)])
def test_a_piece_that_kills_its_workers_or_hangs_is_given_up_in_a_line(workers, late_s):
    with (
        WorkScheduler(workers, drop, least_late_s=late_s) as scheduler,
        pytest.raises(WorkersError, match=r"a was started 5 times and never finished; .*wcsim resume"),
    ):
        do(scheduler, "a")


DYING = Scripted(**{"sick/1": ["dead"] * 99, "well/1": []}), 180.0
HUNG = HangingBeside(**{"sick/1": [], "sick/2": [], "well/1": []}), 0.05


@pytest.mark.parametrize("workers, late_s", [DYING, HUNG])
def test_a_machine_on_which_all_dies_or_hangs_ends_no_run_while_another_is_well(workers, late_s):
    kept = []
    with WorkScheduler(workers, lambda key, data: kept.append(key), least_late_s=late_s) as scheduler:
        do(scheduler, "abcdef")
    assert sorted(kept) == list("abcdef")
    sick = [key for worker, key in workers.begun if worker.startswith("sick")]
    assert sick and len(sick) == len(set(sick)), "none was given to it twice"


@pytest.mark.parametrize("came", [{"data": b"x"}, {"error": TownError("x")}])
def test_what_comes_of_a_piece_that_was_given_to_somebody_else_is_dropped(came):
    scheduler = WorkScheduler(Scripted(w=[]), lambda key, data: pytest.fail("kept"), least_late_s=10.0)
    piece = _Piece(work=work("a"), failures=MOST_FAILURES - 2, times_late=1)
    for age_s, late in ((15.0, []), (25.0, [piece])):  # the second time it has twice as long
        scheduler._running = {"w": _Task(piece=piece, since_s=time.monotonic() - age_s)}
        scheduler._stop_late()
        assert list(scheduler._waiting) == late
    scheduler._settle(WorkResult(worker="w", key="a", **came))
    scheduler._running = {"w": _Task(piece=piece, since_s=0.0)}
    with pytest.raises(WorkersError, match=r"a was started 5 times .*on w, where it died; check disk space and memory"):
        scheduler._settle(WorkResult(worker="w", key="a", lost="it died"))


def test_a_process_that_is_killed_in_the_middle_of_a_result_is_not_waited_for():
    pool = start_single_worker_pool()
    pool.submit(os.getpid).result(60.0)
    future = pool.submit(bytes, 1 << 28)
    while not pool._result_queue._reader.poll():
        assert not future.done()
    kill_workers(pool)
    with pytest.raises(BrokenProcessPool):
        future.result(30.0)


def test_machines_may_go_as_often_as_they_like():
    with WorkScheduler(Scripted(w=["gone"] * 12), drop) as scheduler:
        do(scheduler, "a")


def test_somebody_who_comes_later_does_what_is_left_and_nobody_at_all_ends_the_run():
    workers = Scripted()
    with WorkScheduler(workers, drop) as scheduler:
        scheduler.submit([work("a")])
        time.sleep(0.1)
        workers.ends["late"] = []
        done_by(scheduler, {"a"})
    with (
        WorkScheduler(Scripted(), drop, no_worker_s=0.1) as scheduler,
        pytest.raises(WorkersError, match="no machine has been there to work"),
    ):
        do(scheduler, "a")


ENDS = [(refuse, TownError), (blunder, ZeroDivisionError), (always_die, WorkersError)]


@pytest.mark.parametrize("call, error", ENDS)
def test_what_cannot_be_done_is_raised_where_it_is_waited_for(call, error):
    with WorkScheduler(_ProcessWorkers(1), drop) as scheduler, pytest.raises(error):
        scheduler.submit([work("a", call)])
        done_by(scheduler, {"a"})


def test_a_full_disk_is_raised_where_it_is_waited_for():
    def full(key: str, data: bytes) -> None:
        raise DiskFullError("no room")

    with WorkScheduler(Scripted(w=[]), full) as scheduler, pytest.raises(DiskFullError):
        do(scheduler, "a")


def test_closing_leaves_no_process(tmp_path: Path):
    with WorkScheduler(_ProcessWorkers(1), drop) as scheduler:
        scheduler.submit([work("a"), work("b", hang_once, str(tmp_path / "once"))])
        done_by(scheduler, {"a"})
        time.sleep(0.3)
    waited(lambda: not workers(), 10.0)


LEADER = """
import time
from tests.support.cluster.workpieces import tell_pid
from wcsim.server.workers.scheduler import WorkScheduler
from wcsim.server.workers.machines import _ProcessWorkers
from wcsim.server.workers.machines import WorkPiece
with WorkScheduler(_ProcessWorkers(1), lambda key, data: print(data.decode(), flush=True)) as scheduler:
    scheduler.submit([WorkPiece(key="a", call=tell_pid, piece="")])
    time.sleep(600.0)
"""


def test_nobody_waits_for_work_from_a_run_that_was_killed():
    leader = subprocess.Popen([sys.executable, "-c", LEADER], stdout=subprocess.PIPE, text=True)
    try:
        worker = psutil.Process(int(leader.stdout.readline()))
        assert worker.is_running()
    finally:
        leader.kill()
        leader.communicate()
    worker.wait(60.0)  # raises when it lives on


def test_a_worker_that_does_not_hear_that_it_is_to_be_killed_is_told_again(tmp_path):
    workers = Scripted(deaf=["hang", "done"], other=["done"])
    asked = []
    workers.stop = asked.append
    with WorkScheduler(workers, drop, least_late_s=0.05) as scheduler:
        do(scheduler, "a")
        waited(lambda: len(asked) > 1, 20.0)
    assert asked[:2] == ["deaf", "deaf"]
