"""The street notices the wheelchairs: drivers and cyclists brake for one in their way, people stop short of it.

SUMO never learns of the chairs; what they do to the traffic goes through `setSpeed` alone, because placing a proxy with
`moveToXY` kills libsumo on real nets. Drivers see a chair one tick late. Who does not look (1 - attention share) is
drawn once per actor from the seed, so it does not depend on the order of things.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wcsim import frames, seeding
from wcsim.config import WorldConfig
from wcsim.types import F64, ActorKind, ActorState

CHAIR_HALF_WIDTH_M = 0.40  # half the chair's width and a hand's breadth
SIDE_GAP_M = 0.6  # drivers leave this much beside the chair
STOP_SHORT_M = 2.0  # and stop this far before it
LOOK_BEHIND_M = 1.0
HORIZON_S = 3.0
PERSON_REACH_M = 1.1
PERSON_GAP_M = 0.15
STRAIGHT_PER_M = 0.01  # a path that bends less than this counts as straight
WEAKER_BRAKES = {
    ActorKind.BICYCLE: 0.6,
    ActorKind.SCOOTER: 0.6,
    ActorKind.TRAM: 0.6,
    ActorKind.BUS: 0.85,
    ActorKind.TRUCK: 0.85,
}
"""Share of a car's braking that SUMO grants a kind by default (4.5 m/s^2 for a car, 3 for a bicycle)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChairInStreet:
    """What others see of a wheelchair."""

    p_W_m: F64  # (2,) middle of the chair
    v_W_mps: F64  # (2,)
    on_road: bool  # on a carriageway or a crossing, not up on a pavement


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedOrder:
    """Hold an actor at a speed; -1 gives it back to SUMO."""

    actor: ActorState
    speed_mps: float


@dataclass(slots=True)
class _Watch:
    """What the reaction remembers of an actor that has a chair in its way."""

    actor: ActorState
    seen_for_s: float = 0.0
    held: bool = False


class StreetReaction:
    """Decides each tick who brakes for a wheelchair, and who is let go again."""

    def __init__(self, config: WorldConfig, seed: int) -> None:
        self._config = config
        self._seed = seed
        self._watched: dict[str, _Watch] = {}
        self._yaw_rad: dict[str, float] = {}

    def react(self, actors: Iterable[ActorState], chairs: tuple[ChairInStreet, ...]) -> tuple[SpeedOrder, ...]:
        """Orders for this tick, in the actors' order; an actor nobody is in the way of any more gets -1 once."""
        orders: list[SpeedOrder] = []
        watched: dict[str, _Watch] = {}
        yaw_rad: dict[str, float] = {}
        for actor in actors:
            yaw_rad[actor.id] = actor.yaw_rad
            turned_rad = frames.wrap(actor.yaw_rad - self._yaw_rad.get(actor.id, actor.yaw_rad))
            bend_per_m = bend(actor, turned_rad / self._config.tick_s)
            limits = (speed_limit(actor, chair, self._config.brake_mps2, bend_per_m) for chair in chairs)
            limit_mps = min(limits, default=math.inf)
            old = self._watched.get(actor.id)
            if not math.isfinite(limit_mps):
                if old is not None and old.held:
                    orders.append(SpeedOrder(actor=actor, speed_mps=-1.0))
                continue
            watch = watched[actor.id] = old or _Watch(actor)
            watch.seen_for_s += self._config.tick_s
            if watch.seen_for_s >= self._reaction_s(actor) and self._looks(actor):
                watch.held = True
                orders.append(SpeedOrder(actor=actor, speed_mps=limit_mps))
        orders += [SpeedOrder(actor=w.actor, speed_mps=-1.0) for w in self._out_of_sight(yaw_rad)]
        self._watched, self._yaw_rad = watched, yaw_rad
        return tuple(orders)

    def _out_of_sight(self, seen: Iterable[str]) -> list[_Watch]:
        """Held actors that no chair is near any more (one that was respawned elsewhere, say): they are let go."""
        names = set(seen)
        return [watch for name, watch in self._watched.items() if watch.held and name not in names]

    def _reaction_s(self, actor: ActorState) -> float:
        return 0.0 if actor.kind is ActorKind.PEDESTRIAN else self._config.reaction_s

    def _looks(self, actor: ActorState) -> bool:
        if self._config.attention_share >= 1.0:
            return True
        draw = seeding.generator(self._seed, "attention", actor.id).random()
        return bool(draw < self._config.attention_share)


def bend(actor: ActorState, yaw_rate_radps: float) -> float:
    """How much the actor's path bends, in 1/m, left positive; 0 for one that stands or drives straight on."""
    speed_mps = float(np.hypot(actor.v_W_mps[0], actor.v_W_mps[1]))
    bend_per_m = yaw_rate_radps / speed_mps if speed_mps > 0.5 else 0.0
    return bend_per_m if abs(bend_per_m) > STRAIGHT_PER_M else 0.0


def along_path(ahead_m: float, aside_m: float, bend_per_m: float) -> tuple[float, float]:
    """A point ahead and to the left, as distance along and left of a path that starts straight ahead and bends.

    >>> along_path(5.0, 5.0, 0.2)  # a quarter of a circle of radius 5 m leads there
    (7.853981633974483, 0.0)
    """
    if not bend_per_m:
        return ahead_m, aside_m
    side, radius_m = math.copysign(1.0, bend_per_m), 1.0 / abs(bend_per_m)
    inward_m = radius_m - side * aside_m  # from the centre of the circle, across to the point
    along_m = radius_m * math.atan2(ahead_m, inward_m)
    return along_m, side * (radius_m - math.hypot(ahead_m, inward_m))


def speed_limit(actor: ActorState, chair: ChairInStreet, brake_mps2: float, bend_per_m: float = 0.0) -> float:
    """The speed in m/s at which this actor may still stop short of the chair; infinite when it is not in the way.

    A vehicle looks along its own path: stopping distance v^2 / 2b + 0.7 v + 2 m, and 8 m more; sideways it counts
    the gap now and the gap at the time it would arrive (at most 3 s ahead). A chair up on a pavement is passed
    without a gap.
    """
    cos, sin = math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)
    dx, dy = float(chair.p_W_m[0] - actor.p_W_m[0]), float(chair.p_W_m[1] - actor.p_W_m[1])
    ahead_m = dx * cos + dy * sin - 0.5 * actor.size_lwh_m[0]
    aside_m = dy * cos - dx * sin
    if actor.kind is ActorKind.PEDESTRIAN:
        keep_m = CHAIR_HALF_WIDTH_M + 0.5 * actor.size_lwh_m[1] + PERSON_GAP_M
        return 0.0 if 0.0 < ahead_m < PERSON_REACH_M and abs(aside_m) < keep_m else math.inf
    speed_mps = float(np.hypot(actor.v_W_mps[0], actor.v_W_mps[1]))
    brake_mps2 *= WEAKER_BRAKES.get(actor.kind, 1.0)
    ahead_m, aside_m = along_path(ahead_m, aside_m, bend_per_m)
    stopping_m = speed_mps**2 / (2.0 * brake_mps2) + 0.7 * speed_mps + STOP_SHORT_M
    if not -LOOK_BEHIND_M < ahead_m < stopping_m + 8.0:
        return math.inf
    drift_mps = float(chair.v_W_mps[1] * cos - chair.v_W_mps[0] * sin)
    arrives_s = min(max(ahead_m, 0.0) / max(speed_mps, 0.5), HORIZON_S)
    keep_m = 0.5 * actor.size_lwh_m[1] + CHAIR_HALF_WIDTH_M + (SIDE_GAP_M if chair.on_road else 0.0)
    if min(abs(aside_m), abs(aside_m + drift_mps * arrives_s)) >= keep_m:
        return math.inf
    return math.sqrt(2.0 * brake_mps2 * max(0.0, ahead_m - STOP_SHORT_M))
