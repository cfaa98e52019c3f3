"""Lines and coloured cycle lanes on the road, from SUMO's lanes: thin paint for pictures alone.

Widths and lengths are usual urban ones: lines of 0.12 m, dashes of 3 m with 6 m between them.

Crossings without paint are those that a map calls unmarked, and those that netconvert guessed where
the map has none. They stay crossings for SUMO, and their kerbs are lowered; on the ground they look
like the road.
"""

from collections import defaultdict
from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import shapely
from shapely import LineString
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from wcsim.towns.ground.plane_geometry import Patches, left_of, units
from wcsim.towns.ground.surfaces import Surfaces, walkable_lanes
from wcsim.towns.sumo.additional import Item
from wcsim.towns.sumo.net import Edge, Lane, LaneKind, Net
from wcsim.types import F64, GroundPaint, Mark, Relief

_LINE_M, _STOP_M = 0.12, 0.4
_DASH_M, _EVERY_M = 3.0, 9.0
_SAME_M = 0.6  # apart at most are the inner borders of the two directions of one street
_SLOW_MPS = 6.0  # slower streets, yards and ways among parked cars, have no lines
_NARROW_M = 5.0  # nor has a street of two directions that is narrower a line between them
_BEFORE_M = 0.6  # of the end of the free road lies the middle of a stop line
_SHORT_M = 4.0  # a lane that is shorter has none
_CLEAR_M = 0.2  # between paint and junctions or crossings
_PIECE_M, _HILL_PIECE_M = 6.0, 1.0  # a piece belongs to one tile, and follows the land
_LIFT_M = {Mark.CYCLE_LANE: 0.006, Mark.LINE: 0.012}  # what lies higher is seen
_HILL_LIFT_M = 0.02
GROUP, KIND = "crossing", "unmarked"  # of the points that say so in a town's files
_ON_M = 1.0


def lane_marks(
    net: Net, surfaces: Surfaces, chair_ways: tuple[str, ...], relief: Relief
) -> GroundPaint:
    """The marks of all streets of a net; none on crossings and in junctions."""
    return _Painter(net, surfaces, chair_ways, relief).paint()


def unmarked_crossings(items: Iterable[Item], net: Net) -> frozenset[str]:
    """The edges of crossings on which a point of type crossing.unmarked lies."""
    points = [item.points_W_m[0] for item in items if item.group == GROUP and item.kind == KIND]
    lanes, tree = crossing_lines(net)
    if not points or not lanes:
        return frozenset()
    found: set[str] = set()
    for at_m in points:
        near = tree.query_nearest(shapely.Point(at_m), max_distance=_ON_M, all_matches=False)
        found.update(lanes[index].edge_id for index in near.tolist())
    return frozenset(found)


def crossing_lines(net: Net) -> tuple[list[Lane], shapely.STRtree]:
    """The crossings of a net that have a line, and a tree of these."""
    lanes = [lane for lane in net.lanes(LaneKind.CROSSING) if lane.is_line]
    return lanes, shapely.STRtree([shapely.LineString(lane.points_m) for lane in lanes])


class _Painter:
    """Collects the marks of one net as corners of pieces."""

    def __init__(
        self, net: Net, surfaces: Surfaces, chair_ways: tuple[str, ...], relief: Relief
    ) -> None:
        self._net, self._relief = net, relief
        # Lanes are numbered from the kerb to the middle of the street.
        self._inward = -1.0 if net.lefthand else 1.0
        self._raised = {lane.id for lane in walkable_lanes(net, chair_ways)}
        outlines = [j.outline_m for j in net.junctions if len(j.outline_m) > 2]
        junctions = [shapely.Polygon(outline_m).buffer(0.0) for outline_m in outlines]
        unpainted = shapely.union_all([surfaces.crossing, *junctions])
        self._road = Patches(surfaces.low)
        self._taken = Patches(unpainted.buffer(_CLEAR_M, quad_segs=1))
        self._quads: dict[Mark, list[F64]] = {mark: [] for mark in Mark}

    def paint(self) -> GroundPaint:
        """All marks, lifted onto the land."""
        streets = [edge for edge in self._net.streets if edge.lanes]
        for edge in streets:
            self._add_lanes(edge)
        self._add_middles([edge for edge in streets if edge.lanes[0].speed_mps > _SLOW_MPS])
        self._add_stops(streets)
        hill_m = 0.0 if self._relief.flat else _HILL_LIFT_M
        lifted: list[F64] = []
        marks: list[int] = []
        for mark, found in self._quads.items():
            quads_m = np.concatenate([np.zeros((0, 4, 2)), *found])
            lift_m = self._relief.at(quads_m) + _LIFT_M[mark] + hill_m
            lifted.append(np.dstack([quads_m, lift_m]))
            marks += [int(mark)] * len(quads_m)
        quads_W_m = np.concatenate(lifted).astype(np.float32)
        return GroundPaint(quads_W_m=quads_W_m, mark=np.array(marks, np.uint8))

    def _add_lanes(self, edge: Edge) -> None:
        """Cycle lanes, and what parts the lanes of an edge."""
        low = [lane for lane in edge.lanes if lane.id not in self._raised and lane.is_line]
        for lane in low:
            if lane.kind is LaneKind.BIKE:
                for line in self._free(LineString(lane.points_m)):
                    self._add(Mark.CYCLE_LANE, line, lane.width_m)
        for outer, inner in pairwise(low):
            kinds = {outer.kind, inner.kind}
            if inner.index != outer.index + 1 or LaneKind.MOTOR not in kinds:
                continue
            if outer.speed_mps <= _SLOW_MPS:
                continue
            for line in self._free(self._inner_border(outer)):
                if LaneKind.BIKE in kinds:
                    self._add(Mark.LINE, line, _LINE_M)
                elif kinds == {LaneKind.MOTOR}:
                    for at_m in np.arange(0.5 * _DASH_M, line.length - 0.5 * _DASH_M, _EVERY_M):
                        self._add(Mark.LINE, substring(line, at_m, at_m + _DASH_M), _LINE_M)

    def _add_middles(self, streets: list[Edge]) -> None:
        """A line between the two directions of a street, where their borders are one."""
        between: dict[tuple[str, str], list[Edge]] = defaultdict(list)
        for edge in streets:
            between[edge.start, edge.end].append(edge)
        for edge in streets:
            for other in between[edge.end, edge.start] if edge.start < edge.end else ():
                wide = _road_width_m(edge) + _road_width_m(other) >= _NARROW_M
                lane, opposite = edge.lanes[-1], other.lanes[-1]
                if wide and lane.kind is opposite.kind is LaneKind.MOTOR:
                    near = self._inner_border(opposite).buffer(_SAME_M)
                    for line in self._free(self._inner_border(lane).intersection(near)):
                        self._add(Mark.LINE, line, _LINE_M)

    def _add_stops(self, streets: list[Edge]) -> None:
        """A line across each lane before a signal or a crossing."""
        signalled = {(link.start, link.start_lane) for link in self._net.connections if link.tls_id}
        crossed = {
            (edge.id[1:].rpartition("_c")[0], name)
            for edge in self._net.edges
            if edge.function == "crossing"
            for name in edge.crossed
        }
        for edge in streets:
            for lane in edge.lanes:
                if lane.kind not in (LaneKind.MOTOR, LaneKind.BIKE) or lane.id in self._raised:
                    continue
                if (edge.id, lane.index) in signalled or (edge.end, edge.id) in crossed:
                    self._stop(lane)

    def _stop(self, lane: Lane) -> None:
        lines = self._free(LineString(lane.points_m)) if lane.is_line else []
        for last in lines[-1:]:
            away_m = last.distance(shapely.Point(lane.points_m[-1]))
            if last.length < _SHORT_M or away_m > _SHORT_M:
                continue
            middle_m = last.length - _BEFORE_M
            along = substring(last, middle_m - 0.5 * _STOP_M, middle_m + 0.5 * _STOP_M)
            self._add(Mark.LINE, along, lane.width_m)

    def _inner_border(self, lane: Lane) -> BaseGeometry:
        aside_m = 0.5 * self._inward * lane.width_m
        return LineString(lane.points_m).offset_curve(aside_m, join_style="mitre", mitre_limit=2.0)

    def _free(self, line: BaseGeometry) -> list[LineString]:
        """What of a line lies on the road, and neither in a junction nor on a crossing."""
        bounds = line.buffer(1.0).bounds
        free = line.intersection(self._road.near(bounds)).difference(self._taken.near(bounds))
        # Merged parts go in the direction of the line.
        if free.geom_type == "MultiLineString":
            free = shapely.line_merge(free)
        parts = shapely.get_parts(free)
        return [part for part in parts if part.geom_type == "LineString" and part.length > _STOP_M]

    def _add(self, mark: Mark, line: LineString, width_m: float) -> None:
        """A strip along a line, piece by piece; corners run counter-clockwise from above."""
        piece_m = _PIECE_M if self._relief.flat else _HILL_PIECE_M
        points_m = shapely.get_coordinates(shapely.segmentize(line, piece_m))
        steps = units(np.diff(points_m, axis=0))
        ahead = units(np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]]))
        aside = 0.5 * width_m * left_of(ahead)
        left, right = points_m + aside, points_m - aside
        self._quads[mark].append(np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1))


def _road_width_m(edge: Edge) -> float:
    return sum(lane.width_m for lane in edge.lanes if lane.kind is LaneKind.MOTOR)
