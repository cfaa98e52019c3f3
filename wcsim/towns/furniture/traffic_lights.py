"""Posts and heads of traffic lights, for drivers and for people who cross; signs elsewhere."""

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from shapely import Polygon

from wcsim.towns.furniture.models import FOOT_M
from wcsim.towns.furniture.placement import FreeGround, StandingObject
from wcsim.towns.ground import solid_shapes
from wcsim.towns.ground.plane_geometry import left_of, unit, yaw_of
from wcsim.towns.ground.solid_shapes import Solid
from wcsim.towns.sumo.additional import Item
from wcsim.towns.sumo.net import Connection, Lane, LaneKind, Net, read_phases
from wcsim.towns.sumo.xml_io import parse_root, read_bytes
from wcsim.types import F64, ClassId, SignalHead, SignalState

_HEAD_LWH_M = (0.3, 0.3, 0.9)  # three lamps, one above the other
_WALK_HEAD_LWH_M = (0.3, 0.3, 0.6)  # two
HEAD_LOW_M = 2.3  # no head can hit it
_HANGING_LOW_M = 4.8  # over a road without room for a post
_POST_M = 0.07
APART_M = 0.4  # between two posts
_SIDE_BY_SIDE_M = 0.36
_ARM_M = 0.12  # thickness of an arm that reaches over the road
_ARM_REACH_M = (2.0, 3.0, 4.0, 5.5, 7.0, 9.0, 11.0, 14.0, 18.0, 23.0, 30.0)
# From the line that people walk on to the post of an arm, where there is no better place.
_PASSING_M = 0.45
_ARM_TURNS = 24  # directions in which its post is looked for
_BACK_M = (0.5, 1.5, 3.0, 5.0)  # how far before the stop line a post may stand
ASIDE_M = tuple(np.arange(0.3, 8.0, 0.35))  # how far beside the lane
BEYOND_M = (0.4, 0.8, 1.3, 2.0)  # how far beyond the end of a crossing
# How far to the right of its edge, or to the left.
BESIDE_M = (0.3, -0.3, 0.7, -0.7, 1.2, -1.2, 1.8, -1.8)
AT_ONCE = 8  # places that are looked at together
_SIGN_REACH_M = 20.0

_Groups = list[tuple[str, int]]
"""Heads of an approach, from the kerb on: traffic light and the number of a link of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Approach:
    """Where those who drive along an edge stop before a junction."""

    edge_id: str
    stop_m: F64  # (2,) end of the lane beside the kerb
    ahead: F64  # (2,) unit vector of travel
    aside: F64  # (2,) unit vector to the kerb: right, or left where traffic keeps left
    half_m: float  # half of that lane's width


def signal_things(
    net: Net, additional: tuple[Path, ...], place: FreeGround
) -> list[StandingObject]:
    """A post with heads at the kerb of each approach with a signal, and at both ends of crossings.

    Each post takes its place before the next one is looked for.
    """
    found: list[StandingObject] = []

    # 1. Signals of vehicles. Links with the same letter in all phases of a light share a head.
    states: dict[str, list[str]] = defaultdict(list)
    for phase in all_phases(net, additional):
        states[phase.tls_id].append(phase.colours.lower())
    links: dict[str, list[Connection]] = defaultdict(list)
    for link in net.connections:
        if link.tls_id and link.tls_link >= 0:
            links[link.start].append(link)
    for approach in _find_approaches(net):
        groups = _groups(links.get(approach.edge_id, []), states)
        if groups:
            found.append(_at_kerb(approach, groups, place))
            place.take(found[-1:])

    # 2. Signals of people on foot: at each end of a crossing a head that is seen from the other.
    lights: dict[str, Connection] = {}
    for edge_id, link in net.crossing_links():
        if link.tls_link >= 0:
            lights.setdefault(edge_id, link)
    for lane in net.lanes(LaneKind.CROSSING):
        light = lights.get(lane.edge_id)
        if light is None or not lane.is_line:
            continue
        for end, inner in ((0, 1), (-1, -2)):
            along = unit(lane.points_m[end] - lane.points_m[inner])
            things = _at_crossing(lane, end, along, light, place)
            place.take(things)
            found += things
    return found


def sign_things(items: list[Item], net: Net, place: FreeGround) -> list[StandingObject]:
    """The stop and give-way signs of a map, at the kerb of the approach that they are meant for."""
    kinds = (("highway", "stop"), ("highway", "give_way"))
    mapped = [item for item in items if (item.group, item.kind) in kinds]
    approaches = _find_approaches(net) if mapped else []
    if not approaches:
        return []
    tree = shapely.STRtree(shapely.points([approach.stop_m for approach in approaches]))
    found: list[StandingObject] = []
    for item in mapped:
        nearest = tree.query_nearest(shapely.Point(item.points_W_m[0]), max_distance=_SIGN_REACH_M)
        for approach in (approaches[i] for i in nearest[:1].tolist()):
            found += place.put("sign", _beside(approach), yaw_of(-approach.ahead))
    return found


def all_phases(net: Net, additional: tuple[Path, ...]) -> tuple[SignalState, ...]:
    """Each phase of each program of the traffic lights of a net and of additional files."""
    found = [*net.phases]
    for path in additional:
        data = read_bytes(path)
        if b"<tlLogic" in data:
            found += read_phases(parse_root(data, str(path)))
    return tuple(SignalState(tls_id=tls_id, colours=state) for tls_id, state in found)


def _find_approaches(net: Net) -> list[_Approach]:
    """The end of every edge that vehicles use."""
    found: list[_Approach] = []
    for edge in net.streets:
        lines = [lane for lane in edge.lanes if lane.is_line]
        cars = [lane for lane in lines if lane.kind in (LaneKind.MOTOR, LaneKind.RAIL)]
        # SUMO counts lanes from the kerb, on whichever side traffic keeps to.
        for lane in (cars or [lane for lane in lines if lane.kind is LaneKind.BIKE])[:1]:
            ahead = unit(lane.points_m[-1] - lane.points_m[-2])
            approach = _Approach(
                edge_id=edge.id,
                stop_m=lane.points_m[-1],
                ahead=ahead,
                aside=left_of(ahead) if net.lefthand else -left_of(ahead),
                half_m=lane.width_m / 2,
            )
            found.append(approach)
    return found


def _groups(links: list[Connection], states: dict[str, list[str]]) -> _Groups:
    """One link for each set of links that always show the same colour."""
    found: dict[tuple[str, str], tuple[str, int]] = {}
    for link in sorted(links, key=lambda link: (link.start_lane, link.tls_link)):
        number = link.tls_link
        phases = states.get(link.tls_id, [])
        column = "".join(state[number] if number < len(state) else "-" for state in phases)
        found.setdefault((link.tls_id, column or str(number)), (link.tls_id, number))
    return list(found.values())


def _at_kerb(approach: _Approach, groups: _Groups, place: FreeGround) -> StandingObject:
    """A post beside the stop line where there is room for one, else an arm over the road."""
    ahead, aside = approach.ahead, approach.aside
    xy_m = _first_free(_beside(approach), place)
    if xy_m is not None:
        top_m = HEAD_LOW_M + 0.5 * _HEAD_LWH_M[2]
        post = solid_shapes.post(xy_m, _POST_M, FOOT_M, top_m, ClassId.POLE, sides=5)
        front = xy_m - (_POST_M + _HEAD_LWH_M[1] / 2) * ahead
        pieces, heads = _heads(front, ahead, aside, groups, HEAD_LOW_M)
        piece = solid_shapes.joined([post, *pieces])
        return StandingObject(piece=piece, footprint=_disc(xy_m), base_m=xy_m, heads=heads)

    # The arm has a post of its own, hangs from the nearest wall, or hangs in the air.
    over = approach.stop_m + 0.5 * ahead
    pieces, heads = _heads(over, ahead, -aside, groups, _HANGING_LOW_M)
    last = over - (len(groups) - 1) * _SIDE_BY_SIDE_M * aside
    pieces.append(_arm(over, last))
    base_m, footprint = over, Polygon()
    foot_m = _foot_of_arm(over, place)
    if foot_m is not None:
        pieces.append(_arm(foot_m, over))
        top_m = _HANGING_LOW_M + _HEAD_LWH_M[2] + _ARM_M
        pieces.append(solid_shapes.post(foot_m, _POST_M, FOOT_M, top_m, ClassId.POLE, sides=5))
        base_m, footprint = foot_m, _disc(foot_m)
    else:
        line = shapely.shortest_line(shapely.Point(over), place.solids)
        for wall_m in shapely.get_coordinates(line)[-1:]:
            if float(np.hypot(*(wall_m - over))) <= _ARM_REACH_M[-1]:
                pieces.append(_arm(wall_m, over))
    piece = solid_shapes.joined(pieces)
    return StandingObject(piece=piece, footprint=footprint, base_m=base_m, heads=heads)


def _foot_of_arm(over_m: F64, place: FreeGround) -> F64 | None:
    """The nearest free place for the post of an arm, else the nearest that people can pass."""
    turns = np.linspace(0.0, 2.0 * np.pi, _ARM_TURNS, endpoint=False)
    reach_m = np.repeat(np.array(_ARM_REACH_M), _ARM_TURNS)[:, None]
    ring = np.column_stack([np.cos(turns), np.sin(turns)])
    places_m = over_m + reach_m * np.tile(ring, (len(_ARM_REACH_M), 1))
    found = _first_free(places_m, place)
    if found is not None:
        return found
    points = shapely.points(places_m)
    tight = np.ones(len(points), dtype=bool)
    for area, gap_m in ((place.low, _POST_M), (place.solids, _POST_M), (place.lines, _PASSING_M)):
        tight[tight] = ~shapely.dwithin(area, points[tight], gap_m)
    return np.asarray(places_m[tight][0]) if tight.any() else None


def _arm(start_m: F64, end_m: F64) -> Solid:
    """An arm above the heads, from one place to another."""
    along = end_m - start_m
    size_m = (float(np.hypot(*along)) + _ARM_M, _ARM_M, _ARM_M)
    top_m = _HANGING_LOW_M + _HEAD_LWH_M[2]
    middle_m = 0.5 * (start_m + end_m)
    return solid_shapes.box(middle_m, size_m, top_m, yaw_of(along), ClassId.POLE, floor=True)


def _beside(approach: _Approach) -> F64:
    """Places (n, 2) for a post at the kerb, best first."""
    back_m, aside_m = (grid.reshape(-1, 1) for grid in np.meshgrid(_BACK_M, ASIDE_M, indexing="ij"))
    return np.asarray(
        approach.stop_m - back_m * approach.ahead + (approach.half_m + aside_m) * approach.aside
    )


def _first_free(places_m: F64, place: FreeGround) -> F64 | None:
    """The first of some places (n, 2) for a post; close to another one only where it has to be."""
    close: F64 | None = None
    for start in range(0, len(places_m), AT_ONCE):
        some = places_m[start : start + AT_ONCE]
        for xy_m in some[place.free_spots(some, _POST_M)]:
            if place.taken.free(_disc(xy_m), APART_M):
                return np.asarray(xy_m)
            if close is None and place.taken.free(_disc(xy_m)):
                close = np.asarray(xy_m)
    return close


def _disc(xy_m: F64) -> Polygon:
    return shapely.Point(xy_m).buffer(_POST_M, quad_segs=2)


def _heads(
    first_m: F64, ahead: F64, aside: F64, groups: _Groups, low_m: float
) -> tuple[list[Solid], tuple[SignalHead, ...]]:
    """Heads side by side that look against the traffic, that of the lane at the kerb outermost."""
    yaw_rad = yaw_of(-ahead)
    pieces: list[Solid] = []
    heads: list[SignalHead] = []
    for k, (tls_id, link) in enumerate(reversed(groups)):
        middle = first_m + k * _SIDE_BY_SIDE_M * aside
        pieces.append(
            solid_shapes.box(middle, _HEAD_LWH_M, low_m, yaw_rad, ClassId.TRAFFIC_LIGHT, floor=True)
        )
        p_W_m = np.array([*middle, low_m + _HEAD_LWH_M[2] / 2])
        heads.append(
            SignalHead(tls_id=tls_id, link=link, p_W_m=p_W_m, yaw_rad=yaw_rad, pedestrian=False)
        )
    return pieces, tuple(heads)


def _at_crossing(
    lane: Lane, end: int, along: F64, light: Connection, place: FreeGround
) -> list[StandingObject]:
    """A post beside the end of a crossing if there is room; `along` points off the road."""
    yaw_rad = yaw_of(-along)
    beyond_m, aside_m = (
        grid.reshape(-1, 1) for grid in np.meshgrid(BEYOND_M, BESIDE_M, indexing="ij")
    )
    side_m = aside_m + np.sign(aside_m) * lane.width_m / 2
    xy_m = _first_free(lane.points_m[end] + beyond_m * along + side_m * -left_of(along), place)
    if xy_m is None:
        return []
    post = solid_shapes.post(xy_m, _POST_M, FOOT_M, HEAD_LOW_M, ClassId.POLE, sides=5)
    head = solid_shapes.box(
        xy_m, _WALK_HEAD_LWH_M, HEAD_LOW_M, yaw_rad, ClassId.TRAFFIC_LIGHT, floor=True
    )
    p_W_m = np.array([*xy_m, HEAD_LOW_M + _WALK_HEAD_LWH_M[2] / 2])
    signal = SignalHead(
        tls_id=light.tls_id, link=light.tls_link, p_W_m=p_W_m, yaw_rad=yaw_rad, pedestrian=True
    )
    piece = solid_shapes.joined([post, head])
    return [StandingObject(piece=piece, footprint=_disc(xy_m), base_m=xy_m, heads=(signal,))]
