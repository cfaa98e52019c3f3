"""How high kerbs stand, and where they are lowered: at crossings, and where OpenStreetMap says so."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.plane_geometry import Patches, buffered
from wcsim.towns.ground.surfaces import GRID_M, Surfaces
from wcsim.towns.sumo.additional import Item
from wcsim.types import F64

_RAMP_RUN = 12.6  # metres of ramp for one metre of height: 1:12 also where a ring cuts a corner
STEEPEST = 1.0 / 12.0
_RING_CHORD = 0.96  # the chords of a ring come this close to the middle of its arc
NEAR_M = 1.5  # a kerb that is mapped this far from ours is the same one
_AT_CROSSING_M = 3.0  # ... at a crossing, where there is no other: SUMO's roads are not as wide as the real ones
HALF_WIDTH_M = 0.75  # of a lowered place that is mapped as a point
RAISED = -1.0
_LIP_M = {"flush": 0.0, "lowered": 0.02, "rolled": 0.03, "sloped": 0.03, "raised": RAISED, "regular": RAISED}


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
        """Height (n,) of raised ground at (n, 2): every ramp rises at the same grade, and the lowest one counts."""
        height_m = np.full(len(xy_m), self.top_m)
        places = shapely.points(xy_m)
        for low in self.lowered:
            (index, _), far_m = low.tree.query_nearest(
                places, max_distance=low.ramp_m, return_distance=True, all_matches=False
            )
            share = np.clip(far_m / (_RING_CHORD * low.ramp_m), 0.0, 1.0)
            height_m[index] = np.minimum(height_m[index], low.drop_m + (self.top_m - low.drop_m) * share)
        rounded: F64 = np.round(height_m, 5)
        return rounded


def make_kerbing(surfaces: Surfaces, top_m: float, drop_m: float, items: Iterable[Item] = ()) -> Kerbing:
    """Kerbs are lowered where the edge of a crossing touches pavement, and where they are mapped as lowered.

    A crossing whose kerb is mapped as raised keeps it.
    """
    bank = buffered(surfaces.pavement, 2 * GRID_M)
    edge = _lines(surfaces.crossing.boundary.intersection(bank))
    mouths = _lines(shapely.line_merge(shapely.MultiLineString(edge)))
    marks = _marks(items)
    lips_m = _nearest_lips(mouths, marks, drop_m)
    groups: dict[float, list[BaseGeometry]] = {}
    for line, lip_m in [*zip(mouths, lips_m, strict=True), *_elsewhere(surfaces, bank, marks)]:
        if RAISED < lip_m < top_m:
            groups.setdefault(lip_m, []).append(line)
    lowered = tuple(
        _Lowered(
            drop_m=lip_m,
            ramp_m=_RAMP_RUN * (top_m - lip_m),
            lines=shapely.MultiLineString(groups[lip_m]),
            tree=shapely.STRtree(groups[lip_m]),
        )
        for lip_m in sorted(groups)
    )
    return Kerbing(top_m=top_m, lowered=lowered)


def _marks(items: Iterable[Item]) -> list[tuple[BaseGeometry, float]]:
    """Places and heights of all kerbs that are mapped; many are there twice, as a barrier and as a kerb."""
    found: dict[bytes, tuple[BaseGeometry, float]] = {}
    for item in items:
        lip_m = _lip_m(item)
        if lip_m is not None and len(item.points_W_m):
            points = item.points_W_m
            mark = shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0])
            found.setdefault(points.tobytes(), (mark, lip_m))
    return list(found.values())


def _lip_m(item: Item) -> float | None:
    """Height of a mapped kerb, `RAISED` for one that is not lowered, or None for what is no kerb."""
    if item.group == "kerb":
        return _LIP_M.get(item.detail)
    if item.group == "barrier" and item.detail == "kerb":
        return _LIP_M.get(item.tags.get("kerb", ""))
    return None


def _nearest_lips(mouths: list[BaseGeometry], marks: list[tuple[BaseGeometry, float]], drop_m: float) -> list[float]:
    """Height of the kerb at each mouth of a crossing: as its nearest mark says, else the town's own."""
    lips_m = [drop_m] * len(mouths)
    if marks and mouths:
        tree = shapely.STRtree([mark for mark, _ in marks])
        (which, mark), far_m = tree.query_nearest(
            mouths, max_distance=_AT_CROSSING_M, return_distance=True, all_matches=False
        )
        for i, k, gap_m in zip(which.tolist(), mark.tolist(), far_m.tolist(), strict=True):
            if gap_m <= NEAR_M or marks[k][1] != RAISED:
                lips_m[i] = marks[k][1]
    return lips_m


def _elsewhere(
    surfaces: Surfaces, bank: BaseGeometry, marks: list[tuple[BaseGeometry, float]]
) -> list[tuple[BaseGeometry, float]]:
    """Stretches of kerb between road and pavement that are mapped as lowered."""
    lowered = [(mark, lip_m) for mark, lip_m in marks if lip_m != RAISED]
    if not lowered:
        return []
    edges, banks = Patches(surfaces.low.boundary), Patches(bank)
    found: list[tuple[BaseGeometry, float]] = []
    for mark, lip_m in lowered:
        near = mark.buffer(NEAR_M)
        edge = edges.near(near.bounds).intersection(banks.near(near.bounds))
        if mark.geom_type == "Point" and not edge.is_empty and shapely.dwithin(edge, mark, NEAR_M):
            near = shapely.shortest_line(edge, mark).interpolate(0.0).buffer(HALF_WIDTH_M)
        found += [(line, lip_m) for line in _lines(edge.intersection(near))]
    return found


def _lines(geometry: BaseGeometry) -> list[BaseGeometry]:
    """The lines of a geometry, crumbs left out."""
    return [part for part in shapely.get_parts(geometry) if part.geom_type == "LineString" and part.length > 0.1]
