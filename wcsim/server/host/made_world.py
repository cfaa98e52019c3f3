"""The world of an order: for a hub in this process, and in a world process. Loads SUMO and PyBullet."""

from __future__ import annotations

from wcsim.bridge.world import World
from wcsim.core import seeding
from wcsim.server.specs import WorldOrder
from wcsim.towns.scenario.town import find_town


def made_world(order: WorldOrder, epoch: int = 0) -> World:
    """A world with free seats; each epoch has a seed of its own."""
    town, seed = find_town(order.town), epoch_seed(order.seed, epoch)
    return World(town, order.config, (None,) * order.seats, seed, order.place, epoch=epoch)


def epoch_seed(seed: int, epoch: int) -> int:
    """The seed of an epoch: the run's own for the first one."""
    return seed if epoch == 0 else seeding.derive(seed, "epoch", epoch)
