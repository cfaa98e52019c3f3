"""What fills the blocks between streets: houses along the pavement, parks, squares and car parks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.towns.furniture.placement import Taken
from wcsim.towns.ground.solid_shapes import rectangle
from wcsim.towns.ground.surfaces import MARGIN_M, lane_area
from wcsim.towns.sumo.net import Net
from wcsim.types import F64

_LEAST_BLOCK_M2 = 250.0
_OUTER_M = 20.0  # beyond the ground: houses at the rim are cut off where it ends
_STEP_M = 2.0  # along a front, to the next place that may be free
_SHORTEST_FRONT_M = 7.0
_CAR_PARK_M = 5.2  # deep: one row of cars across
_CAR_PARK_GAP_M = 0.6  # from the pavement
_LEAST_PARKING_M = 24.0  # of a front, for a row of cars
_HEDGED_M = 2.0  # from the pavement to houses that have a hedge, or more
_CAR_PARK_REACH_M = 22.0  # from the middle of a car park that is a block of its own, or a part of one
_LARGEST_SQUARE_M2 = 6000.0  # a larger block is a park
_MOST_CAR_PARKS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class _Style:
    """How a block is built up; ranges are drawn from for each house."""

    setback_m: tuple[float, float]  # from the pavement, one draw for a block
    front_m: tuple[float, float]
    depth_m: tuple[float, float]
    gap_m: tuple[float, float]
    levels: tuple[int, int]
    green: bool  # gardens, not yards


_STYLES = {
    "perimeter": _Style(
        setback_m=(0.3, 0.8), front_m=(12.0, 28.0), depth_m=(10.0, 14.0), gap_m=(0.0, 0.0), levels=(3, 7), green=False
    ),
    "rows": _Style(
        setback_m=(1.5, 5.0), front_m=(18.0, 45.0), depth_m=(9.0, 13.0), gap_m=(4.0, 14.0), levels=(2, 5), green=True
    ),
    "detached": _Style(
        setback_m=(3.0, 7.0), front_m=(8.0, 14.0), depth_m=(7.0, 12.0), gap_m=(5.0, 12.0), levels=(1, 3), green=True
    ),
}
_OPEN = ("park", "square", "car_park")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plot:
    """A block that is being built up."""

    block: Polygon
    inner: BaseGeometry  # where houses may stand
    style: _Style
    setback_m: float
    taken: Taken


@dataclass(frozen=True, slots=True, kw_only=True)
class House:
    """One building."""

    outline: Polygon
    levels: int


@dataclass(slots=True, kw_only=True)
class Blocks:
    """What stands and lies between a town's streets, in net coordinates."""

    houses: list[House] = field(default_factory=list)
    greens: list[tuple[str, Polygon]] = field(default_factory=list)  # SUMO's type, and outline
    squares: list[Polygon] = field(default_factory=list)
    car_parks: list[Polygon] = field(default_factory=list)
    hedges: list[tuple[str, F64]] = field(default_factory=list)  # kind, and line (K, 2)


def build_blocks(net: Net, rng: np.random.Generator) -> Blocks:
    """Fill the blocks of a net; no house stands on a street, and none on another."""
    streets = _street_area(net)
    hull = streets.convex_hull.buffer(MARGIN_M + _OUTER_M, quad_segs=2)
    shapely.prepare(hull)
    styles = rng.dirichlet((1.2, 1.0, 1.0))
    open_share = rng.uniform(0.08, 0.25)
    found = Blocks()
    parts = [part for part in shapely.get_parts(hull.difference(streets)) if part.geom_type == "Polygon"]
    for block in sorted(parts, key=lambda part: tuple(np.round(part.bounds, 1).tolist())):
        if block.area < _LEAST_BLOCK_M2:
            continue
        rim = block.exterior.distance(hull.exterior) < 0.1
        if not rim and rng.random() < open_share:
            use = str(rng.choice(_OPEN))
            _leave_open(block, "park" if use == "square" and block.area > _LARGEST_SQUARE_M2 else use, found)
        else:
            _build_up(block, streets, _STYLES[str(rng.choice(list(_STYLES), p=styles))], found, rng)
    return found


def _street_area(net: Net) -> BaseGeometry:
    """Everything between the outer edges of all pavements."""
    lanes = [lane_area(lane) for edge in net.edges for lane in edge.lanes]
    junctions = [shapely.make_valid(Polygon(j.outline_m)) for j in net.junctions if len(j.outline_m) > 2]
    whole: BaseGeometry = shapely.union_all([*lanes, *junctions]).buffer(0.4, quad_segs=2).buffer(-0.4, quad_segs=2)
    return shapely.set_precision(whole, 0.01)


def _leave_open(block: Polygon, use: str, found: Blocks) -> None:
    inner = _largest(block.buffer(-1.0, join_style="mitre"))
    if use == "park":
        found.greens.append(("leisure.park", inner))
    elif use == "square":
        found.squares.append(_largest(block.buffer(-0.05, join_style="mitre")))
    else:
        inner = _largest(block.buffer(-1.5, join_style="mitre"))
        lot = _largest(inner.intersection(_near_front(inner).buffer(_CAR_PARK_REACH_M, cap_style="square")))
        found.car_parks.append(lot)
        rest = _largest(block.buffer(-0.3).difference(lot.buffer(1.0, join_style="mitre")))
        if rest.area > _LEAST_BLOCK_M2:
            found.greens.append(("landuse.grass", rest))


def _near_front(inner: Polygon) -> shapely.Point:
    """A point inside an area, so near to its edge that a car park about it lies at the street."""
    way = shapely.shortest_line(inner.exterior, inner.representative_point())
    return way.interpolate(min(0.7 * _CAR_PARK_REACH_M, way.length))


def _build_up(block: Polygon, streets: BaseGeometry, style: _Style, found: Blocks, rng: np.random.Generator) -> None:
    """Houses along all fronts of a block that lie at a street, some with a row of parked cars before them."""
    setback_m = float(rng.uniform(*style.setback_m))
    inner = block.buffer(-setback_m + 0.05, join_style="mitre", mitre_limit=2.0)
    shapely.prepare(inner)
    plot = _Plot(block=block, inner=inner, style=style, setback_m=setback_m, taken=Taken())
    if style.green and not block.interiors:
        ground = _largest(block.buffer(-0.3))
        if not ground.is_empty:
            found.greens.append(("landuse.grass", ground))
    for start, end in _fronts(block, setback_m, streets):
        length_m = float(np.hypot(*(end - start)))
        cars = rng.random() < (0.12 if style.green else 0.04)
        parks = cars and length_m > _LEAST_PARKING_M and len(found.car_parks) < _MOST_CAR_PARKS
        if parks:
            _car_park(plot, start, end, found)
        _houses(plot, start, end, found, rng)
        if style.green and not parks and setback_m > _HEDGED_M and rng.random() < 0.5:
            along = (end - start) / length_m
            line_m = np.array([start, end]) - 0.7 * (setback_m - 0.4) * np.array([-along[1], along[0]])
            found.hedges.append((str(rng.choice(["hedge", "fence", "wall"])), line_m))


def _houses(plot: _Plot, start: F64, end: F64, found: Blocks, rng: np.random.Generator) -> None:
    """Houses along one front, each where there is room."""
    length_m, at_m = float(np.hypot(*(end - start))), 0.0
    along = (end - start) / length_m
    while at_m < length_m - _SHORTEST_FRONT_M:
        front_m = min(float(rng.uniform(*plot.style.front_m)), length_m - at_m)
        size_m = (front_m, float(rng.uniform(*plot.style.depth_m)))
        outline = _rectangle(start + at_m * along, along, size_m)
        if plot.inner.contains(outline) and plot.taken.free(outline.buffer(-0.02)):
            plot.taken.add(outline)
            found.houses.append(House(outline=outline, levels=int(rng.integers(*plot.style.levels, endpoint=True))))
            at_m += front_m + float(rng.uniform(*plot.style.gap_m))
        else:
            at_m += _STEP_M


def _car_park(plot: _Plot, start: F64, end: F64, found: Blocks) -> None:
    """A row of cars between the pavement and where houses would be."""
    length_m = float(np.hypot(*(end - start)))
    along = (end - start) / length_m
    back = np.array([-along[1], along[0]])
    corner = start + 2.0 * along - (plot.setback_m - _CAR_PARK_GAP_M) * back
    outline = _rectangle(corner, along, (min(length_m - 4.0, 40.0), _CAR_PARK_M))
    if plot.block.contains(outline) and plot.taken.free(outline):
        plot.taken.add(outline.buffer(1.0))
        found.car_parks.append(outline)


def _fronts(block: Polygon, setback_m: float, streets: BaseGeometry) -> Iterator[tuple[F64, F64]]:
    """Straight fronts at the street, inside of the block to their left, the longest first."""
    inset = shapely.orient_polygons(_largest(block.buffer(-setback_m, join_style="mitre", mitre_limit=2.0)))
    rings = [shapely.get_coordinates(ring.simplify(0.5)) for ring in (inset.exterior, *inset.interiors)]
    pairs = [(ring[k], ring[k + 1]) for ring in rings for k in range(len(ring) - 1)]
    for start, end in sorted(pairs, key=lambda pair: -float(np.hypot(*(pair[1] - pair[0])))):
        middle = shapely.Point(0.5 * (start + end))
        if np.hypot(*(end - start)) > _SHORTEST_FRONT_M and streets.distance(middle) < setback_m + 1.5:
            yield start, end


def _rectangle(corner: F64, along: F64, size_m: tuple[float, float]) -> Polygon:
    """A rectangle with its front from `corner` along a way, to the left of it."""
    back = np.array([-along[1], along[0]])
    middle = corner + 0.5 * size_m[0] * along + 0.5 * size_m[1] * back
    return rectangle(middle, size_m[0], size_m[1], float(np.arctan2(along[1], along[0])))


def _largest(area: BaseGeometry) -> Polygon:
    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    return max(parts, key=lambda part: float(part.area), default=Polygon())
