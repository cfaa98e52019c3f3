"""A policy driven through episodes of any environment, and its row."""

from typing import Any

import gymnasium as gym
import numpy as np

from wcsim.agents.envs.episode_view import OBJECTS, InfoObjects
from wcsim.agents.evaluation.suite.records import CRASHED, TIMED_OUT, EpisodeRecord
from wcsim.agents.evaluation.suite.rows import ResultRow, row_of
from wcsim.agents.policy_api import Policy, SeesTruth, pass_delay
from wcsim.config import RunConfig
from wcsim.supervisor.kpi import KpiStep, make_crash_fields, sum_kpi_steps
from wcsim.types import Events, Joystick, Truth


def driven(
    policy: Policy, env: gym.Env[Any, Any], episodes: int, max_steps: int, seed: int = 0, tick_s: float = 0.1
) -> ResultRow:
    """The first episode begins with the seed."""
    records = []
    policy.begin()
    for number in range(episodes):
        seen, info = env.reset(seed=seed) if number == 0 else env.reset()
        pass_delay(policy, info[OBJECTS].drawn)
        policy.reset()
        steps, ended = [], {"status": TIMED_OUT}
        for _ in range(max_steps):
            truth = info[OBJECTS].truth  # of the moment that the agent answers to
            if isinstance(policy, SeesTruth):
                policy.see(truth)
            seen, _, terminated, truncated, info = env.step(policy.act(seen))
            steps.append(KpiStep.of(info))
            events = info[OBJECTS].events
            if events.crashed:
                ended = {"status": CRASHED, **make_crash_fields(events, (), steps, tick_s, RunConfig().reward)}
            if terminated or truncated:
                break
        sums = sum_kpi_steps(steps, tick_s)
        place = {"block": number, "seat": 0, "part": "", "town": "", "profile": ""}
        records.append(EpisodeRecord(**place, time_s=sums["steps"] * tick_s, **ended, **sums))
    return row_of(policy.name, "", records, ())


class Script(gym.Env):
    """Distances 0, 0.1, 0.2, ... of an episode; danger whenever the distance about to be answered is at least 0.2."""

    def __init__(self, crash_at=6, speed_mps=1.0, truth=True):
        self.crash_at, self.speed_mps, self.truth = crash_at, speed_mps, truth
        self.seeds = []

    def _info(self, distance):
        truth = Truth(
            intent=Joystick(0, 0), danger=self.k >= 2, first_s=np.full(81, np.inf), clearance_m=1, progress_m=0
        )
        events = Events(
            episode=0, step=self.k, crashed=self.k == self.crash_at, truncated=False, arrived=self.k == 2,
            crash_reason="tilt" if self.k == self.crash_at else "", gave_up=self.k == 3,
            help_asked=self.k == 2, crossed=self.k in (1, 2), entered_red=self.k == 1, on_carriageway=self.k >= 4,
            crash="tilted too far, at x 1.0 y 2.0 in the net, edge e" if self.k == self.crash_at else "",
        )  # fmt: skip
        return {
            "joystick_distance": distance, "speed_mps": self.speed_mps, "help": events.help_asked,
            OBJECTS: InfoObjects(
                truth=truth if self.truth else None, events=events,
                asked=Joystick(0.0, 0.2 + 0.2 * self.k), given=Joystick(0.0, 0.0),
            ),
        }  # fmt: skip

    def reset(self, *, seed=None, options=None):
        self.seeds.append(seed)
        self.k = 0
        return {"joystick": np.zeros(2, np.float32)}, self._info(0.0)

    def step(self, action):
        distance = self.k / 10
        self.k += 1
        return {"joystick": np.zeros(2, np.float32)}, 0.0, self.k == self.crash_at, False, self._info(distance)
