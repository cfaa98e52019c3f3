"""What a shared world saves, and what it would on other machines: a model of measured parts.

A tick is the world's step with n chairs, the barrier, and what the clients do on the cores there are; a start is the
same work for each process. Everything is measured in runs of one client alone, but for the world's step with several
chairs. The model knows nothing of caches and of clock rates; its error is printed
beside it wherever something was measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientCost:
    """What a client does by itself in a tick, in the mean, in seconds."""

    name: str
    act_s: float  # and all else that is neither learning nor waiting
    learn_s: float

    @property
    def own_s(self) -> float:
        """All of it."""
        return self.act_s + self.learn_s


@dataclass(frozen=True, slots=True, kw_only=True)
class SharingParts:
    """The measured parts, in seconds."""

    clients: tuple[ClientCost, ...]
    world_s: Mapping[int, float]  # a tick by the number of chairs; 1 must be there
    barrier_s: float  # a tick of one client alone
    start_s: float  # from the command to the first tick and from the last one to the end, for one client alone
    start_cores: int  # where that was measured
    later: bool = False  # updates are done while a client waits


def makespan_s(works_s: Sequence[float], cores: int) -> float:
    """How long works take on so many cores, the longest first.

    >>> makespan_s([3.0, 2.0, 2.0], 2), makespan_s([3.0, 2.0, 2.0], 8), makespan_s([], 2)
    (4.0, 3.0, 0.0)
    """
    ends = [0.0] * max(1, cores)
    for work_s in sorted(works_s, reverse=True):
        ends[ends.index(min(ends))] += work_s
    return max(ends)


def world_tick_s(parts: SharingParts, chairs: int) -> float:
    """A world's step: as measured, else by a straight line through what was."""
    if chairs in parts.world_s:
        return parts.world_s[chairs]
    if len(parts.world_s) < 2:
        return parts.world_s[1]
    slope, base = np.polyfit(list(parts.world_s), list(parts.world_s.values()), 1)
    return float(base + slope * chairs)


def tick_s(parts: SharingParts, clients: Sequence[ClientCost], cores: int) -> float:
    """A tick of these clients in one world."""
    world_s = world_tick_s(parts, len(clients)) + parts.barrier_s
    own_s = [client.own_s for client in clients]
    if not parts.later:
        return world_s + makespan_s(own_s, cores)
    acting_s = makespan_s([client.act_s for client in clients], cores)
    return max(world_s + acting_s, max(own_s), (world_s + sum(own_s)) / min(cores, len(clients) + 1))


def start_s(parts: SharingParts, clients: int, cores: int) -> float:
    """From the command to the first tick: a world and its clients start at once, each with the same work."""
    of_one_s = parts.start_s / max(1.0, 2.0 / parts.start_cores)
    return of_one_s * max(1.0, (clients + 1) / cores)


def together_s(parts: SharingParts, clients: Sequence[ClientCost], steps: int, cores: int) -> float:
    """A run of all in one world."""
    return start_s(parts, len(clients), cores) + steps * tick_s(parts, clients, cores)


def apart_s(parts: SharingParts, clients: Sequence[ClientCost], steps: int, cores: int) -> float:
    """The same, one after the other, each in a world of its own."""
    return sum(together_s(parts, [client], steps, cores) for client in clients)


@dataclass(frozen=True, slots=True, kw_only=True)
class Saved:
    """Where the difference between one after the other and together comes from, in seconds."""

    world_s: float  # one world instead of several
    start_s: float
    rest_s: float  # cores that were idle, less what the processes take from each other


def saved(
    parts: SharingParts, steps: int, apart: Sequence[tuple[float, float]], together: tuple[float, float]
) -> Saved:
    """Take measured times apart.

    Args:
        parts: For the world's steps.
        steps: Of each client.
        apart: (wall time, start) of each run of one client alone.
        together: The same of all in one world.
    """
    world_s = steps * (len(apart) * world_tick_s(parts, 1) - world_tick_s(parts, len(apart)))
    starts_s = sum(start for _, start in apart) - together[1]
    return Saved(
        world_s=world_s, start_s=starts_s, rest_s=sum(wall for wall, _ in apart) - together[0] - world_s - starts_s
    )
