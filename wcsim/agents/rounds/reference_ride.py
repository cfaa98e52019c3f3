"""One short drive of a user alone, as observations: what exported policies are compared on."""

from __future__ import annotations

from wcsim.agents.envs.episode_view import Chair, HeldLink
from wcsim.agents.envs.senses import with_senses
from wcsim.agents.policies.dynamic_window.surroundings import SENSES
from wcsim.agents.policy_api import Observation
from wcsim.bridge.world import World, as_users_wish
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.towns.scenario.town import find_town
from wcsim.types import SeatSpec


def reference_ride(town: str, config: RunConfig, steps: int, seed: int = 0) -> list[Observation]:
    """Observations of so many successive ticks of one chair. Raises TownError."""
    sensing, link = with_senses(config, SENSES), HeldLink()
    spec, actions = SeatSpec(profile=config.env.profile, max_steps=steps + 1), action_set(config.env.actions)
    found: list[Observation] = []
    with World(find_town(town), sensing, (spec,), seed) as world:
        (client,) = world.snapshot.clients
        chair = Chair(sensing)
        seen, _ = chair.begin(client)
        while len(found) < steps:
            found.append(seen)
            wish = client.user
            chair.send(link, actions.nearest((wish.x, wish.y)))
            (client,) = world.tick(as_users_wish(world.snapshot)).clients
            link.now = client
            step = chair.receive(link)
            seen = step.observation
            if client.first is not None:
                client = client.first
                seen, _ = chair.begin(client)
    return found
