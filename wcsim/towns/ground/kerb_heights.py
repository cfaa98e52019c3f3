"""How high kerbs stand, and where they are lowered: at crossings, and where a map says so."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
import shapely
import shapely.affinity
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.plane_geometry import Patches, buffered
from wcsim.towns.ground.surfaces import GRID_M, Surfaces
from wcsim.types import F64

_RAMP_RUN = 12.6  # metres of ramp for one metre of height: 1:12 also where a ring cuts a corner
STEEPEST = 1.0 / 12.0
_RING_CHORD = 0.96  # the chords of a ring come this close to the middle of its arc
NEAR_M = 1.5  # a kerb that is mapped this far from ours is the same one
# The same at a crossing, where there is no other kerb. SUMO's roads are not as wide as real ones.
_AT_CROSSING_M = 3.0
_AHEAD_M = 0.2  # from the corners of the mouth of a crossing lies what is ahead of it
HALF_WIDTH_M = 0.75  # of a lowered place that is mapped as a point
_NODE_M = 12.0  # at most from the node of a crossing to its kerbs
_ACROSS_M = 15.0  # from the middle of a street to its kerb
_EVERY_M = 2.0  # along a street its kerb is looked for


@dataclass(frozen=True, slots=True, kw_only=True)
class KerbMark:
    """A kerb of a map."""

    line: BaseGeometry  # a point or a line, in W
    height_m: float  # infinite: raised, as high as the town's
    # At 0 the kerb lies on the line. At 1 or -1 the line is the middle of a street whose left or
    # right kerb it is.
    side: int = 0
    crossing: bool = False  # the point is a crossing, with a kerb at both its ends


@dataclass(frozen=True, slots=True, kw_only=True)
class _Lowered:
    """Where kerbs are lowered to one height."""

    drop_m: float
    ramp_m: float  # length of the ramp up to the full height
    lines: BaseGeometry
    tree: shapely.STRtree  # of the same lines, for questions about points


@dataclass(frozen=True, slots=True, kw_only=True)
class Kerbing:
    """Heights of raised ground, and the places where it comes down to the road."""

    top_m: float
    lowered: tuple[_Lowered, ...]  # by height

    def height_m(self, xy_m: F64) -> F64:
        """Height (n,) of raised ground at (n, 2).

        Every ramp rises at the same grade, and the lowest one counts.
        """
        height_m = np.full(len(xy_m), self.top_m)
        places = shapely.points(xy_m)
        for low in self.lowered:
            (index, _), far_m = low.tree.query_nearest(
                places, max_distance=low.ramp_m, return_distance=True, all_matches=False
            )
            share = np.clip(far_m / (_RING_CHORD * low.ramp_m), 0.0, 1.0)
            on_ramp_m = low.drop_m + (self.top_m - low.drop_m) * share
            height_m[index] = np.minimum(height_m[index], on_ramp_m)
        rounded: F64 = np.round(height_m, 5)
        return rounded


def make_kerbing(
    surfaces: Surfaces, top_m: float, drop_m: float, marks: Collection[KerbMark] = ()
) -> Kerbing:
    """Lower kerbs where the edge of a crossing touches pavement, and where a map has lowered ones.

    A crossing whose kerb is mapped as raised keeps it.
    """
    # 1. Find where crossings meet the pavement.
    bank = buffered(surfaces.pavement, 2 * GRID_M)
    edge = _lines(surfaces.crossing.boundary.intersection(bank))
    mouths = _lines(shapely.line_merge(shapely.MultiLineString(edge)))
    edges, banks = Patches(surfaces.low.boundary), Patches(bank)

    def kerb_near(area: BaseGeometry) -> BaseGeometry:
        return edges.near(area.bounds).intersection(banks.near(area.bounds))

    # 2. Find the kerbs of streets whose middle is mapped.
    sides: list[tuple[BaseGeometry, float]] = []
    for mark in marks:
        if mark.side:
            lines = _lines(_along(mark, kerb_near(mark.line.buffer(_ACROSS_M))))
            sides.append((shapely.MultiLineString(lines), mark.height_m))

    # 3. Decide on the heights at the crossings, then on those of other stretches.
    lips_m = _lips_m(mouths, sides, marks, top_m, drop_m)
    elsewhere = [(line, lip_m) for street, lip_m in sides for line in street.geoms]
    for mark in marks:
        if mark.side or mark.crossing or mark.height_m >= top_m:
            continue
        near = mark.line.buffer(NEAR_M)
        kerb = kerb_near(near)
        is_point = mark.line.geom_type == "Point" and not kerb.is_empty
        if is_point and shapely.dwithin(kerb, mark.line, NEAR_M):
            near = shapely.shortest_line(kerb, mark.line).interpolate(0.0).buffer(HALF_WIDTH_M)
        elsewhere += [(line, mark.height_m) for line in _lines(kerb.intersection(near))]

    kerbs = [*zip(mouths, lips_m, strict=True), *elsewhere]
    return Kerbing(top_m=top_m, lowered=_lowered_by_height(kerbs, top_m))


def _lowered_by_height(
    kerbs: Iterable[tuple[BaseGeometry, float]], top_m: float
) -> tuple[_Lowered, ...]:
    """Lines of kerbs, each with its height, gathered where that is less than the full one."""
    groups: dict[float, list[BaseGeometry]] = {}
    for line, lip_m in kerbs:
        if lip_m < top_m:
            groups.setdefault(lip_m, []).append(line)
    return tuple(
        _Lowered(
            drop_m=lip_m,
            ramp_m=_RAMP_RUN * (top_m - lip_m),
            lines=shapely.MultiLineString(groups[lip_m]),
            tree=shapely.STRtree(groups[lip_m]),
        )
        for lip_m in sorted(groups)
    )


def _along(mark: KerbMark, kerb: BaseGeometry) -> BaseGeometry:
    """The kerb on one side of the middle line of a street: what is met first on the way there."""
    line = mark.line if mark.side > 0 else mark.line.reverse()
    if line.geom_type != "LineString" or kerb.is_empty:
        return shapely.MultiLineString()
    at_m = np.arange(0.5 * _EVERY_M, max(line.length, _EVERY_M), _EVERY_M)
    here, ahead = (
        shapely.get_coordinates(shapely.line_interpolate_point(line, at_m + step))
        for step in (-0.1, 0.1)
    )
    along = (ahead - here) / np.maximum(np.linalg.norm(ahead - here, axis=1, keepdims=True), 1e-9)
    rays = shapely.linestrings(
        np.stack([here, here + _ACROSS_M * np.column_stack([-along[:, 1], along[:, 0]])], axis=1)
    )
    hits = shapely.intersection(rays, kerb)
    # A ray that meets nothing has no such point.
    first = shapely.get_point(shapely.shortest_line(hits, shapely.points(here)), 0)
    return kerb.intersection(shapely.union_all(first).buffer(0.6 * _EVERY_M))


def _lips_m(
    mouths: list[BaseGeometry],
    sides: list[tuple[BaseGeometry, float]],
    marks: Iterable[KerbMark],
    top_m: float,
    drop_m: float,
) -> list[float]:
    """Height of the kerb at each mouth of a crossing: what is mapped nearest decides."""
    # 1. A street's kerb is nearer than what the town says.
    lips_m = [drop_m] * len(mouths)
    tree = shapely.STRtree(mouths)
    for lines, lip_m in sides:
        for number in tree.query(lines, predicate="dwithin", distance=NEAR_M).tolist():
            lips_m[number] = lip_m

    # 2. So is what the crossing itself says.
    for mark in marks:
        if mark.crossing:
            for number in _both_ends(mark, mouths, tree):
                lips_m[number] = mark.height_m

    # 3. A kerb beside it is nearest. A raised one farther away to the side is that of the street.
    near = [mark for mark in marks if not mark.side and not mark.crossing]
    if not near or not mouths:
        return lips_m
    (which, found), far_m = shapely.STRtree([mark.line for mark in near]).query_nearest(
        mouths, max_distance=_AT_CROSSING_M, return_distance=True, all_matches=False
    )
    for i, k, gap_m in zip(which.tolist(), found.tolist(), far_m.tolist(), strict=True):
        mouth, mark = mouths[i], near[k]
        along_m = mouth.project(shapely.shortest_line(mouth, mark.line).interpolate(0.0))
        ahead = _AHEAD_M < along_m < mouth.length - _AHEAD_M
        if gap_m <= NEAR_M or ahead or mark.height_m < top_m:
            lips_m[i] = mark.height_m
    return lips_m


def _both_ends(mark: KerbMark, mouths: list[BaseGeometry], tree: shapely.STRtree) -> list[int]:
    """The nearest mouth of a mapped crossing, and that as far away on the other side."""
    nearest = tree.query_nearest(mark.line, max_distance=_NODE_M, all_matches=False)
    if not len(nearest):
        return []
    number = int(nearest[0])
    end = shapely.shortest_line(mouths[number], mark.line)
    other = shapely.affinity.rotate(end, 180.0, origin=mark.line.centroid).interpolate(0.0)
    reach_m = max(_AT_CROSSING_M, end.length)
    across = tree.query_nearest(other, max_distance=reach_m, all_matches=False)
    return [number, *across.tolist()]


def _lines(geometry: BaseGeometry) -> list[BaseGeometry]:
    """The lines of a geometry, crumbs left out."""
    lines = [part for part in shapely.get_parts(geometry) if part.geom_type == "LineString"]
    return [line for line in lines if line.length > 0.1]
