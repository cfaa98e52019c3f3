"""Crashes, looked at one by one: the drives behind `python -m benchmarks crashes`.

One world with a few chairs, all driven by the same kind of policy. Starts and users of an episode depend on the seed,
the seat and the number of the episode, so that policies can be compared in pairs; only where somebody happens to be in
the way of a start is another one drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from benchmarks.crashes.records import Crash, Episode, LostControl
from benchmarks.crashes.watch import SeatWatch
from wcsim.agents.evaluation.suite.rows import garwood
from wcsim.agents.policy_api import SeesTruth
from wcsim.bridge.world import World
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import observation_of
from wcsim.towns.scenario.town import Town
from wcsim.types import ActorState, ClientSnapshot, Command, Joystick, SeatSpec

EPISODE_STEPS = 600


class Driver(Protocol):
    """What drives one chair, as the agents' policies do."""

    def begin(self) -> None:
        """A run starts."""

    def reset(self) -> None:
        """An episode starts."""

    def act(self, observation: Mapping[str, Any]) -> int:
        """The action for an observation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CrashDrive:
    """Everything that one policy met in one town."""

    town: str
    policy: str
    steps: int  # of all chairs
    km: float
    falls: int  # off a kerb, away from crossings
    lost_steps: int  # in stretches of lost control
    crashes: tuple[Crash, ...]
    lost: tuple[LostControl, ...]
    episodes: tuple[Episode, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """Events in a number of kilometres."""

    events: int
    km: float

    @property
    def per_km(self) -> tuple[float, float, float] | None:
        """Events per kilometre, and the bounds (95 %, Garwood) of what is expected; None without a way."""
        if self.km <= 0.0:
            return None
        low, high = garwood(self.events)
        return self.events / self.km, low / self.km, high / self.km


@dataclass(frozen=True, slots=True, kw_only=True)
class CrashOrder:
    """What to drive."""

    policy: str  # what the drivers are called
    profile: str  # of the users
    ticks: int  # of the world; each is a step of every chair
    seed: int  # of the world
    visible: bool = False  # the drivers are told, too, what is so of those of the others whom their cameras showed


def drive_crashes(
    order: CrashOrder,
    town: Town,
    config: RunConfig,
    drivers: Sequence[Driver],
    progress: Callable[[int], object] = lambda done: None,
) -> CrashDrive:
    """Let drivers drive one chair each in a town, and look at each of their crashes.

    Args:
        order: What to drive.
        town: Where.
        config: Of the world; its first camera is looked through.
        drivers: One for each chair.
        progress: Hears how many steps of all chairs are done.

    Raises:
        ConfigError: The profile is unknown.
        PolicyError: A driver cannot use what it is shown.
    """
    spec = SeatSpec(profile=order.profile, max_steps=EPISODE_STEPS, truth=True, truth_visible=order.visible)
    points = action_set(config.env.actions).points
    with World(town, config, (spec,) * len(drivers), order.seed) as world:
        now = world.snapshot.clients
        watches = [
            SeatWatch(seat, world.street, config, client, _others(world, seat.index))
            for seat, client in zip(world.seats, now, strict=True)
        ]
        for driver in drivers:
            driver.begin()
            driver.reset()
        for tick in range(order.ticks):
            commands = []
            for driver, watch, client in zip(drivers, watches, now, strict=True):
                x, y = points[_action(driver, client, config)].tolist()
                watch.give(Joystick(x, y))
                commands.append(Command(seat=client.seat, tick=world.snapshot.tick, joystick=Joystick(x, y)))
            snapshot = world.tick(commands)
            for driver, watch, client in zip(drivers, watches, snapshot.clients, strict=True):
                watch.take(client, _others(world, client.seat))
                if client.first is not None:
                    driver.reset()
            now = tuple(client.first or client for client in snapshot.clients)
            progress((tick + 1) * len(drivers))
        for watch in watches:
            watch.close()
    return _drive(town.name, order.policy, watches)


def _action(driver: Driver, client: ClientSnapshot, config: RunConfig) -> int:
    if isinstance(driver, SeesTruth):
        driver.see(client.truth)
    return driver.act(observation_of(client, config))


def _others(world: World, seat: int) -> tuple[ActorState, ...]:
    """Everybody but a seat's own chair."""
    return world.snapshot.actors + tuple(other.as_actor() for other in world.seats if other.index != seat)


def _drive(town: str, policy: str, watches: Sequence[SeatWatch]) -> CrashDrive:
    return CrashDrive(
        town=town,
        policy=policy,
        steps=sum(watch.steps for watch in watches),
        km=sum(watch.km for watch in watches),
        falls=sum(watch.falls for watch in watches),
        lost_steps=sum(watch.lost_steps for watch in watches),
        crashes=tuple(sorted((c for w in watches for c in w.crashes), key=lambda c: (c.tick, c.seat))),
        lost=tuple(sorted((item for w in watches for item in w.lost), key=lambda item: (item.tick, item.seat))),
        episodes=tuple(item for watch in watches for item in watch.episodes),
    )
