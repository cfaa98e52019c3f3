"""One short drive with a policy, as observations: what exported policies are compared on."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from wcsim.agents.envs.episode_view import Info
from wcsim.agents.envs.seat_driver import SeatDriver
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation, Policy, sense_settings, senses_of
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig, resolve
from wcsim.core import seeding
from wcsim.towns.scenario.town import find_town
from wcsim.types import F32, SeatSpec

PUSH_TICKS: Final = 20  # so long the stick is held somewhere, and so long the user has it again
TRIES: Final = 5  # episodes, until one is long enough
_WIDEST_RAD: Final = 2.0  # of a push, from ahead


def reference_ride(town: str, config: RunConfig, steps: int, policy: Policy, seed: int = 0) -> list[Observation]:
    """Observations of so many successive ticks of one chair that a policy drives, all of one episode.

    By turns the stick is the simulated user's, and pushed to its end in one direction, towards whatever is there: a
    user who never errs would give a policy nothing to do, and a blind one would do as well. Where the episode ends it
    begins anew; where each one ends it is the longest, with fewer steps. Raises TownError.
    """
    sensing = resolve(config, sense_settings(config, senses_of(policy)))
    spec = SeatSpec(profile=config.env.profile, max_steps=steps + 1)
    pushes, longest = _pushed_sticks(steps, seed), list[Observation]()
    with World(find_town(town), sensing, (spec,), seed) as world:
        policy.begin()
        agent, tries = _Pushed(policy, pushes), 0
        driver = SeatDriver(sensing, agent, world.snapshot.clients[0])
        for step in rollout(world, {0: driver.choose}):
            (client,) = step.after.clients
            driver.take(client)
            if client.first is None and len(agent.seen) < steps:
                continue
            longest, tries = max(longest, agent.seen, key=len), tries + 1
            if len(longest) == steps or tries == TRIES:
                break
    return longest


class _Pushed:
    """Around a policy: the stick is pushed where it is not the user's own; `seen` is what it saw in this episode."""

    def __init__(self, policy: Policy, pushes: F32) -> None:
        self.seen: list[Observation] = []
        self._policy, self._pushes = policy, pushes

    def reset(self, info: Info) -> None:
        """Begin an episode; the policy reckons with the configured delay, as its export does."""
        self.seen = []
        self._policy.reset()

    def act(self, observation: Observation, info: Info) -> int:
        """Ask the policy."""
        push = self._pushes[len(self.seen)]
        self.seen.append(observation if np.isnan(push).any() else {**observation, JOYSTICK_KEY: push})
        return self._policy.act(self.seen[-1])


def _pushed_sticks(steps: int, seed: int) -> F32:
    """The stick at each step, (steps, 2) in -1..1; NaN where it is the user's own."""
    angles_rad = seeding.generator(seed, "pushes").uniform(-_WIDEST_RAD, _WIDEST_RAD, steps // PUSH_TICKS + 1)
    rows = [
        (math.sin(angles_rad[step // PUSH_TICKS]), math.cos(angles_rad[step // PUSH_TICKS]))
        if step // PUSH_TICKS % 2
        else (math.nan, math.nan)
        for step in range(steps)
    ]
    return np.array(rows, np.float32)
