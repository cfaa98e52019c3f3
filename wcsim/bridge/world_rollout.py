"""The one loop over a world: the drivers of all seats give their sticks, then comes a tick."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from wcsim.bridge.world import World
from wcsim.types import ClientSnapshot, Command, Joystick, Snapshot

Driver = Callable[[ClientSnapshot], Joystick | None]
"""Gives one seat's stick for the frame of now; None once its chair has left the street."""
_USERS: Final[Mapping[int, Driver]] = MappingProxyType({})


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutStep:
    """One tick of a world."""

    commands: tuple[Command, ...]  # that led to it, by seat
    after: Snapshot


def rollout(world: World, drivers: Mapping[int, Driver] = _USERS) -> Iterator[RolloutStep]:
    """Carry a world on, a tick for each step that is taken, without end.

    The world may be read and changed between two steps: seats come, go and start again.

    Args:
        world: What is driven.
        drivers: By seat; for all others their users drive. They are called in the order of the
            seats, a new episode with its first frame.

    Raises:
        SumoError, PhysicsError: The world is broken.
    """
    while True:
        now, given = world.snapshot, []
        for client in now.clients:
            stick = drivers.get(client.seat, _user_stick)(client.first or client)
            if stick is not None:
                given.append(Command(seat=client.seat, tick=now.tick, joystick=stick))
        commands = tuple(given)
        yield RolloutStep(commands=commands, after=world.tick(commands))


def _user_stick(now: ClientSnapshot) -> Joystick:
    """The user's joystick: the baseline `follow`, without the grid of actions."""
    return now.user
