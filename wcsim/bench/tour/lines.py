"""Lines over every pavement, walking area and crossing of a net, in an order that somebody could drive."""

from __future__ import annotations

import numpy as np
import shapely

from wcsim.towns.ground.plane import length_of
from wcsim.towns.ground.surfaces import lane_area, walkable_lanes
from wcsim.towns.sumo.net import Lane, LaneKind, Net
from wcsim.types import F64

SHORTEST_M = 0.5


def walking_lines(net: Net, chair_ways: tuple[str, ...]) -> tuple[F64, ...]:
    """One polyline (K, 2) for each: along a lane or crossing, and across a walking area the long way."""
    lanes = [*walkable_lanes(net, chair_ways), *net.lanes(LaneKind.CROSSING), *net.lanes(LaneKind.WALKINGAREA)]
    lines = [_line(lane) for lane in lanes]
    return _in_order([line for line in lines if line is not None])


def _line(lane: Lane) -> F64 | None:
    if lane.kind is not LaneKind.WALKINGAREA:
        return lane.points_m if length_of(lane.points_m) >= SHORTEST_M else None
    area = lane_area(lane)
    if area.is_empty:
        return None
    box = shapely.get_coordinates(shapely.minimum_rotated_rectangle(area))[:-1]
    if len(box) < 4:
        return None
    middles = 0.5 * (box + np.roll(box, -1, axis=0))  # (4, 2) of the box's sides
    sides = [middles[[0, 2]], middles[[1, 3]]]
    inside = shapely.intersection(shapely.linestrings(max(sides, key=length_of)), area)
    parts = [shapely.get_coordinates(part) for part in shapely.get_parts(inside) if part.geom_type == "LineString"]
    best = max(parts, key=length_of, default=None)
    return best if best is not None and length_of(best) >= SHORTEST_M else None


def _in_order(lines: list[F64]) -> tuple[F64, ...]:
    """Each line followed by the one that begins or ends nearest to its end, turned round where that is its end."""
    ends = np.array([(line[0], line[-1]) for line in lines]).reshape(-1, 2, 2)
    left = np.ones(len(lines), bool)
    here, ordered = np.zeros(2), []
    for _ in lines:
        gap2 = np.where(left[:, None], ((ends - here) ** 2).sum(-1), np.inf)
        index, side = divmod(int(gap2.argmin()), 2)
        left[index] = False
        ordered.append(lines[index][::-1] if side else lines[index])
        here = ordered[-1][-1]
    return tuple(ordered)
