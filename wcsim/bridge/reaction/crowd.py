"""Who is near a wheelchair, and what drives beside them, in plain numbers for the side step."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from wcsim.bridge.reaction.commands import ChairInStreet
from wcsim.core.boxes import Box, box_from_actor
from wcsim.types import F64, ActorState

_CROWD_M = 7.0  # people this near a chair are looked at
PEOPLE_AHEAD_M = 2.5
_NEAR_VEHICLE_M = 4.0
_MOVES_M = 3.0  # more than anybody's offset changes within a tick
SWEEP_S = 1.5  # people beside a moving vehicle mind where it will be for so long
_MOVING_MPS = 0.1

Offsets = Mapping[str, tuple[float, float]]


@dataclass(slots=True)
class Walker:
    """One person near a chair, during one tick."""

    id: str
    x: float  # SUMO's place
    y: float
    cos: float
    sin: float
    speed_mps: float
    radius_m: float
    p_W_m: F64
    ox: float  # the offset
    oy: float
    chair_m: float = math.inf  # to the nearest chair: who is nearer goes first

    @property
    def left_m(self) -> float:
        """The offset's part to the left of where the person looks."""
        return self.oy * self.cos - self.ox * self.sin

    @property
    def at(self) -> tuple[float, float]:
        """Where it really is."""
        return self.x + self.ox, self.y + self.oy

    @property
    def aside(self) -> bool:
        """Whether it is anywhere but where SUMO has it."""
        return self.ox != 0.0 or self.oy != 0.0


class Vehicle(NamedTuple):
    """Something that stands or drives beside the people near a chair."""

    reach_m: float  # how far around it one minds it
    box: Box
    sweep: Box  # what its body covers until it has driven on for a while
    moves: bool


def crowd_of(
    actors: Sequence[ActorState], chairs: Sequence[ChairInStreet], offsets: Offsets, shifted: bool
) -> list[Walker]:
    """The persons near a chair, those still aside, and who is near these, in the actors' order.

    Args:
        actors: Everybody near the chairs, sorted.
        chairs: The wheelchairs.
        offsets: Of those who have stepped aside, by name.
        shifted: The actors are where they really walk, not where SUMO has them.
    """
    if not (chairs or offsets):
        return []
    places = [chair.p_W_m.tolist() for chair in chairs]
    far: list[tuple[float, float]] = []  # of those aside, and away from the chairs by now
    crowd, others = [], []
    for actor in actors:
        if not actor.is_person:
            continue
        x, y, _ = actor.p_W_m.tolist()
        chair_m = min([math.hypot(x - px, y - py) for px, py in places], default=math.inf)
        offset = offsets.get(actor.id)
        if chair_m > _CROWD_M and offset is None:
            others.append((actor, chair_m))
            continue
        walker = _walker(actor, offset or (0.0, 0.0), shifted, chair_m)
        crowd.append(walker)
        if offset is not None and chair_m > _CROWD_M - PEOPLE_AHEAD_M:
            far.append(walker.at)
    if not far:
        return crowd
    # SUMO does not know who is aside, so those beside them have to be looked at too.
    for actor, chair_m in others:
        if _is_beside(actor, far):
            crowd.append(_walker(actor, (0.0, 0.0), False, chair_m))
    # By id again: commands to SUMO must have one order.
    return sorted(crowd, key=lambda walker: walker.id)


def _walker(
    actor: ActorState, offset: tuple[float, float], shifted: bool, chair_m: float
) -> Walker:
    (x, y, _), (vx, vy, _), (ox, oy) = actor.p_W_m.tolist(), actor.v_W_mps.tolist(), offset
    x, y = (x - ox, y - oy) if shifted else (x, y)
    return Walker(
        id=actor.id,
        x=x,
        y=y,
        cos=math.cos(actor.yaw_rad),
        sin=math.sin(actor.yaw_rad),
        speed_mps=math.hypot(vx, vy),
        radius_m=0.5 * max(actor.size_lwh_m[:2]),
        p_W_m=actor.p_W_m,
        ox=ox,
        oy=oy,
        chair_m=chair_m,
    )


def _is_beside(actor: ActorState, places: Sequence[tuple[float, float]]) -> bool:
    """Whether this person is near to one of these places."""
    x, y, _ = actor.p_W_m.tolist()
    return any(abs(x - px) + abs(y - py) < 2.0 * PEOPLE_AHEAD_M for px, py in places)


def vehicles_near(actors: Sequence[ActorState], crowd: Sequence[Walker]) -> list[Vehicle]:
    """The vehicles near to anybody in the crowd, each with how far around it people mind it."""
    found = []
    places = [walker.at for walker in crowd]
    for actor in actors:
        if actor.is_person:
            continue
        x, y, _ = actor.p_W_m.tolist()
        reach_m = actor.size_lwh_m[0] + _NEAR_VEHICLE_M
        vx, vy, _ = actor.v_W_mps.tolist()
        wide_m = reach_m + _MOVES_M + SWEEP_S * (abs(vx) + abs(vy))
        if not any([abs(x - wx) + abs(y - wy) < wide_m for wx, wy in places]):
            continue
        speed_mps = math.hypot(vx, vy)
        # What it covers until it has driven on for a while.
        box = x, y, cos, sin, long_m, half_wide_m = box_from_actor(actor)
        half_m = 0.5 * SWEEP_S * speed_mps
        sweep = x + half_m * cos, y + half_m * sin, cos, sin, long_m + half_m, half_wide_m
        is_moving = speed_mps > _MOVING_MPS
        found.append(Vehicle(reach_m=reach_m + 2.0 * half_m, box=box, sweep=sweep, moves=is_moving))
    return found


def near(vehicles: Sequence[Vehicle], x: float, y: float) -> list[Vehicle]:
    """Those of the vehicles that somebody at (x, y) minds."""
    return [v for v in vehicles if abs(v.box[0] - x) + abs(v.box[1] - y) < v.reach_m]
