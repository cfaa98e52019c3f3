"""What the user notices of the street: a look is not enough, and what was missed once stays missed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.core.frames import rad, wrap
from wcsim.types import ActorKind, ActorState, UserView
from wcsim.users.crossing import MOVING_MPS, RIDERS
from wcsim.users.profiles import UserProfile

_HALF_VIEW_RAD = rad(80.0)
PERSON_SIGHT, VEHICLE_SIGHT = (
    1.5,
    7.0,
)  # they are noticed from this many times farther away than a post
RIDER_SIGHT = 4.0  # of who rides a bicycle or scooter, as traffic: 24 m are 3 s at 8 m/s
_KEPT_SIGHT = 1.5  # what was noticed is known of until it is this many times as far away
_AROUND_M = 25.0  # what is farther away is watched, but nothing yet to go around or to stop behind
_FORGET_S = 10.0
LONGEST_AWAY = 2.0  # times the mean
UNCUT_AWAY = 1.255  # mean of a look elsewhere that is not cut off, so that one that is has the profile's mean
_SLOW_KINDS = RIDERS | {ActorKind.PEDESTRIAN, ActorKind.WHEELCHAIR}


@dataclass(frozen=True, slots=True, kw_only=True)
class NoticedObject:
    """A round thing in the way, standing or moving; a long box becomes a row of them."""

    x_m: float
    y_m: float
    radius_m: float
    vx_mps: float = 0.0
    vy_mps: float = 0.0

    @property
    def moving(self) -> bool:
        """Whether it moves at more than a creep."""
        return math.hypot(self.vx_mps, self.vy_mps) > 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What the user is aware of now."""

    things: tuple[NoticedObject, ...]  # to go around, or to stop behind
    vehicles: tuple[ActorState, ...]  # that one may have to wait for before a road, riders too


class Perception:
    """Attention and the memory of what was noticed."""

    def __init__(self, profile: UserProfile, rng: np.random.Generator) -> None:
        self._profile = profile
        self._rng = rng
        self._noticed: dict[
            str, tuple[bool, float]
        ] = {}  # key -> noticed or missed, last time in sight
        self.attentive = True
        self._away_s = 0.0
        self._leaves = False

    def attend(self, dt_s: float, calm: bool = True, heeds: bool = False) -> bool:
        """Advance the two-state Markov chain of attention; whether the user looks at the street.

        A look elsewhere waits until the driving is `calm` (nobody looks away in the middle of a turn) and is at most
        twice as long as its mean. Who `heeds` something ahead, a light, looks at the street.
        """
        p = self._profile
        if p.away_share <= 0.0 or dt_s <= 0.0:
            return self.attentive
        per_s = (
            p.away_share / (1.0 - p.away_share) / p.away_s
            if self.attentive
            else 1.0 / (UNCUT_AWAY * p.away_s)
        )
        changes = bool(self._rng.random() < 1.0 - math.exp(-dt_s * per_s))
        if self.attentive:
            self._leaves = self._leaves or changes
            if self._leaves and calm and not heeds:
                self.attentive, self._leaves, self._away_s = False, False, 0.0
        else:
            self._away_s += dt_s
            self.attentive = changes or heeds or self._away_s >= LONGEST_AWAY * p.away_s - 1e-9
        return self.attentive

    def look(self, view: UserView) -> Seen:
        """Everything noticed by now that is still near."""
        things = [NoticedObject(x_m=x, y_m=y, radius_m=r) for x, y, r in self._obstacles(view)]
        vehicles = []
        x_m, y_m, _ = view.p_W_m.tolist()
        for actor in view.actors:
            half_m, see_m = 0.5 * actor.size_lwh_m[0], self._profile.see_m
            x, y, _ = actor.p_W_m.tolist()
            gap_m = math.hypot(x - x_m, y - y_m)
            if gap_m > _KEPT_SIGHT * (half_m + see_m * VEHICLE_SIGHT):
                continue  # nearly everybody in a town, so before anything that costs
            slow, rides = actor.kind in _SLOW_KINDS, _rides(actor)
            reach_m = half_m + see_m * (PERSON_SIGHT if slow else VEHICLE_SIGHT)
            rider_m = half_m + see_m * RIDER_SIGHT
            if gap_m > _KEPT_SIGHT * (rider_m if rides else reach_m):
                continue
            # A rider is looked at twice, as one to go around and as traffic, and is noticed or missed as both.
            near, road = f"a{actor.id}", f"r{actor.id}"
            known = self._notices(near, x, y, reach_m, view, everywhere=not slow, twin=road)
            if known and gap_m < _AROUND_M:
                things.extend(discs(actor))
            if (known and not slow) or (
                rides and self._notices(road, x, y, rider_m, view, everywhere=True, twin=near)
            ):
                vehicles.append(actor)
        self._forget(view.time_s)
        return Seen(things=tuple(things), vehicles=tuple(vehicles))

    def _obstacles(self, view: UserView) -> list[tuple[float, float, float]]:
        noticed = []
        for x, y, r, thing in view.obstacles_W_m.tolist():
            if self._notices(f"o{int(thing)}", x, y, self._profile.see_m + r, view):
                noticed.append((x, y, r))
        return noticed

    def _notices(
        self,
        key: str,
        x_m: float,
        y_m: float,
        reach_m: float,
        view: UserView,
        everywhere: bool = False,
        twin: str = "",
    ) -> bool:
        """Whether something is noticed; `everywhere` for traffic, which one hears, and turns one's head for.

        What its `twin` was, noticed or missed, it is too.
        """
        dx, dy = x_m - float(view.p_W_m[0]), y_m - float(view.p_W_m[1])
        distance = math.hypot(dx, dy)
        if distance > _KEPT_SIGHT * reach_m:
            return False
        known = self._noticed.get(key)
        if known is None:
            ahead = abs(wrap(math.atan2(dy, dx) - view.yaw_rad)) <= _HALF_VIEW_RAD
            if distance > reach_m or not (everywhere or ahead or distance < 1.0):
                return False
            known = self._noticed.get(twin) or (
                bool(self._rng.random() < self._profile.see_share),
                view.time_s,
            )
        self._noticed[key] = (known[0], view.time_s)
        return known[0]

    def _forget(self, time_s: float) -> None:
        if len(self._noticed) > 256:
            self._noticed = {k: v for k, v in self._noticed.items() if time_s - v[1] < _FORGET_S}


def _rides(actor: ActorState) -> bool:
    vx, vy, _ = actor.v_W_mps.tolist()
    return actor.kind in RIDERS and math.hypot(vx, vy) >= MOVING_MPS


def discs(actor: ActorState) -> list[NoticedObject]:
    """A box seen from above as a row of discs of its width."""
    length, width, _ = actor.size_lwh_m
    radius = 0.5 * min(length, width)
    count = max(1, math.ceil(max(length, width) / (2.0 * radius)))
    reach = 0.5 * max(length, width) - radius
    yaw = actor.yaw_rad if length >= width else actor.yaw_rad + 0.5 * math.pi
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y, _ = actor.p_W_m.tolist()
    vx, vy, _ = actor.v_W_mps.tolist()
    offsets = [reach * (2.0 * k / (count - 1) - 1.0) for k in range(count)] if count > 1 else [0.0]
    return [
        NoticedObject(x_m=x + o * cos, y_m=y + o * sin, radius_m=radius, vx_mps=vx, vy_mps=vy)
        for o in offsets
    ]
