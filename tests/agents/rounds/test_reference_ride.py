"""Reference rides: successive ticks of one episode, whatever the policy runs into."""

from pathlib import Path

import numpy as np

from tests.support.samples import ACTIONS
from tests.support.worlds import quick_config
from wcsim.agents.policy_api import Observation
from wcsim.agents.rounds.recorded_ride import TRIES, reference_ride
from wcsim.config import RunConfig

AHEAD, AT_REST = ACTIONS.nearest((0.0, 1.0)), ACTIONS.nearest((0.0, 0.0))
STEPS, STARTS_AT = 30, 10


def easily_shaken() -> RunConfig:
    """A chair that sets out counts as crashed."""
    return quick_config("imu.accel_window=tick_mean", "reward.accel_window_mps2=[0.2,0.4]")


class StartsHard:
    """Stands in each episode for some steps, and then pushes the stick ahead: in all but the last of so many."""

    name = "starts hard"

    def __init__(self, crashes: int) -> None:
        self.episodes: list[list[Observation]] = []
        self._crashes = crashes

    def begin(self) -> None:
        self.episodes = []

    def reset(self) -> None:
        self.episodes.append([])

    def act(self, observation: Observation) -> int:
        self.episodes[-1].append(observation)
        pushes = len(self.episodes) <= self._crashes and len(self.episodes[-1]) > STARTS_AT + len(self.episodes)
        return AHEAD if pushes else AT_REST


def test_after_a_crash_the_ride_begins_anew_and_so_does_its_policy(corner: Path) -> None:
    policy = StartsHard(crashes=1)
    ride = reference_ride(str(corner), easily_shaken(), STEPS, policy, seed=3)
    crashed, whole = policy.episodes
    assert STARTS_AT < len(crashed) < STEPS
    assert len(whole) == len(ride) == STEPS and all(seen is told for seen, told in zip(ride, whole, strict=True))
    pushed = [float(np.hypot(*seen["joystick"])) > 0.999 for seen in ride]
    assert all(pushed[20:]), "the user drives first, then the stick is pushed"


def test_a_policy_that_crashes_each_time_gives_its_longest_episode(corner: Path) -> None:
    policy = StartsHard(crashes=TRIES)
    ride = reference_ride(str(corner), easily_shaken(), STEPS, policy, seed=3)
    lengths = [len(episode) for episode in policy.episodes]
    assert len(lengths) == TRIES and len(ride) == max(lengths) < STEPS
    assert ride[0] is policy.episodes[lengths.index(max(lengths))][0]
