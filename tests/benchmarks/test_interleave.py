"""Contestants take turns in processes of their own, and what goes wrong in one is said as if it were in this one."""

import os
import signal
from pathlib import Path

import pytest

from benchmarks.interleave import Contestant, in_turns
from wcsim.errors import PhysicsError, SumoError, TownError


class Counts:
    """Counts its ticks, and breaks at one of them."""

    def __init__(self, home: str = "", breaks_at: int = -1) -> None:
        self.ticks, self.breaks_at = 0, breaks_at
        if home:
            Path(home).write_text(str(os.getpid()))

    def tick(self) -> tuple[float, ...]:
        self.ticks += 1
        if self.ticks == self.breaks_at:
            raise PhysicsError("the chair left the finite numbers")
        return (float(self.ticks),)

    def close(self) -> None:
        pass


def refused() -> Counts:
    """No contestant is made."""
    raise TownError("nowhere: has no net")


def test_turns_are_taken_and_all_ticks_told():
    done = []
    pair = [Contestant(make=Counts, given=(), ticks=2), Contestant(make=Counts, given=())]
    first, second = in_turns(pair, 2, done.append)
    assert (first, second, done) == ([(1.0,), (2.0,), (3.0,), (4.0,)], [(1.0,), (2.0,)], [1, 2])


@pytest.mark.parametrize(
    "contestant, error, told",
    [
        (Contestant(make=refused, given=()), TownError, "nowhere: has no net"),
        (Contestant(make=Counts, given=("", 2), ticks=3), PhysicsError, "finite numbers"),
    ],
)
def test_what_a_contestant_raises_is_raised_here_without_a_traceback_of_its_own(contestant, error, told, capfd):
    with pytest.raises(error, match=told):
        in_turns([Contestant(make=Counts, given=()), contestant], 2, lambda done: None)
    assert "Traceback" not in capfd.readouterr().err


def test_a_contestant_that_is_killed_while_it_is_idle_is_no_closed_output(tmp_path):
    """A BrokenPipeError would end the command without a word: the command line takes it for a closed output."""
    home = tmp_path / "pid"

    def kill(done):
        pid = int(home.read_text())
        os.kill(pid, signal.SIGKILL)
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)

    with pytest.raises(SumoError, match="died or hangs"):
        in_turns([Contestant(make=Counts, given=(str(home),))], 2, kill)
