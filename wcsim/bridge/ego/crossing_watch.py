"""A wheelchair at its crossings: on the road, over it, out at red, and at the button.

What it does on a carriageway is the world's truth, for KPIs. A chair that stands before a red light
of its route for some time requests green. Whoever drives the chair, the person in it can press:
what counts is where the chair stands and where its route goes.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wcsim.bridge.reaction.commands import ROADWAY, GreenRequest
from wcsim.config import WorldConfig
from wcsim.types import (
    F64,
    ActorState,
    Bool,
    Ground,
    Route,
    SignalState,
    Street,
    WalkGraph,
    WayKind,
)
from wcsim.users.crossing import RouteCrossing, find_kerb_arc_m, find_route_crossings, is_red
from wcsim.users.route_line import RoutePolyline

_BESIDE_M = 1.0  # so far beside the painted strip a chair is still on the crossing
BEFORE_M = 1.0  # and so far before its ends
# Who gets onto the road beyond this share of a crossing came in from somewhere else.
_ENTRY_SHARE = 0.35
_OVER_SHARE = 0.8  # who leaves the road beyond this share of it has got over
_AGAIN_S = 1.0  # a footplate that was behind the kerb for so long passes it anew
# A middle so far beyond a crossing's end has set out: one with a footplate over the kerb waits.
SET_OUT_M = 0.5
# And heads along it, within 60 degrees: a corner touches the crossings of two streets.
_ALONG_COS = 0.5

_STANDS_MPS = 0.1
_PRESS_AFTER_S = 2.0  # of standing at red
# Where the footplate is at a button: before the road's edge, and beyond the crossing's start, as
# who rolled over the line at red waits there.
_BEFORE_M = 1.0
_BEYOND_M = 1.9


@dataclass(frozen=True, slots=True, kw_only=True)
class OnRoad:
    """One moment of a chair."""

    on_carriageway: bool = False  # its middle
    # In from one pavement, out on the opposite one, over a crossing all the way.
    crossed: bool = False
    # It sets out over a crossing that had red as its footplate passed the kerb line.
    entered_red: bool = False


class CrossingWatch:
    """One chair in one episode; needs every tick of it."""

    def __init__(self, ground: Ground, walk: WalkGraph) -> None:
        """The kerb line is where `ground` is a carriageway; crossings are straight strips."""
        self._ground = ground
        self._edges = [edge for edge in walk.edges if edge.kind is WayKind.CROSSING]
        ends = [(edge.points_W_m[0], edge.points_W_m[-1]) for edge in self._edges]
        ends_m = np.array(ends).reshape(-1, 2, 2)
        along_m = ends_m[:, 1] - ends_m[:, 0]
        self._from_m = ends_m[:, 0]
        self._length_m = np.maximum(np.hypot(along_m[:, 0], along_m[:, 1]), 1e-9)
        self._unit = along_m / self._length_m[:, None]
        self._reach_m = np.array([0.5 * edge.width_m + _BESIDE_M for edge in self._edges])
        # Crossing, and whether from its last point.
        self._entered: tuple[tuple[int, bool], ...] = ()
        self._on_road: bool | None = None
        self._foot_on_road: bool | None = None
        self._foot_behind_s = -math.inf  # since when the footplate has been behind the kerb
        # Kerbs it came over: whether of the last point, and at red.
        self._passed: dict[int, tuple[bool, bool]] = {}

    def see(self, chair: ActorState, time_s: float, signals: Iterable[SignalState]) -> OnRoad:
        """Take the next tick: the chair's box, SUMO's time, the signals of now."""
        x, y, _ = chair.p_W_m.tolist()
        half_m = 0.5 * chair.size_lwh_m[0]
        foot_m = x + half_m * math.cos(chair.yaw_rad), y + half_m * math.sin(chair.yaw_rad)
        on_road = self._ground.class_here(x, y) in ROADWAY
        return OnRoad(
            on_carriageway=on_road,
            crossed=self._gets_over(x, y, on_road),
            entered_red=self._enters_red((x, y), foot_m, time_s, signals),
        )

    def _gets_over(self, x_m: float, y_m: float, on_road: bool) -> bool:
        """Whether the road ends here, on the far side of the crossing that the chair came over."""
        before, self._on_road = self._on_road, on_road
        # In most ticks nothing can begin or end, and no places are looked up.
        if not self._entered and not (on_road and before is False):
            return False
        share, inside = self._places(x_m, y_m)
        if not on_road:
            entered, self._entered = self._entered, ()
            return bool(inside.any()) and any(
                _from(float(share[k]), last) >= _OVER_SHARE for k, last in entered
            )
        if before is False:
            at_first = np.flatnonzero(inside & (share <= _ENTRY_SHARE))
            at_last = np.flatnonzero(inside & (share >= 1.0 - _ENTRY_SHARE))
            self._entered = (
                *((int(k), False) for k in at_first),
                *((int(k), True) for k in at_last),
            )
        elif not inside.any():
            # It left the strip on the road, so it does not come over by this crossing.
            self._entered = ()
        return False

    def _enters_red(
        self,
        middle_m: tuple[float, float],
        foot_m: tuple[float, float],
        time_s: float,
        signals: Iterable[SignalState],
    ) -> bool:
        """Whether the chair sets out now, over a kerb line that its footplate passed at red."""
        before, since_s = self._foot_on_road, self._foot_behind_s
        self._foot_on_road = self._ground.class_here(*foot_m) in ROADWAY
        if not self._foot_on_road:
            self._foot_behind_s = time_s if before else since_s
            return False
        # One that rocks over the kerb line passes it once. Times are sums of ticks, hence the hair.
        if before is False and time_s - since_s > _AGAIN_S - 1e-6:
            share, inside = self._places(*foot_m)
            there = np.flatnonzero(inside & (np.minimum(share, 1.0 - share) <= _ENTRY_SHARE))
            self._passed = {
                int(k): (bool(share[k] > 0.5), is_red(self._edges[k], signals)) for k in there
            }
        if not self._passed:
            return False
        ahead = np.array(foot_m) - middle_m
        ahead /= np.linalg.norm(ahead)
        share, inside = self._places(*middle_m)
        for k, (last, red) in self._passed.items():
            out_m = _from(float(share[k]), last) * self._length_m[k]
            along = float(self._unit[k] @ ahead) * (-1.0 if last else 1.0)
            if inside[k] and out_m >= SET_OUT_M and along >= _ALONG_COS:
                self._passed = {}
                # Who waited with the footplate out may have set out at green.
                return red and is_red(self._edges[k], signals)
        return False

    def _places(self, x_m: float, y_m: float) -> tuple[F64, Bool]:
        """How far along each crossing (C,) a point is, as a share, and whether it is on it (C,)."""
        off_m = np.array([x_m, y_m]) - self._from_m
        along_m = np.sum(off_m * self._unit, axis=1)
        left_m = self._unit[:, 0] * off_m[:, 1] - self._unit[:, 1] * off_m[:, 0]
        inside = (along_m >= -BEFORE_M) & (along_m <= self._length_m + BEFORE_M)
        return along_m / self._length_m, inside & (np.abs(left_m) <= self._reach_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reach:
    """A crossing with a light, and the part of the route where the chair is at its button."""

    crossing: RouteCrossing
    from_m: float
    to_m: float


class CrossingButton:
    """The buttons on one route, and the one that its chair has pressed; needs every tick."""

    def __init__(
        self, route: Route, street: Street, half_length_m: float, world: WorldConfig
    ) -> None:
        """`half_length_m` is the chair's; `world` says whether it presses."""
        path = RoutePolyline(route)
        self._items = tuple(
            _Reach(
                crossing=item,
                from_m=find_kerb_arc_m(street.grid, path, item.start_m) - _BEFORE_M - half_length_m,
                to_m=min(item.start_m + _BEYOND_M, item.end_m) - half_length_m,
            )
            for item in find_route_crossings(route, street.walk)
            if world.button and item.tls_id
        )
        self._at: RouteCrossing | None = None
        self._since_s = 0.0
        self._pressed = False

    def see(
        self, arc_m: float, speed_mps: float, time_s: float, signals: Iterable[SignalState]
    ) -> GreenRequest | None:
        """What the chair requests, from the press until the light is green or the chair has left.

        Args:
            arc_m: Of the chair's middle on the route.
            speed_mps: Of the chair, ahead.
            time_s: Now.
            signals: The lights near the chair.
        """
        red = (reach.crossing for reach in self._items if reach.from_m <= arc_m <= reach.to_m)
        here = next((crossing for crossing in red if is_red(crossing, signals)), None)
        if here is None or here is not self._at:
            self._at, self._since_s, self._pressed = here, time_s, False
        if here is None:
            return None
        # Who still rolls does not wait yet.
        if not self._pressed and abs(speed_mps) > _STANDS_MPS:
            self._since_s = time_s
        # Times are sums of ticks: without the hair rounding could put the press off by a tick.
        self._pressed = self._pressed or time_s - self._since_s >= _PRESS_AFTER_S - 1e-6
        return GreenRequest(tls_id=here.tls_id, links=here.tls_links) if self._pressed else None


def _from(share: float, last: bool) -> float:
    """A share of a crossing, counted from the end at which the chair came in."""
    return 1.0 - share if last else share
