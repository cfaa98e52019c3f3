"""Posts and heads of traffic lights, for those who drive and those who cross, and signs at junctions without any."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
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
from wcsim.towns.sumo.net import Connection, Edge, Lane, LaneKind, Net, read_phases
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
"""Heads of an approach.

Traffic light and the number of a link of it, from the kerb towards the middle of the road.
"""


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
    """A post with heads at the kerb of each approach that a signal controls, and at both ends of such crossings."""
    found: list[StandingObject] = []
    # The states of all phases of each light: links with the same letter in all of them share a head.
    columns: dict[str, list[str]] = defaultdict(list)
    for phase in all_phases(net, additional):
        columns[phase.tls_id].append(phase.colours.lower())
    for thing in chain(_vehicle_signals(net, columns, place), _walk_signals(net, place)):
        place.take([thing])
        found.append(thing)
    return found


def sign_things(items: list[Item], net: Net, place: FreeGround) -> list[StandingObject]:
    """Stop and give-way signs that a map has on the road.

    They stand at the kerb of the approach they are meant for.
    """
    wanted = [
        item for item in items if item.kind in ("stop", "give_way") and item.group == "highway"
    ]
    approaches = _find_approaches(net) if wanted else []
    if not approaches:
        return []
    tree = shapely.STRtree(shapely.points([approach.stop_m for approach in approaches]))
    found: list[StandingObject] = []
    for item in wanted:
        nearest = tree.query_nearest(shapely.Point(item.points_W_m[0]), max_distance=_SIGN_REACH_M)
        for approach in (approaches[i] for i in nearest[:1].tolist()):
            found += place.put("sign", _beside(approach), yaw_of(-approach.ahead))
    return found


def _find_approaches(net: Net) -> list[_Approach]:
    """The end of every edge that vehicles use."""
    found: list[_Approach] = []
    for edge in net.streets:
        if lanes := _driven(edge):
            lane = lanes[0]  # SUMO counts from the kerb, on whichever side traffic keeps to
            ahead = unit(lane.points_m[-1] - lane.points_m[-2])
            found.append(
                _Approach(
                    edge_id=edge.id,
                    stop_m=lane.points_m[-1],
                    ahead=ahead,
                    aside=left_of(ahead) if net.lefthand else -left_of(ahead),
                    half_m=lane.width_m / 2,
                )
            )
    return found


def _driven(edge: Edge) -> list[Lane]:
    kinds = (LaneKind.MOTOR, LaneKind.RAIL, LaneKind.BIKE)
    lanes = [lane for lane in edge.lanes if lane.kind in kinds and lane.is_line]
    cars = [lane for lane in lanes if lane.kind is not LaneKind.BIKE]
    return cars or lanes


def all_phases(net: Net, additional: tuple[Path, ...]) -> tuple[SignalState, ...]:
    """Each phase of each program of the traffic lights, of the net and of a scenario's additional files."""
    found = (*net.phases, *_more_phases(additional))
    return tuple(SignalState(tls_id=tls_id, colours=state) for tls_id, state in found)


def _more_phases(files: tuple[Path, ...]) -> Iterator[tuple[str, str]]:
    for path in files:
        data = read_bytes(path)
        if b"<tlLogic" in data:
            yield from read_phases(parse_root(data, str(path)))


def _vehicle_signals(
    net: Net, columns: dict[str, list[str]], place: FreeGround
) -> Iterator[StandingObject]:
    links: dict[str, list[Connection]] = defaultdict(list)
    for link in net.connections:
        if link.tls_id and link.tls_link >= 0:
            links[link.start].append(link)
    for approach in _find_approaches(net):
        groups = _groups(links.get(approach.edge_id, []), columns)
        if groups:
            yield _at_kerb(approach, groups, place)


def _groups(links: list[Connection], columns: dict[str, list[str]]) -> _Groups:
    """One link for each set of links that always show the same colour."""
    found: dict[tuple[str, str], tuple[str, int]] = {}
    for link in sorted(links, key=lambda link: (link.start_lane, link.tls_link)):
        states = columns.get(link.tls_id, [])
        column = "".join(
            state[link.tls_link] if link.tls_link < len(state) else "-" for state in states
        )
        found.setdefault((link.tls_id, column or str(link.tls_link)), (link.tls_id, link.tls_link))
    return list(found.values())


def _at_kerb(approach: _Approach, groups: _Groups, place: FreeGround) -> StandingObject:
    """A post beside the stop line where there is room for one, else heads on an arm that reaches over the road."""
    xy_m = _first_free(_beside(approach), place)
    if xy_m is not None:
        post = solid_shapes.post(
            xy_m, _POST_M, FOOT_M, HEAD_LOW_M + 0.5 * _HEAD_LWH_M[2], ClassId.POLE, sides=5
        )
        front = xy_m - (_POST_M + _HEAD_LWH_M[1] / 2) * approach.ahead
        pieces, heads = _heads(front, approach.ahead, approach.aside, groups, HEAD_LOW_M)
        return StandingObject(
            piece=solid_shapes.joined([post, *pieces]),
            footprint=_disc(xy_m),
            base_m=xy_m,
            heads=heads,
        )
    over = approach.stop_m + 0.5 * approach.ahead
    pieces, heads = _heads(over, approach.ahead, -approach.aside, groups, _HANGING_LOW_M)
    last = over - (len(groups) - 1) * _SIDE_BY_SIDE_M * approach.aside
    foot_m = _foot_of_arm(over, place)
    held_m = foot_m if foot_m is not None else _wall(over, place)
    pieces += [_arm(over, last), *([_arm(held_m, over)] if held_m is not None else [])]
    base_m, footprint = over, Polygon()
    if foot_m is not None:
        top_m = _HANGING_LOW_M + _HEAD_LWH_M[2] + _ARM_M
        pieces.append(solid_shapes.post(foot_m, _POST_M, FOOT_M, top_m, ClassId.POLE, sides=5))
        base_m, footprint = foot_m, _disc(foot_m)
    return StandingObject(
        piece=solid_shapes.joined(pieces), footprint=footprint, base_m=base_m, heads=heads
    )


def _foot_of_arm(over_m: F64, place: FreeGround) -> F64 | None:
    """Where the post of an arm stands.

    The nearest free place, else the nearest that people can pass, if any.
    """
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


def _wall(over_m: F64, place: FreeGround) -> F64 | None:
    """The nearest place of a building, from which a light can hang.

    None where there is none near.
    """
    nearest = shapely.get_coordinates(shapely.shortest_line(shapely.Point(over_m), place.solids))
    near = len(nearest) > 0 and float(np.hypot(*(nearest[-1] - over_m))) <= _ARM_REACH_M[-1]
    return np.asarray(nearest[-1]) if near else None


def _arm(start_m: F64, end_m: F64) -> Solid:
    """An arm above the heads, from one place to another."""
    along = end_m - start_m
    size_m = (float(np.hypot(*along)) + _ARM_M, _ARM_M, _ARM_M)
    top_m = _HANGING_LOW_M + _HEAD_LWH_M[2]
    return solid_shapes.box(
        0.5 * (start_m + end_m), size_m, top_m, yaw_of(along), ClassId.POLE, floor=True
    )


def _beside(approach: _Approach) -> F64:
    """Places (n, 2) for a post at the kerb, best first."""
    back_m, aside_m = (grid.reshape(-1, 1) for grid in np.meshgrid(_BACK_M, ASIDE_M, indexing="ij"))
    return np.asarray(
        approach.stop_m - back_m * approach.ahead + (approach.half_m + aside_m) * approach.aside
    )


def _first_free(places_m: F64, place: FreeGround) -> F64 | None:
    """The first of some places (n, 2) where a post may stand, close to another one only where there is no other."""
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
    """Heads side by side that look against the traffic, the one for the lane at the kerb farthest aside."""
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


def _walk_signals(net: Net, place: FreeGround) -> Iterator[StandingObject]:
    """At each end of a crossing a head that those at the other end see."""
    lights: dict[str, Connection] = {}
    for edge, link in net.crossing_links():
        if link.tls_link >= 0:
            lights.setdefault(edge, link)
    for lane in net.lanes(LaneKind.CROSSING):
        light = lights.get(lane.edge_id)
        if light is None or not lane.is_line:
            continue
        for end, inner in ((0, 1), (-1, -2)):
            along = unit(lane.points_m[end] - lane.points_m[inner])
            if (thing := _at_crossing(lane, end, along, light, place)) is not None:
                yield thing


def _at_crossing(
    lane: Lane, end: int, along: F64, light: Connection, place: FreeGround
) -> StandingObject | None:
    """A post beside the end of a crossing, or None where there is no room.

    `along` points off the road.
    """
    yaw_rad = yaw_of(-along)
    beyond_m, aside_m = (
        grid.reshape(-1, 1) for grid in np.meshgrid(BEYOND_M, BESIDE_M, indexing="ij")
    )
    side_m = aside_m + np.sign(aside_m) * lane.width_m / 2
    xy_m = _first_free(lane.points_m[end] + beyond_m * along + side_m * -left_of(along), place)
    if xy_m is None:
        return None
    post = solid_shapes.post(xy_m, _POST_M, FOOT_M, HEAD_LOW_M, ClassId.POLE, sides=5)
    head = solid_shapes.box(
        xy_m, _WALK_HEAD_LWH_M, HEAD_LOW_M, yaw_rad, ClassId.TRAFFIC_LIGHT, floor=True
    )
    p_W_m = np.array([*xy_m, HEAD_LOW_M + _WALK_HEAD_LWH_M[2] / 2])
    signal = SignalHead(
        tls_id=light.tls_id, link=light.tls_link, p_W_m=p_W_m, yaw_rad=yaw_rad, pedestrian=True
    )
    return StandingObject(
        piece=solid_shapes.joined([post, head]), footprint=_disc(xy_m), base_m=xy_m, heads=(signal,)
    )
