"""What the user detects of the street: a look is not enough, and what was missed stays missed."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.core.frames import deg2rad, wrap_angle
from wcsim.types import ActorKind, ActorState, UserView
from wcsim.users.crossing import MOVING_MPS, RIDERS
from wcsim.users.profiles import UserProfile

_HALF_VIEW_RAD: Final = deg2rad(80.0)
_BESIDE_M: Final = 1.0  # so near, things are detected without being looked at
# Actors are detected from so many times farther away than a post.
PERSON_SIGHT: Final = 1.5
_VEHICLE_SIGHT: Final = 7.0
_RIDER_SIGHT: Final = 4.0  # of moving bicycles and scooters as traffic: 24 m are 3 s at 8 m/s
# What was detected is known of until it is this many times as far away.
_MEMORY_SIGHT: Final = 1.5
FARTHEST_SIGHT: Final = _MEMORY_SIGHT * _VEHICLE_SIGHT
"""From that many times `see_m` a user may know of the middle of anything, its length besides."""
_AROUND_M: Final = 25.0  # farther away is nothing yet to go around or to stop behind
_FORGET_S: Final = 10.0
_MOST_REMEMBERED: Final = 256
LONGEST_AWAY: Final = 2.0  # times the mean
# The mean of a look elsewhere that is not cut off, so that one that is cut has the profile's mean.
UNCUT_AWAY: Final = 1.255
_SLOW_KINDS: Final = RIDERS | {ActorKind.PEDESTRIAN, ActorKind.WHEELCHAIR}
_CREEP_MPS: Final = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedObject:
    """A round thing in the way, standing or moving; a long box becomes a row of them."""

    x_m: float
    y_m: float
    radius_m: float
    vx_mps: float = 0.0
    vy_mps: float = 0.0

    @property
    def moving(self) -> bool:
        """Whether it moves at more than a creep."""
        return math.hypot(self.vx_mps, self.vy_mps) > _CREEP_MPS


@dataclass(frozen=True, slots=True, kw_only=True)
class PerceivedObjects:
    """What the user is aware of now."""

    things: tuple[DetectedObject, ...]  # to go around, or to stop behind
    vehicles: tuple[ActorState, ...]  # that one may have to wait for before a road, riders too


class UserPerception:
    """Attention, and the memory of what was detected."""

    def __init__(self, profile: UserProfile, rng: np.random.Generator) -> None:
        self._profile = profile
        self._rng = rng
        # By key: whether it was detected or missed, and when it was last in sight.
        self._memory: dict[str, tuple[bool, float]] = {}
        self.attentive = True
        self._away_s = 0.0
        self._leaves = False

    def step_attention(self, dt_s: float, calm: bool = True, heeds: bool = False) -> bool:
        """Advance the two-state Markov chain of attention; whether the user looks at the street.

        A look elsewhere waits until the driving is `calm`, not in the middle of a turn. It is at
        most twice as long as its mean. A user that `heeds` a light ahead looks at the street.
        """
        p = self._profile
        if p.away_share <= 0.0 or dt_s <= 0.0:
            return self.attentive
        if self.attentive:
            per_s = p.away_share / (1.0 - p.away_share) / p.away_s
        else:
            per_s = 1.0 / (UNCUT_AWAY * p.away_s)
        changes = bool(self._rng.random() < 1.0 - math.exp(-dt_s * per_s))
        if self.attentive:
            self._leaves = self._leaves or changes
            if self._leaves and calm and not heeds:
                self.attentive = False
                self._leaves = False
                self._away_s = 0.0
        else:
            self._away_s += dt_s
            self.attentive = changes or heeds or self._away_s >= LONGEST_AWAY * p.away_s - 1e-9
        return self.attentive

    def update(self, view: UserView) -> PerceivedObjects:
        """Look at the street: draw what is detected, and return what is known and still near."""
        see_m = self._profile.see_m
        things = [
            DetectedObject(x_m=x, y_m=y, radius_m=radius_m)
            for x, y, radius_m, number in view.obstacles_W_m.tolist()
            if self._recall_or_draw(f"o{int(number)}", x, y, see_m + radius_m, view)
        ]
        vehicles = []
        x_m, y_m, _ = view.p_W_m.tolist()
        for actor in view.actors:
            half_m = 0.5 * actor.size_lwh_m[0]
            x, y, _ = actor.p_W_m.tolist()
            gap_m = math.hypot(x - x_m, y - y_m)
            # Nearly all actors of a town are farther, so this test stands before costly ones.
            if gap_m > _MEMORY_SIGHT * (half_m + see_m * _VEHICLE_SIGHT):
                continue
            slow, rides = actor.kind in _SLOW_KINDS, _is_riding(actor)
            reach_m = half_m + see_m * (PERSON_SIGHT if slow else _VEHICLE_SIGHT)
            rider_m = half_m + see_m * _RIDER_SIGHT
            if gap_m > _MEMORY_SIGHT * (rider_m if rides else reach_m):
                continue
            # A rider is looked at twice, as one to go around and as traffic, and is detected or
            # missed as both.
            near, road = f"a{actor.id}", f"r{actor.id}"
            known = self._recall_or_draw(near, x, y, reach_m, view, not slow, road)
            if known and gap_m < _AROUND_M:
                things.extend(actor_to_discs(actor))
            if (known and not slow) or (
                rides and self._recall_or_draw(road, x, y, rider_m, view, True, near)
            ):
                vehicles.append(actor)
        if len(self._memory) > _MOST_REMEMBERED:
            self._memory = {k: v for k, v in self._memory.items() if view.time_s - v[1] < _FORGET_S}
        return PerceivedObjects(things=tuple(things), vehicles=tuple(vehicles))

    def _recall_or_draw(
        self,
        key: str,
        x_m: float,
        y_m: float,
        reach_m: float,
        view: UserView,
        everywhere: bool = False,
        same_as: str = "",
    ) -> bool:
        """Whether something is detected: drawn once it is in reach, then remembered.

        Traffic is heard, and the user turns its head for it: it is in sight `everywhere`. What is
        `same_as` something else was detected or missed as that was.
        """
        dx_m, dy_m = x_m - float(view.p_W_m[0]), y_m - float(view.p_W_m[1])
        distance_m = math.hypot(dx_m, dy_m)
        if distance_m > _MEMORY_SIGHT * reach_m:
            return False
        known = self._memory.get(key)
        if known is None:
            ahead = abs(wrap_angle(math.atan2(dy_m, dx_m) - view.yaw_rad)) <= _HALF_VIEW_RAD
            in_sight = everywhere or ahead or distance_m < _BESIDE_M
            if distance_m > reach_m or not in_sight:
                return False
            known = self._memory.get(same_as)
        if known is None:
            known = (bool(self._rng.random() < self._profile.see_share), view.time_s)
        self._memory[key] = (known[0], view.time_s)
        return known[0]


def actor_to_discs(actor: ActorState) -> list[DetectedObject]:
    """A box seen from above as a row of discs of its width."""
    length_m, width_m, _ = actor.size_lwh_m
    short_m, long_m = min(length_m, width_m), max(length_m, width_m)
    radius_m = 0.5 * short_m
    count = max(1, math.ceil(long_m / (2.0 * radius_m)))
    reach_m = 0.5 * long_m - radius_m
    yaw_rad = actor.yaw_rad if length_m >= width_m else actor.yaw_rad + 0.5 * math.pi
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    x_m, y_m, _ = actor.p_W_m.tolist()
    vx_mps, vy_mps, _ = actor.v_W_mps.tolist()
    offsets_m = [0.0]
    if count > 1:
        offsets_m = [reach_m * (2.0 * k / (count - 1) - 1.0) for k in range(count)]
    return [
        DetectedObject(
            x_m=x_m + offset_m * cos,
            y_m=y_m + offset_m * sin,
            radius_m=radius_m,
            vx_mps=vx_mps,
            vy_mps=vy_mps,
        )
        for offset_m in offsets_m
    ]


def _is_riding(actor: ActorState) -> bool:
    vx, vy, _ = actor.v_W_mps.tolist()
    return actor.kind in RIDERS and math.hypot(vx, vy) >= MOVING_MPS
