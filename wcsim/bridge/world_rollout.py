"""The one loop over a world.

The drivers of all seats are asked, then the world goes on by a tick.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from wcsim.bridge.world import World
from wcsim.types import ClientSnapshot, Command, Joystick, Snapshot

Driver = Callable[[ClientSnapshot], Joystick | None]
"""Answers for one seat: its stick for the frame of now.

None once it has taken its chair out of the street.
"""
_USERS: Final[Mapping[int, Driver]] = MappingProxyType({})


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutStep:
    """One tick of a world."""

    commands: tuple[Command, ...]  # that led to it, by seat
    after: Snapshot


def rollout(world: World, drivers: Mapping[int, Driver] = _USERS) -> Iterator[RolloutStep]:
    """Carry a world on, a tick for each step that is asked for, without end.

    Whoever looks on does so between two steps. The world may be changed there: seats come, go and
    begin again.

    Args:
        world: What is driven.
        drivers: By seat; for all others their users drive. They are asked in the order of the
            seats, a new episode with its first frame.

    Raises:
        SumoError, PhysicsError: The world is broken.
    """
    while True:
        commands = _commands(world, drivers)
        yield RolloutStep(commands=commands, after=world.tick(commands))


def _commands(world: World, drivers: Mapping[int, Driver]) -> tuple[Command, ...]:
    now, commands = world.snapshot, []
    for client in now.clients:
        stick = drivers.get(client.seat, _as_user)(client.first or client)
        if stick is not None:
            commands.append(Command(seat=client.seat, tick=now.tick, joystick=stick))
    return tuple(commands)


def _as_user(now: ClientSnapshot) -> Joystick:
    """What the user's joystick says: the baseline `follow`, without the grid of actions."""
    return now.user
