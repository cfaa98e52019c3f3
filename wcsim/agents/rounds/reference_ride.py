"""One short drive with a policy, as observations: what exported policies are compared on."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from wcsim.agents.envs.episode_view import Chair, HeldLink
from wcsim.agents.envs.senses import senses_of, with_senses
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation, Policy
from wcsim.bridge.world import World
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.supervisor.actions import action_set
from wcsim.towns.scenario.town import find_town
from wcsim.types import F32, Command, Joystick, SeatSpec

PUSH_TICKS: Final = 20  # so long the stick is held somewhere, and so long the user has it again
TRIES: Final = 5  # episodes, until one is long enough
_WIDEST_RAD: Final = 2.0  # of a push, from ahead


def reference_ride(town: str, config: RunConfig, steps: int, policy: Policy, seed: int = 0) -> list[Observation]:
    """Observations of so many successive ticks of one chair that a policy drives, all of one episode.

    By turns the stick is the simulated user's, and pushed to its end in one direction, towards whatever is there: a
    user who never errs would give a policy nothing to do, and a blind one would do as well. Where the episode ends it
    begins anew; where each one ends it is the longest, with fewer steps. Raises TownError.
    """
    sensing = with_senses(config, senses_of(policy))
    spec = SeatSpec(profile=config.env.profile, max_steps=steps + 1)
    pushes, longest = _pushed_sticks(steps, seed), list[Observation]()
    with World(find_town(town), sensing, (spec,), seed) as world:
        policy.begin()
        for _ in range(TRIES):
            found = _episode(world, sensing, policy, pushes)
            longest = max(longest, found, key=len)
            if len(longest) == steps:
                break
    return longest


def _episode(world: World, config: RunConfig, policy: Policy, pushes: F32) -> list[Observation]:
    """Observations from the beginning of an episode to its end, or until there is one for each push."""
    chair, link, points = Chair(config), HeldLink(), action_set(config.env.actions).points
    (client,) = world.snapshot.clients
    seen, _ = chair.begin(client.first or client)
    policy.reset()
    found: list[Observation] = []
    for push in pushes:
        found.append(seen if np.isnan(push).any() else {**seen, JOYSTICK_KEY: push})
        action = policy.act(found[-1])
        chair.send(link, action)
        stick = Joystick(*points[action].tolist())
        (client,) = world.tick((Command(seat=0, tick=world.snapshot.tick, joystick=stick),)).clients
        link.now = client
        seen = chair.receive(link).observation
        if client.first is not None:
            break
    return found


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
