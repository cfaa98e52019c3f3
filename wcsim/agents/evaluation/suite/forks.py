"""Forks of a world: what would have happened had the user driven alone from this tick on.

The world's process is copied (`os.fork`) where it stands. That is the same as a replay of the episode to this tick,
at the price of the ticks after it alone; the copy never comes back into the world that it was made of.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Mapping
from typing import Final

from wcsim.bridge.world import World
from wcsim.errors import PhysicsError
from wcsim.supervisor.actions import ActionSet
from wcsim.types import Command, Joystick, Snapshot

ALONE_S: Final = 5.0
_ANSWER = struct.Struct("<d")
_MOST_SAID: Final = 2000


def crash_alone_s(world: World, seat: int, actions: ActionSet, tick_s: float) -> float | None:
    """Seconds until a seat's chair crashes when its user drives alone from now on; None within `ALONE_S`.

    The other chairs leave the street of the copy. The world itself does not move.

    Raises:
        PhysicsError: The copy ended without an answer.
    """
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reader)
            os.write(writer, _answer(world, seat, actions, tick_s))
        finally:
            os._exit(0)  # nothing of the parent's may be closed, flushed or removed here
    os.close(writer)
    with os.fdopen(reader, "rb") as answers:
        answer = answers.read()
    os.waitpid(pid, 0)
    if len(answer) != _ANSWER.size:
        said = answer.decode(errors="replace") or "no answer"
        raise PhysicsError(
            f"the copy of the world that judges seat {seat} returned {said}; expected seconds: try again"
        )
    (crash_s,) = _ANSWER.unpack(answer)
    return None if math.isinf(crash_s) else float(crash_s)


def _answer(world: World, seat: int, actions: ActionSet, tick_s: float) -> bytes:
    """What a copy says: seconds, or what went wrong in it."""
    try:
        return _ANSWER.pack(_alone(world, seat, actions, tick_s))
    except Exception as error:  # it is told where it is understood: in the process that was copied
        return f"{type(error).__name__}: {error}"[:_MOST_SAID].encode()


def _alone(world: World, seat: int, actions: ActionSet, tick_s: float) -> float:
    for other in [ego.index for ego in world.seats if ego.index != seat]:
        world.dismiss(other)
    world.go_blind()
    world.drop_step_limits()  # a fork at the end of an episode looks as far ahead as any other
    snapshot = world.snapshot
    for tick in range(1, round(ALONE_S / tick_s) + 1):
        snapshot = world.tick(users_alone(snapshot, actions, {}))
        (client,) = snapshot.clients
        if client.events.crashed:
            return tick * tick_s
        if client.first is not None or client.events.arrived or client.events.gave_up:
            break  # an episode ends here, and whatever came on the next way
    return math.inf


def users_alone(snapshot: Snapshot, actions: ActionSet, given: Mapping[int, int]) -> tuple[Command, ...]:
    """Commands for all seats: the action of `given`, by seat, or that nearest to the user's stick."""
    commands = []
    for client in snapshot.clients:
        stick = (client.first or client).user
        index = given.get(client.seat, -1)
        x, y = actions.points[actions.nearest((stick.x, stick.y)) if index < 0 else index].tolist()
        commands.append(Command(seat=client.seat, tick=snapshot.tick, joystick=Joystick(x, y)))
    return tuple(commands)
