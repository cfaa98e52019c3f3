"""Crossing a road: where the route does it, whether the light allows it, whether a vehicle comes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wcsim.types import (
    F64,
    ActorKind,
    ActorState,
    ClassId,
    Ground,
    Route,
    SignalState,
    WalkEdge,
    WalkGraph,
    WayKind,
)
from wcsim.users.route_line import Path

GAP_S = 3.0  # a vehicle that comes nearer than this in time is waited for
START_S, _CROSSING_MPS = 1.5, 1.1  # how a chair at the kerb gets over the road
_SIDE_M = 1.2  # added to half the vehicle's width: how near it must come to count
MOVING_MPS = 0.5
RIDERS = frozenset({ActorKind.BICYCLE, ActorKind.SCOOTER})
_ALONG = math.cos(
    0.25 * math.pi
)  # who rides more nearly than this as a crossing leads uses it, or rides beside it
KERB_GAP_M = 0.3  # left between footplate and road while waiting
_LIGHT_SEEN_M, _TRAFFIC_SEEN_M = 8.0, 3.0  # before the kerb, where the user looks for them
_GREEN_SEEN_M = (
    25.0  # who is farther from a crossing that has green has red, and still brakes for it
)
_ALONG_KERB_M, _ROAD_STEP_M = 3.0, 0.25
_NEAR_ROAD_M = 0.8  # who waits so near to the road may have the footplate over it when turning
RING = tuple((math.cos(0.25 * math.pi * k), math.sin(0.25 * math.pi * k)) for k in range(8))
CARRIAGEWAY = (ClassId.ROAD, ClassId.CROSSWALK)
_SHORT_GREEN_S = 5.0  # a green for people on foot may end so soon, and many do
_SPARE_S, _ONWARD_MPS = (
    0.5,
    0.7,
)  # who, driving so fast, may not get to the kerb that much earlier does not go for it
EDGE_M, _EDGE_STEP_M = (
    1.2,
    0.1,
)  # so far before the crossing's own beginning a kerb that runs aslant may lie
_LOOK_M = (
    2.5  # of the footplate before the kerb: who obeys a light does not look elsewhere from there on
)
_HALF_LANE_M = (
    1.6  # who comes to rest with the footplate less far into the road than this waits there
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """A stretch of the route over a road."""

    start_m: float  # arc on the route
    end_m: float
    start_W_m: tuple[float, float]
    end_W_m: tuple[float, float]
    tls_id: str
    tls_links: tuple[int, ...]


class Kerbs:
    """The crossings of one route as its user comes to them, and the kerbs at which it waits."""

    def __init__(
        self,
        items: Sequence[Crossing],
        path: Path,
        ground: Ground | None,
        law_share: float,
        rng: np.random.Generator,
        half_length_m: float,
    ) -> None:
        """The crossings of a route in order, the street, the chance that the user keeps to the law, and the chair."""
        starts = [
            item.start_m if ground is None else kerb_m(ground, path, item.start_m) for item in items
        ]
        self._ground, self._half_length_m = ground, half_length_m
        self._waits_m = half_length_m + KERB_GAP_M  # from the middle of who waits to the kerb
        self._items = tuple(
            zip(items, (start_m - self._waits_m for start_m in starts), strict=True)
        )
        self._kerb_m = {
            item: item.start_m if ground is None else _edge_m(ground, path, item.start_m)
            for item in items
        }
        # Drawn here for all: so a crossing's draw does not depend on when, or after which others, its user comes to it.
        self._lawful = dict(zip(items, (rng.random(len(items)) < law_share).tolist(), strict=True))
        self._obeys: dict[Crossing, bool] = {}
        self._red_last_s: dict[Crossing, float] = {}
        self._green_since_s: dict[Crossing, float] = {}
        self._hesitates: set[Crossing] = set()
        self._begun: set[Crossing] = set()

    @property
    def obeys(self) -> Mapping[Crossing, bool]:
        """The crossings that the user has come to, and whether it keeps to the law there."""
        return self._obeys

    def stop_m(
        self,
        arc_m: float,
        time_s: float,
        signals: Iterable[SignalState],
        vehicles: Iterable[ActorState],
    ) -> float | None:
        """Arc where the chair's middle must stop because of a light or a vehicle; None when the way is free.

        Args:
            arc_m: Of the chair's middle now, not where it will be when the hand answers: who brakes late rolls on until
                there, and must not take that for having begun to cross.
            time_s: Now.
            signals: The lights near the chair.
            vehicles: Those that the user knows of.
        """
        behind_m = -math.inf
        for item, stop_m in self._items:
            line_m = item.start_m - self._waits_m
            island = (
                line_m > behind_m + self._half_length_m
            )  # too short a refuge is no place to wait
            stop_m, behind_m = max(stop_m, behind_m + self._half_length_m), item.end_m
            to_go_m = line_m - arc_m
            back_m = KERB_GAP_M + min(_HALF_LANE_M, 0.5 * (item.end_m - item.start_m))
            if (
                not -back_m < to_go_m < _LIGHT_SEEN_M
                or not island
                or item in self._begun
                or not self._keeps_law(item)
            ):
                continue
            if self._closed(item, to_go_m, time_s, signals, vehicles):
                return stop_m
            if self._may_end(item, self._kerb_m[item] - self._half_length_m - arc_m, time_s):
                return (
                    self._kerb_m[item] - self._waits_m
                )  # the next green is met nearer to the kerb than this one
            if to_go_m < -KERB_GAP_M:
                self._begun.add(item)
        return None

    def heeds_light(self, arc_m: float) -> bool:
        """Whether a light that the user obeys is so near that a red one must be answered at once."""
        before_m = arc_m + self._half_length_m
        return any(
            item.tls_id
            and item not in self._begun
            and -KERB_GAP_M < self._kerb_m[item] - before_m < _LOOK_M
            and self._keeps_law(item)
            for item, _ in self._items
        )

    def _may_end(self, item: Crossing, to_kerb_m: float, time_s: float) -> bool:
        """Whether a green that came after a red one may be over before the footplate is at the kerb."""
        if item not in self._green_since_s or to_kerb_m <= (
            0.0 if item in self._hesitates else KERB_GAP_M
        ):
            return False
        longest_s, shortest_s = time_s - self._red_last_s[item], time_s - self._green_since_s[item]
        if longest_s + to_kerb_m / _ONWARD_MPS > _SHORT_GREEN_S - _SPARE_S:
            self._hesitates.add(item)  # who has slowed down for it cannot make it any more
        return item in self._hesitates and shortest_s < _SHORT_GREEN_S + _SPARE_S

    def _keeps_law(self, item: Crossing) -> bool:
        return self._obeys.setdefault(item, self._lawful[item])

    def _closed(
        self,
        item: Crossing,
        to_go_m: float,
        time_s: float,
        signals: Iterable[SignalState],
        vehicles: Iterable[ActorState],
    ) -> bool:
        near = to_go_m < _TRAFFIC_SEEN_M
        if is_red(item, signals):
            self._red_last_s[item] = time_s
            self._green_since_s.pop(item, None)
            self._hesitates.discard(item)
            return True
        if item in self._red_last_s:
            self._green_since_s.setdefault(item, time_s)
        lit = _has_light(item, signals)
        watched = near and (item in self._red_last_s or not lit)
        if not watched:
            return False
        traffic = [vehicle for vehicle in vehicles if _is_traffic(item, vehicle, self._ground)]
        return _vehicle_comes(item, _near_kerb(item, traffic) if lit else traffic)


def _near_kerb(item: Crossing, vehicles: Iterable[ActorState]) -> list[ActorState]:
    """Those so near to where a crossing begins that they count at green."""
    return [v for v in vehicles if math.dist(v.p_W_m[:2].tolist(), item.start_W_m) < _GREEN_SEEN_M]


def crossings(route: Route, walk: WalkGraph) -> tuple[Crossing, ...]:
    """The crossings on a route, in order; pieces of one crossing edge are one crossing."""
    found: list[Crossing] = []
    index = route.edge_index.tolist()
    arc = route.arc_m.tolist()
    points = [(float(x), float(y)) for x, y in route.points_W_m[:, :2].tolist()]
    i = 0
    while i < len(index) - 1:
        edge = walk.edges[index[i]]
        j = i + 1
        while j < len(index) - 1 and index[j] == index[i]:
            j += 1
        if edge.kind is WayKind.CROSSING and arc[j] > arc[i]:
            found.append(
                Crossing(
                    start_m=arc[i],
                    end_m=arc[j],
                    start_W_m=points[i],
                    end_W_m=points[j],
                    tls_id=edge.tls_id,
                    tls_links=edge.tls_links,
                )
            )
        i = j
    return tuple(found)


def kerb_m(ground: Ground, path: Path, start_m: float) -> float:
    """Arc where a route to a crossing comes near to the road: at its start, or before it on a way along the kerb."""
    for step in range(round(_ALONG_KERB_M / _ROAD_STEP_M), 0, -1):
        x, y = path.at(start_m - step * _ROAD_STEP_M)
        around = ((x + _NEAR_ROAD_M * cos, y + _NEAR_ROAD_M * sin) for cos, sin in RING)
        on_pavement = ground.class_here(x, y) not in CARRIAGEWAY
        if on_pavement and any(ground.class_here(*at) in CARRIAGEWAY for at in around):
            return start_m - step * _ROAD_STEP_M
    return start_m


def _edge_m(ground: Ground, path: Path, start_m: float) -> float:
    """Arc where a route to a crossing gets onto the road: at its start, or before it where the kerb runs aslant."""
    for step in range(round(EDGE_M / _EDGE_STEP_M), 0, -1):
        if ground.class_here(*path.at(start_m - step * _EDGE_STEP_M)) in CARRIAGEWAY:
            return start_m - step * _EDGE_STEP_M
    return start_m


def is_red(crossing: Crossing | WalkEdge, signals: Iterable[SignalState]) -> bool:
    """Whether the pedestrian signal forbids to start; without a signal, or with it switched off, it never does."""
    for signal in signals:
        if signal.tls_id == crossing.tls_id and crossing.tls_id:
            return not signal.frees(crossing.tls_links)
    return False


def _has_light(crossing: Crossing, signals: Iterable[SignalState]) -> bool:
    """Whether a signal that is switched on governs the crossing."""
    for signal in signals:
        if signal.tls_id == crossing.tls_id and crossing.tls_id:
            return any(
                signal.colours[i] in "rRyYuGg"
                for i in crossing.tls_links
                if i < len(signal.colours)
            )
    return False


def _is_traffic(crossing: Crossing, vehicle: ActorState, ground: Ground | None) -> bool:
    """Whether a vehicle drives on the road that is crossed.

    A rider need not: one on the pavement passes the kerb without end where many ride, and one who uses the crossing
    too goes where the chair goes. Without a ground every rider counts for one on the road.
    """
    if vehicle.kind not in RIDERS:
        return True
    (x, y, _), (vx, vy, _) = vehicle.p_W_m.tolist(), vehicle.v_W_mps.tolist()
    if ground is not None and ground.class_here(x, y) not in CARRIAGEWAY:
        return False
    to_x, to_y = (
        end - start for start, end in zip(crossing.start_W_m, crossing.end_W_m, strict=True)
    )
    return bool(abs(vx * to_x + vy * to_y) <= _ALONG * math.hypot(vx, vy) * math.hypot(to_x, to_y))


def _vehicle_comes(crossing: Crossing, vehicles: Iterable[ActorState]) -> bool:
    """Whether a vehicle, driving on as it does, comes too near to a chair that starts to cross now.

    Too near: it is somewhere on the crossing within the next `GAP_S` seconds, or within `GAP_S` of the moment at which
    the chair gets to that place.
    """
    length_m = math.dist(crossing.start_W_m, crossing.end_W_m)
    needed_s = START_S + length_m / _CROSSING_MPS
    later_s = np.arange(0.0, needed_s + GAP_S, 0.25)  # (T,)
    for vehicle in vehicles:
        v: F64 = vehicle.v_W_mps[:2]
        speed = float(np.hypot(v[0], v[1]))
        if speed < MOVING_MPS or _passes_wide(vehicle, speed, crossing, 0.5 * length_m):
            continue
        ends_m = (
            0.5 * vehicle.size_lwh_m[0] / speed * np.array([-1.0, 0.0, 1.0])[:, None] * v
        )  # tail, middle, nose
        points = vehicle.p_W_m[:2] + later_s[:, None, None] * v + ends_m  # (T, 3, 2)
        share, distance_m = _beside(
            points, np.array(crossing.start_W_m), np.array(crossing.end_W_m)
        )
        there_s = START_S + share * length_m / _CROSSING_MPS
        when_s = np.broadcast_to(later_s[:, None], share.shape)
        close = (when_s < GAP_S) | (np.abs(when_s - there_s) < GAP_S)
        if (close & (distance_m < 0.5 * vehicle.size_lwh_m[1] + _SIDE_M)).any():
            return True
    return False


def _passes_wide(vehicle: ActorState, speed_mps: float, crossing: Crossing, half_m: float) -> bool:
    """Whether a vehicle's straight way leads past a crossing, or has left it: so of most in sight, and cheap to say."""
    (x, y, _), (vx, vy, _) = vehicle.p_W_m.tolist(), vehicle.v_W_mps.tolist()
    to_x = 0.5 * (crossing.start_W_m[0] + crossing.end_W_m[0]) - x
    to_y = 0.5 * (crossing.start_W_m[1] + crossing.end_W_m[1]) - y
    length_m, width_m, _ = vehicle.size_lwh_m
    near_m = half_m + 0.5 * width_m + _SIDE_M
    aside_m, ahead_m = abs(to_x * vy - to_y * vx) / speed_mps, (to_x * vx + to_y * vy) / speed_mps
    return bool(aside_m > near_m or ahead_m < -(near_m + 0.5 * length_m))


def _beside(points: F64, start: F64, end: F64) -> tuple[F64, F64]:
    """Where along the stretch (0..1) points (..., 2) are nearest to it, and how far from it."""
    along = end - start
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    off = points - start - share[..., None] * along
    return share, np.hypot(off[..., 0], off[..., 1])
