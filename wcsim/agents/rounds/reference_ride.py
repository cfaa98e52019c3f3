"""One short drive with a policy, as observations: what exported policies are compared on."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from wcsim.agents.envs.episode_view import Chair, HeldLink
from wcsim.agents.envs.senses import with_senses
from wcsim.agents.policies.dynamic_window.surroundings import SENSES
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation, Policy
from wcsim.bridge.world import World
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.supervisor.actions import action_set
from wcsim.towns.scenario.town import find_town
from wcsim.types import F32, Command, Joystick, SeatSpec

PUSH_TICKS: Final = 20  # so long the stick is held somewhere, and so long the user has it again
_WIDEST_RAD: Final = 2.0  # of a push, from ahead


def reference_ride(town: str, config: RunConfig, steps: int, policy: Policy, seed: int = 0) -> list[Observation]:
    """Observations of so many successive ticks of one chair that a policy drives.

    By turns the stick is the simulated user's, and pushed to its end in one direction, towards whatever is there: a
    user who never errs would give a policy nothing to do, and a blind one would do as well. Raises TownError.
    """
    sensing, link = with_senses(config, SENSES), HeldLink()
    spec, actions = SeatSpec(profile=config.env.profile, max_steps=steps + 1), action_set(config.env.actions)
    pushes = pushed_sticks(steps, seed)
    found: list[Observation] = []
    with World(find_town(town), sensing, (spec,), seed) as world:
        (client,) = world.snapshot.clients
        chair = Chair(sensing)
        seen, _ = chair.begin(client)
        policy.begin()
        policy.reset()
        while len(found) < steps:
            push = pushes[len(found)]
            found.append(seen if np.isnan(push).any() else {**seen, JOYSTICK_KEY: push})
            action = policy.act(found[-1])
            chair.send(link, action)
            stick = Joystick(*actions.points[action].tolist())
            (client,) = world.tick((Command(seat=0, tick=world.snapshot.tick, joystick=stick),)).clients
            link.now = client
            step = chair.receive(link)
            seen = step.observation
            if client.first is not None:
                client = client.first
                seen, _ = chair.begin(client)
    return found


def pushed_sticks(steps: int, seed: int) -> F32:
    """The stick at each step, (steps, 2) in -1..1; NaN where it is the user's own."""
    angles_rad = seeding.generator(seed, "pushes").uniform(-_WIDEST_RAD, _WIDEST_RAD, steps // PUSH_TICKS + 1)
    rows = [
        (math.sin(angles_rad[step // PUSH_TICKS]), math.cos(angles_rad[step // PUSH_TICKS]))
        if step // PUSH_TICKS % 2
        else (math.nan, math.nan)
        for step in range(steps)
    ]
    return np.array(rows, np.float32)
