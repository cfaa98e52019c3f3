"""Shortest ways that stay inside an area."""

from __future__ import annotations

import networkx
import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.plane import cross_z
from wcsim.types import F64

_MAX_CORNERS = 160  # above this the area is thinned first: the search looks at all pairs
_SLACK_M = 1e-4


def shortest_inside(area: BaseGeometry, start_m: F64, goal_m: F64) -> F64 | None:
    """Shortest polyline (K, 2) from start to goal inside `area`, or None when they are in different parts of it.

    A shortest way bends only at inward corners of the area, so a graph of those that see each other holds it.
    """
    part = _part_with(area, start_m, goal_m)
    if part is None:
        return None
    roomy = part.buffer(_SLACK_M)
    shapely.prepare(roomy)
    if roomy.covers(shapely.LineString([start_m, goal_m])):
        return np.array([start_m, goal_m], dtype=np.float64)
    points = np.concatenate([[start_m, goal_m], _corners(part)])
    i, j = np.triu_indices(len(points), 1)
    lines = shapely.linestrings(np.stack([points[i], points[j]], axis=1))
    seen = shapely.covers(roomy, lines)
    graph = networkx.Graph()
    length_m = shapely.length(lines)
    graph.add_weighted_edges_from(zip(i[seen].tolist(), j[seen].tolist(), length_m[seen].tolist(), strict=True))
    try:
        nodes = networkx.shortest_path(graph, 0, 1, weight="weight")
    except (networkx.NetworkXNoPath, networkx.NodeNotFound):
        return None
    way: F64 = points[nodes]
    return way


def _part_with(area: BaseGeometry, start_m: F64, goal_m: F64) -> Polygon | None:
    for part in shapely.get_parts(area):
        if part.geom_type == "Polygon" and shapely.dwithin(part, shapely.points([start_m, goal_m]), _SLACK_M).all():
            return part
    return None


def _corners(part: Polygon) -> F64:
    """Corners (n, 2) at which the free side turns away: the only ones a shortest way can bend at."""
    for tolerance_m in (0.0, 0.02, 0.05, 0.1, 0.2):
        thinned = part.simplify(tolerance_m) if tolerance_m else part
        oriented = shapely.orient_polygons(thinned)  # outline counter-clockwise, holes clockwise
        rings = [oriented.exterior, *oriented.interiors]
        found = np.concatenate([_inward(shapely.get_coordinates(ring)[:-1]) for ring in rings])
        if len(found) <= _MAX_CORNERS:
            break
    return found[:_MAX_CORNERS]


def _inward(ring: F64) -> F64:
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    return ring[cross_z(before, after) < 0.0]
