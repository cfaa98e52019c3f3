"""Updates that are done while a learner waits for its world: the same weights, whoever does them when."""

import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import ValidationError

from tests.agents.learning.test_train import Nervous, config, street, weights
from tests.agents.toy import ToyStreet, a_run, toy_camera, train_toy
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.learning.train import train_dqn
from wcsim.config import LearnConfig
from wcsim.errors import InterruptedRunError
from wcsim.server.links.socket import SocketSeatLink

SHORT = {"total_steps": 100, "phase1_steps": 20}
HASTY = {"learning_rate": 0.03, "phase1_steps": 20, "epsilon_start": 0.0}  # an update changes what is chosen


class Waiting(ToyStreet):
    """Does the due updates within its steps, as an environment behind a link does, and counts them."""

    def __init__(self, delay_s: float = 0.0) -> None:
        super().__init__(toy_camera(16, 20), max_steps=30)
        self.due_work = lambda: None
        self.worked, self._delay_s = 0, delay_s

    def step(self, action):
        work = self.due_work()
        if work is not None:
            self.worked += 1
            time.sleep(self._delay_s)
            work()
        return super().step(action)


def learned(folder: Path, make, **learn) -> bytes:
    return weights(train_toy(config(**{**SHORT, **learn}), folder, make, seed=1))


def test_the_same_weights_whether_the_updates_are_done_before_the_step_or_within_it(tmp_path):
    within = Waiting(delay_s=0.002)
    later = learned(tmp_path / "within", lambda: within, updates="while_waiting", **HASTY)
    assert within.worked > 17, "each of the updates, one in four steps, but the very last"
    assert later == learned(tmp_path / "before", street, updates="while_waiting", **HASTY)
    now = learned(tmp_path / "now", street, **HASTY)
    assert later != now, "an action is chosen by the weights before the updates that are due, not after them"


def test_nothing_is_put_off_where_updates_come_before_acting(tmp_path):
    within = Waiting()
    assert learned(tmp_path / "a", lambda: within) == learned(tmp_path / "b", street)
    assert within.worked == 0


def test_as_many_updates_are_done_in_either_order(tmp_path, monkeypatch):
    counts, real = [], SeqDQN.do_updates
    monkeypatch.setattr(SeqDQN, "do_updates", lambda self, steps, size: (counts.append(steps), real(self, steps, size)))
    for number, updates in enumerate(("before_acting", "while_waiting")):
        counts.clear()
        learned(tmp_path / str(number), street, updates=updates)
        assert sum(counts) == (100 - 20) // 4


def test_a_danger_network_cannot_wait():
    with pytest.raises(ValidationError, match="expected before_acting"):
        LearnConfig(head="danger", updates="while_waiting")


class Heard(SocketSeatLink):
    """A seat that hears by `listen` what it is to hear."""

    def __init__(self, listen):
        self._listen = listen
        self._link_s = self._worked_s = 0.0


def test_a_listener_hears_while_its_caller_works_and_both_are_waited_for():
    worked = threading.Event()

    def listen(recalled):
        assert worked.wait(10.0) and not recalled.is_set()
        return time.perf_counter()

    seat = Heard(listen)
    seat.while_waiting(worked.set)
    assert 0.0 < seat._worked_s <= seat._link_s


def test_what_a_listener_raises_is_raised_and_a_failure_of_the_work_recalls_it():
    def fails(recalled):
        raise OSError("the wire")

    with pytest.raises(OSError, match="the wire"):
        Heard(fails).while_waiting(lambda: None)
    heard = []

    def listens(recalled):
        while not recalled.is_set():
            time.sleep(0.001)
        heard.append(True)

    def works():
        raise ValueError("the work")

    with pytest.raises(ValueError, match="the work"):
        Heard(listens).while_waiting(works)
    assert heard == [True]


@pytest.mark.parametrize("updates", ["before_acting", "while_waiting"])
def test_updates_that_are_due_when_a_run_is_stopped_are_done_when_it_goes_on(tmp_path, monkeypatch, updates):
    """As many, and each with the rate that it would have had."""
    done, real = [], SeqDQN.do_updates

    def noted(self, steps, size):
        real(self, steps, size)
        done.append((self.num_timesteps, self._n_updates, self.policy.optimizer.param_groups[0]["lr"]))

    monkeypatch.setattr(SeqDQN, "do_updates", noted)
    fading = {"updates": updates, "learning_rate_fade": 1.0}
    learned(tmp_path / "straight", street, **fading)
    straight = done.copy()
    rates = [rate for *_, rate in straight]
    assert rates == sorted(set(rates), reverse=True), "another one each time"
    done.clear()
    asked = a_run(config(**SHORT, **fading), tmp_path / "parts", 1)
    with pytest.raises(InterruptedRunError):
        train_dqn(asked, lambda: Nervous(79, lambda: signal.raise_signal(signal.SIGTERM)))
    assert len(done) < len(straight)
    train_dqn(replace(asked, resume=True), street)
    assert done == straight, "none is lost between"
