"""Crossing a road: where the route does it, whether light and vehicles allow it, where to stop."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

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
from wcsim.users.route_line import RoutePolyline

KERB_GAP_M: Final = 0.3  # left between footplate and road while waiting
MOVING_MPS: Final = 0.5
RIDERS: Final = frozenset({ActorKind.BICYCLE, ActorKind.SCOOTER})

_GAP_S: Final = 3.0  # a vehicle that comes nearer than this in time is waited for
_START_S: Final = 1.5  # a chair at the kerb starts so late,
_CROSSING_MPS: Final = 1.1  # and gets over the road so fast
_STEP_S: Final = 0.25
_SIDE_M: Final = 1.2  # added to half the vehicle's width: how near it must come to count
# A rider that rides more nearly along the crossing than this uses it, or rides beside it.
_ALONG: Final = math.cos(0.25 * math.pi)
_LIGHT_SEEN_M: Final = 8.0  # before the kerb, where the user looks for a light
_TRAFFIC_SEEN_M: Final = 3.0
# A vehicle farther from a crossing that has green has red itself, and still brakes for it.
_GREEN_SEEN_M: Final = 25.0
# From so far before the kerb on, a user that obeys a light does not look elsewhere.
_LOOK_M: Final = 2.5
# A chair that comes to rest with the footplate less far into the road than this waits there.
_HALF_LANE_M: Final = 1.6
_SHORT_GREEN_S: Final = 5.0  # a green for people on foot may end so soon, and many do
# A user that, at this speed, may not reach the kerb that much earlier does not go for a green.
_SPARE_S: Final = 0.5
_ONWARD_MPS: Final = 0.7

_CARRIAGEWAY: Final = (ClassId.ROAD, ClassId.CROSSWALK)
_ALONG_KERB_M: Final = 3.0
_ALONG_STEP_M: Final = 0.25
_NEAR_ROAD_M: Final = 0.8  # waiting so near to the road, a turn may swing the footplate over it
_RING: Final = tuple((math.cos(0.25 * math.pi * k), math.sin(0.25 * math.pi * k)) for k in range(8))
# So far before the crossing's own start a kerb that runs aslant may lie.
_ASLANT_M: Final = 1.2
_ASLANT_STEP_M: Final = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class RouteCrossing:
    """A stretch of the route over a road."""

    start_m: float  # arc on the route
    end_m: float
    start_W_m: tuple[float, float]
    end_W_m: tuple[float, float]
    tls_id: str
    tls_links: tuple[int, ...]


class CrossingStopPlanner:
    """Where a user must stop at the crossings of one route."""

    def __init__(
        self,
        items: Sequence[RouteCrossing],
        path: RoutePolyline,
        ground: Ground | None,
        law_share: float,
        rng: np.random.Generator,
        half_length_m: float,
    ) -> None:
        """Draw for each crossing whether the user obeys the law there.

        Args:
            items: The crossings of the route, in order.
            path: The route.
            ground: The street; without it, kerbs are where the crossings start.
            law_share: The chance that the user obeys the law at a crossing.
            rng: Source of these draws.
            half_length_m: Half the chair's length.
        """
        self._half_length_m = half_length_m
        self._waits_m = half_length_m + KERB_GAP_M  # from the waiting chair's middle to the kerb
        self._ground = ground
        # Drawn here for all: a crossing's draw does not depend on when, or after which others, the
        # user comes to it.
        lawful = (rng.random(len(items)) < law_share).tolist()
        self._states: list[_CrossingState] = []
        for item, obeys in zip(items, lawful, strict=True):
            near_m = road_m = item.start_m
            if ground is not None:
                near_m = find_kerb_arc_m(ground, path, item.start_m)
                road_m = _road_arc_m(ground, path, item.start_m)
            self._states.append(
                _CrossingState(
                    crossing=item, lawful=obeys, stop_m=near_m - self._waits_m, road_m=road_m
                )
            )

    @property
    def obeys(self) -> Mapping[RouteCrossing, bool]:
        """The crossings that the user has reached, and whether it obeys the law there."""
        return {state.crossing: state.lawful for state in self._states if state.reached}

    def stop_m(
        self,
        arc_m: float,
        time_s: float,
        signals: Iterable[SignalState],
        vehicles: Iterable[ActorState],
    ) -> float | None:
        """Arc where the chair's middle must stop for a light or a vehicle; None when it need not.

        What the user sees of each light is stored.

        Args:
            arc_m: Of the chair's middle now, not where it will be when the hand answers. A chair
                that brakes late rolls on until there, and has not started to cross by that.
            time_s: Now.
            signals: The lights near the chair.
            vehicles: Those that the user knows of.
        """
        behind_m = -math.inf
        for state in self._states:
            item = state.crossing
            line_m = item.start_m - self._waits_m
            to_go_m = line_m - arc_m
            # Too short a refuge between two crossings is no place to wait.
            has_room = line_m > behind_m + self._half_length_m
            stop_m = max(state.stop_m, behind_m + self._half_length_m)
            behind_m = item.end_m

            # 1. Only a crossing near ahead counts, and only where the user obeys the law.
            back_m = KERB_GAP_M + min(_HALF_LANE_M, 0.5 * (item.end_m - item.start_m))
            is_near = -back_m < to_go_m < _LIGHT_SEEN_M
            if not is_near or not has_room or state.started or not state.reach():
                continue

            # 2. Wait at red.
            if state.update_light(signals, time_s):
                return stop_m

            # 3. Wait for vehicles. At a light they count only at a green after a red.
            lit = _has_light(item, signals)
            if to_go_m < _TRAFFIC_SEEN_M and (state.red_last_s is not None or not lit):
                traffic = [each for each in vehicles if _is_traffic(item, each, self._ground)]
                if _has_conflict(item, _near_start(item, traffic) if lit else traffic):
                    return stop_m

            # 4. Wait where a short green may end. The next one is met nearer to the kerb.
            to_road_m = state.road_m - self._half_length_m - arc_m
            if state.update_hesitation(to_road_m, time_s):
                return state.road_m - self._waits_m

            # 5. A chair beyond the line has started to cross, and goes on.
            if to_go_m < -KERB_GAP_M:
                state.started = True
        return None

    def heeds_light(self, arc_m: float) -> bool:
        """Whether a light that the user obeys is so near that a red must be answered at once."""
        front_m = arc_m + self._half_length_m
        return any(
            state.crossing.tls_id
            and not state.started
            and -KERB_GAP_M < state.road_m - front_m < _LOOK_M
            and state.reach()
            for state in self._states
        )


@dataclass(slots=True, kw_only=True)
class _CrossingState:
    """One crossing of a route, and what its user has seen there."""

    crossing: RouteCrossing
    lawful: bool
    stop_m: float  # arc of the chair's middle from where a turn does not swing over the road
    road_m: float  # arc where the route gets onto the road
    reached: bool = False
    started: bool = False
    red_last_s: float | None = None
    green_since_s: float | None = None  # of a green after a red
    hesitates: bool = False

    def reach(self) -> bool:
        """Mark that the user has come here; whether it obeys the law."""
        self.reached = True
        return self.lawful

    def update_light(self, signals: Iterable[SignalState], time_s: float) -> bool:
        """Store the light as it is now; whether it is red."""
        if is_red(self.crossing, signals):
            self.red_last_s = time_s
            self.green_since_s = None
            self.hesitates = False
            return True
        if self.red_last_s is not None and self.green_since_s is None:
            self.green_since_s = time_s
        return False

    def update_hesitation(self, to_road_m: float, time_s: float) -> bool:
        """Whether a green after a red may be over before the footplate is at the road.

        A user that has slowed down for it cannot make it any more, so it hesitates until the green
        has proved to be a longer one.
        """
        if self.red_last_s is None or self.green_since_s is None:
            return False
        if to_road_m <= (0.0 if self.hesitates else KERB_GAP_M):
            return False
        longest_s = time_s - self.red_last_s
        shortest_s = time_s - self.green_since_s
        if longest_s + to_road_m / _ONWARD_MPS > _SHORT_GREEN_S - _SPARE_S:
            self.hesitates = True
        return self.hesitates and shortest_s < _SHORT_GREEN_S + _SPARE_S


def find_route_crossings(route: Route, walk: WalkGraph) -> tuple[RouteCrossing, ...]:
    """The crossings on a route, in order; pieces of one crossing edge are one crossing."""
    found: list[RouteCrossing] = []
    index = route.edge_index.tolist()
    arc_m = route.arc_m.tolist()
    points = [(float(x), float(y)) for x, y in route.points_W_m[:, :2].tolist()]
    first = 0
    while first < len(index) - 1:
        edge = walk.edges[index[first]]
        last = first + 1
        while last < len(index) - 1 and index[last] == index[first]:
            last += 1
        if edge.kind is WayKind.CROSSING and arc_m[last] > arc_m[first]:
            found.append(
                RouteCrossing(
                    start_m=arc_m[first],
                    end_m=arc_m[last],
                    start_W_m=points[first],
                    end_W_m=points[last],
                    tls_id=edge.tls_id,
                    tls_links=edge.tls_links,
                )
            )
        first = last
    return tuple(found)


def find_kerb_arc_m(ground: Ground, path: RoutePolyline, start_m: float) -> float:
    """Arc where a route to a crossing comes near to the road.

    It is at the crossing's start, or before it on a way along the kerb.
    """
    for step in range(round(_ALONG_KERB_M / _ALONG_STEP_M), 0, -1):
        arc_m = start_m - step * _ALONG_STEP_M
        x, y = path.at(arc_m)
        around = ((x + _NEAR_ROAD_M * cos, y + _NEAR_ROAD_M * sin) for cos, sin in _RING)
        on_pavement = ground.class_here(x, y) not in _CARRIAGEWAY
        if on_pavement and any(ground.class_here(*at) in _CARRIAGEWAY for at in around):
            return arc_m
    return start_m


def _road_arc_m(ground: Ground, path: RoutePolyline, start_m: float) -> float:
    """Arc where a route to a crossing gets onto the road.

    It is at the crossing's start, or before it where the kerb runs aslant.
    """
    for step in range(round(_ASLANT_M / _ASLANT_STEP_M), 0, -1):
        arc_m = start_m - step * _ASLANT_STEP_M
        if ground.class_here(*path.at(arc_m)) in _CARRIAGEWAY:
            return arc_m
    return start_m


def is_red(crossing: RouteCrossing | WalkEdge, signals: Iterable[SignalState]) -> bool:
    """Whether the pedestrian signal forbids to start; one that is missing or off never does."""
    signal = _signal_of(crossing, signals)
    return signal is not None and not signal.frees(crossing.tls_links)


def _has_light(crossing: RouteCrossing, signals: Iterable[SignalState]) -> bool:
    """Whether a signal that is switched on governs the crossing."""
    signal = _signal_of(crossing, signals)
    if signal is None:
        return False
    colours = [signal.colours[i] for i in crossing.tls_links if i < len(signal.colours)]
    return any(colour in "rRyYuGg" for colour in colours)


def _signal_of(
    crossing: RouteCrossing | WalkEdge, signals: Iterable[SignalState]
) -> SignalState | None:
    for signal in signals:
        if signal.tls_id == crossing.tls_id and crossing.tls_id:
            return signal
    return None


def _near_start(crossing: RouteCrossing, vehicles: Iterable[ActorState]) -> list[ActorState]:
    """The vehicles so near to where a crossing starts that they count at green."""
    start = crossing.start_W_m
    return [v for v in vehicles if math.dist(v.p_W_m[:2].tolist(), start) < _GREEN_SEEN_M]


def _is_traffic(crossing: RouteCrossing, vehicle: ActorState, ground: Ground | None) -> bool:
    """Whether a vehicle drives on the road that is crossed.

    A rider need not: where many ride on the pavement, they pass the kerb without end, and one that
    uses the crossing too goes where the chair goes. Without a ground every rider counts as on the
    road.
    """
    if vehicle.kind not in RIDERS:
        return True
    (x, y, _), (vx, vy, _) = vehicle.p_W_m.tolist(), vehicle.v_W_mps.tolist()
    if ground is not None and ground.class_here(x, y) not in _CARRIAGEWAY:
        return False
    to_x = crossing.end_W_m[0] - crossing.start_W_m[0]
    to_y = crossing.end_W_m[1] - crossing.start_W_m[1]
    return bool(abs(vx * to_x + vy * to_y) <= _ALONG * math.hypot(vx, vy) * math.hypot(to_x, to_y))


def _has_conflict(crossing: RouteCrossing, vehicles: Iterable[ActorState]) -> bool:
    """Whether a vehicle, driving on as it does, gets too near to a chair that crosses now.

    Too near: it is somewhere on the crossing within the next `_GAP_S` seconds, or within `_GAP_S`
    of the moment at which the chair gets to that place.
    """
    length_m = math.dist(crossing.start_W_m, crossing.end_W_m)
    needed_s = _START_S + length_m / _CROSSING_MPS
    later_s = np.arange(0.0, needed_s + _GAP_S, _STEP_S)  # (T,)
    start_W_m = np.array(crossing.start_W_m)
    along_m = np.subtract(crossing.end_W_m, start_W_m)
    for vehicle in vehicles:
        v: F64 = vehicle.v_W_mps[:2]
        speed_mps = float(np.hypot(v[0], v[1]))
        if speed_mps < MOVING_MPS or _passes_wide(vehicle, speed_mps, crossing, 0.5 * length_m):
            continue
        ends = np.array([-1.0, 0.0, 1.0])[:, None]  # tail, middle, nose
        ends_m = 0.5 * vehicle.size_lwh_m[0] / speed_mps * ends * v
        points = vehicle.p_W_m[:2] + later_s[:, None, None] * v + ends_m  # (T, 3, 2)
        # Where along the crossing (0..1) these places are nearest to it, and how far off it.
        share = (points - start_W_m) @ along_m / max(float(along_m @ along_m), 1e-12)
        share = np.clip(share, 0.0, 1.0)
        off_m = points - start_W_m - share[..., None] * along_m
        distance_m = np.hypot(off_m[..., 0], off_m[..., 1])
        chair_s = _START_S + share * length_m / _CROSSING_MPS
        when_s = np.broadcast_to(later_s[:, None], share.shape)
        close = (when_s < _GAP_S) | (np.abs(when_s - chair_s) < _GAP_S)
        if (close & (distance_m < 0.5 * vehicle.size_lwh_m[1] + _SIDE_M)).any():
            return True
    return False


def _passes_wide(
    vehicle: ActorState, speed_mps: float, crossing: RouteCrossing, half_m: float
) -> bool:
    """Whether a vehicle's straight way leads past a crossing, or has left it.

    So does that of most vehicles in sight, and this costs little.
    """
    (x, y, _), (vx, vy, _) = vehicle.p_W_m.tolist(), vehicle.v_W_mps.tolist()
    to_x = 0.5 * (crossing.start_W_m[0] + crossing.end_W_m[0]) - x
    to_y = 0.5 * (crossing.start_W_m[1] + crossing.end_W_m[1]) - y
    length_m, width_m, _ = vehicle.size_lwh_m
    near_m = half_m + 0.5 * width_m + _SIDE_M
    aside_m = abs(to_x * vy - to_y * vx) / speed_mps
    ahead_m = (to_x * vx + to_y * vy) / speed_mps
    return bool(aside_m > near_m or ahead_m < -(near_m + 0.5 * length_m))
