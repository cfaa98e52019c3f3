"""The world of an order: for a hub in this process, and in a world process. Loads SUMO and PyBullet."""

from __future__ import annotations

from typing import Protocol

from wcsim.bridge.replay.seat_world import Specs, W_co
from wcsim.bridge.world import World
from wcsim.core import seeding
from wcsim.server.specs import WorldOrder, town_of_epoch
from wcsim.towns.making.asked_town import asked_town


class MakesWorld(Protocol[W_co]):
    """Makes the worlds of orders."""

    def __call__(self, order: WorldOrder, specs: Specs, seed: int, *, epoch: int = 0) -> W_co:
        """A world with a chair for each of `specs` that is not None; `epoch` is the number of its first epoch."""


def made_world(order: WorldOrder) -> World:
    """A world with free seats."""
    return street_world(order, (None,) * order.seats, order.seed)


def street_world(order: WorldOrder, specs: Specs, seed: int, *, epoch: int = 0) -> World:
    """The world of a town; see `MakesWorld`. Raises TownError for one that is not there, and what `World` raises."""
    town = asked_town(town_of_epoch(order.town, order.more_towns, epoch))
    return World(town, order.config, specs, seed, order.place, epoch=epoch)


def epoch_seed(seed: int, epoch: int) -> int:
    """The seed of an epoch: the run's own for the first one."""
    return seed if epoch == 0 else seeding.derive(seed, "epoch", epoch)
