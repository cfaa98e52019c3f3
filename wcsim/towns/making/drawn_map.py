"""What a map would hold of a made town, in the files that polyconvert would write of one.

Houses along the pavement, parks, squares and car parks fill the blocks between streets. Trees,
lamps, benches, signs and stops stand along the pavements, and things that were left in the way.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.core.reading import read_module_toml
from wcsim.towns.furniture.placement import Taken
from wcsim.towns.ground.plane_geometry import left_of, polygons_of, unit, yaw_of
from wcsim.towns.ground.solid_shapes import rectangle
from wcsim.towns.ground.surfaces import MARGIN_M, lane_area
from wcsim.towns.sumo.net import LaneKind, Net
from wcsim.types import F64

_DATA = read_module_toml(__file__)

# Along the pavements.
_ENDS_M = 5.0  # at both ends of a pavement nothing stands: people wait and turn there
_KERB_M = 0.35  # from the kerb to the middle of a post
_IN_WAY_M = 2.4  # nothing is left on narrower ones
_WALL_M = 0.45  # from the inner edge of a pavement
_STOP_EVERY_M = 180.0
_STOP_LANE_M = 40.0
_LEFT = ("board", "bin", "scooter", "bicycle", "box", "planter", "table")

# In the blocks.
_LEAST_BLOCK_M2 = 250.0
_OUTER_M = 20.0  # beyond the ground: houses at the rim are cut off where it ends
_STEP_M = 2.0  # along a front, to the next place that may be free
_SHORTEST_FRONT_M = 7.0
_CAR_PARK_M = 5.2  # deep: one row of cars across
_CAR_PARK_GAP_M = 0.6  # from the pavement
_LEAST_PARKING_M = 24.0  # of a front, for a row of cars
_HEDGED_M = 2.0  # from the pavement to houses that have a hedge, or more
# From the middle of a car park that is a block of its own, or a part of one.
_CAR_PARK_REACH_M = 22.0
_LARGEST_SQUARE_M2 = 6000.0  # a larger block is a park
_MOST_CAR_PARKS = 8
_GARDEN_M2 = 400.0  # a garden that is smaller has no trees
_OPEN = ("park", "square", "car_park")
_KERBS = ("flush", "lowered", "rolled", "sloped", "raised")
_KERB_SHARES = (0.4, 0.35, 0.1, 0.05, 0.1)
_COLOURS = {
    "building": "0.85,0.80,0.75",
    "natural": "0.2,0.6,0.2",
    "landuse": "0.6,0.8,0.6",
    "leisure": "0.6,0.8,0.6",
}

_Mapped = list[tuple[str, F64]]
"""SUMO's types and places (2,) of things that give way where there is no room."""
_Placed = list[tuple[str, F64, float]]
"""Those of things that stand where they are, with their angle in degrees."""
_Pairs = list[tuple[str, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """Things of a kind in a row along pavements."""

    kinds: tuple[str, ...]
    every_m: tuple[float, float]
    share: float  # of the pavements have it
    at_kerb: bool
    least_m: float  # width of a pavement that has it


_ROWS = [_Row(**row) for row in _DATA["rows"]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Style:
    """How a block is built up; ranges are drawn from for each house."""

    setback_m: tuple[float, float]  # from the pavement, one draw for a block
    front_m: tuple[float, float]
    depth_m: tuple[float, float]
    gap_m: tuple[float, float]
    levels: tuple[int, int]
    green: bool  # gardens, not yards


_STYLES = {name: _Style(**style) for name, style in _DATA["styles"].items()}


@dataclass(slots=True, kw_only=True)
class _Blocks:
    """What stands and lies between a town's streets, in net coordinates."""

    houses: list[tuple[Polygon, int]] = field(default_factory=list)  # outline, and levels
    greens: list[tuple[str, Polygon]] = field(default_factory=list)  # SUMO's type, and outline
    squares: list[Polygon] = field(default_factory=list)
    car_parks: list[Polygon] = field(default_factory=list)
    hedges: list[tuple[str, F64]] = field(default_factory=list)  # kind, and line (K, 2)


def draw_map(
    net: Net, name: str, folder: Path, rng: np.random.Generator
) -> tuple[Path, Path, tuple[str, ...]]:
    """Write <name>.poly.xml and <name>.ground.xml of a net into `folder`.

    Returns:
        Both files, and elements for the town's additional file: what stands exactly where it is
        placed.
    """
    # 1. Draw what there is.
    blocks, (mapped, placed) = _build_blocks(net, rng), _dress(net, rng)
    poly, ground = _Writer(), _Writer()

    # 2. Write the blocks: houses, gardens and parks, squares, car parks, hedges.
    for outline, levels in blocks.houses:
        poly.area("building.yes", outline, [("building", "yes"), ("building:levels", str(levels))])
    houses = [outline for outline, _ in blocks.houses]
    used = shapely.union_all([*houses, *blocks.car_parks]).buffer(1.5, quad_segs=1)
    for kind, green in blocks.greens:
        poly.area(kind, green, [])
        free = green.difference(used)
        if free.area > _GARDEN_M2:
            for thing, xy_m in _park_things(free, rng):
                poly.point(thing, xy_m, [])
    for square in blocks.squares:
        ground.area("place.square", square, [])
        for thing, xy_m in _park_things(square, rng):
            poly.point(thing.replace("natural.shrub", "man_made.flagpole"), xy_m, [])
    for lot in blocks.car_parks:
        poly.area("amenity.parking", lot, [("parking", "surface")])
    for kind, line_m in blocks.hedges:
        poly.line(f"barrier.{kind}", line_m)

    # 3. Write what stands along the pavements.
    for kind, xy_m in mapped:
        poly.point(kind, xy_m, [])

    # 4. Write paint and kerbs of the crossings.
    _write_crossings(net, poly, ground, rng)

    paths = folder / f"{name}.poly.xml", folder / f"{name}.ground.xml"
    for writer, path in zip((poly, ground), paths, strict=True):
        path.write_text(writer.text(), encoding="utf-8")
    left = []
    for number, (kind, xy_m, angle_deg) in enumerate(placed):
        place = f'x="{xy_m[0]:.2f}" y="{xy_m[1]:.2f}" angle="{angle_deg:.1f}"'
        left.append(f'<poi id="left.{number}" type="{kind}" {place}/>')
    return *paths, tuple(left)


def _build_blocks(net: Net, rng: np.random.Generator) -> _Blocks:
    """Fill the blocks of a net; no house stands on a street, and none on another."""
    # 1. Streets reach to the outer edges of the pavements.
    lanes = [lane_area(lane) for lane in net.every_lane]
    outlines = [junction.outline_m for junction in net.junctions if len(junction.outline_m) > 2]
    junctions = [shapely.make_valid(Polygon(outline_m)) for outline_m in outlines]
    whole = shapely.union_all([*lanes, *junctions])
    whole = whole.buffer(0.4, quad_segs=2).buffer(-0.4, quad_segs=2)
    streets = shapely.set_precision(whole, 0.01)
    # 2. Draw for each block whether it is built up, and how.
    hull = streets.convex_hull.buffer(MARGIN_M + _OUTER_M, quad_segs=2)
    shapely.prepare(hull)
    shares = rng.dirichlet((1.2, 1.0, 1.0))
    open_share = rng.uniform(0.08, 0.25)
    found = _Blocks()
    parts = polygons_of(hull.difference(streets), _LEAST_BLOCK_M2)
    for block in sorted(parts, key=lambda part: tuple(np.round(part.bounds, 1).tolist())):
        rim = block.exterior.distance(hull.exterior) < 0.1
        if not rim and rng.random() < open_share:
            use = str(rng.choice(_OPEN))
            is_large = use == "square" and block.area > _LARGEST_SQUARE_M2
            _leave_open(block, "park" if is_large else use, found)
        else:
            style = _STYLES[str(rng.choice(list(_STYLES), p=shares))]
            _build_up(block, streets, style, found, rng)
    return found


def _leave_open(block: Polygon, use: str, found: _Blocks) -> None:
    if use == "square":
        found.squares.append(_largest(block.buffer(-0.05, join_style="mitre")))
        return
    # A narrow block has no ground so far from its streets.
    inner = _largest(block.buffer(-1.0 if use == "park" else -1.5, join_style="mitre"))
    if inner.is_empty:
        return
    if use == "park":
        found.greens.append(("leisure.park", inner))
        return
    # A car park lies at the street: its middle is near to the edge.
    way = shapely.shortest_line(inner.exterior, inner.representative_point())
    middle = way.interpolate(min(0.7 * _CAR_PARK_REACH_M, way.length))
    reach = middle.buffer(_CAR_PARK_REACH_M, cap_style="square")
    lot = _largest(inner.intersection(reach))
    found.car_parks.append(lot)
    rest = _largest(block.buffer(-0.3).difference(lot.buffer(1.0, join_style="mitre")))
    if rest.area > _LEAST_BLOCK_M2:
        found.greens.append(("landuse.grass", rest))


def _build_up(
    block: Polygon,
    streets: BaseGeometry,
    style: _Style,
    found: _Blocks,
    rng: np.random.Generator,
) -> None:
    """Houses along all fronts of a block at a street, some with a row of cars before them."""
    setback_m = rng.uniform(*style.setback_m)
    inner = block.buffer(-setback_m + 0.05, join_style="mitre", mitre_limit=2.0)
    shapely.prepare(inner)
    taken = Taken()
    if style.green and not block.interiors:
        ground = _largest(block.buffer(-0.3))
        if not ground.is_empty:
            found.greens.append(("landuse.grass", ground))
    for start, end in _fronts(block, setback_m, streets):
        length_m = float(np.hypot(*(end - start)))
        along = (end - start) / length_m
        # 1. Cars between the pavement and where houses would be.
        cars = rng.random() < (0.12 if style.green else 0.04)
        parks = cars and length_m > _LEAST_PARKING_M and len(found.car_parks) < _MOST_CAR_PARKS
        if parks:
            corner = start + 2.0 * along - (setback_m - _CAR_PARK_GAP_M) * left_of(along)
            lot = _rectangle(corner, along, (min(length_m - 4.0, 40.0), _CAR_PARK_M))
            if block.contains(lot) and taken.free(lot):
                taken.add(lot.buffer(1.0))
                found.car_parks.append(lot)
        # 2. Houses.
        found.houses += _houses_along((start, end), inner, style, taken, rng)
        # 3. A hedge before the gardens.
        if style.green and not parks and setback_m > _HEDGED_M and rng.random() < 0.5:
            line_m = np.array([start, end]) - 0.7 * (setback_m - 0.4) * left_of(along)
            found.hedges.append((str(rng.choice(["hedge", "fence", "wall"])), line_m))


def _fronts(block: Polygon, setback_m: float, streets: BaseGeometry) -> Iterator[tuple[F64, F64]]:
    """Straight fronts at the street, inside of the block to their left, the longest first."""
    inner = block.buffer(-setback_m, join_style="mitre", mitre_limit=2.0)
    inset = shapely.orient_polygons(_largest(inner))
    rings = [
        shapely.get_coordinates(ring.simplify(0.5)) for ring in (inset.exterior, *inset.interiors)
    ]
    pairs = [(ring[k], ring[k + 1]) for ring in rings for k in range(len(ring) - 1)]
    for start, end in sorted(pairs, key=lambda pair: -float(np.hypot(*(pair[1] - pair[0])))):
        middle = shapely.Point(0.5 * (start + end))
        if (
            np.hypot(*(end - start)) > _SHORTEST_FRONT_M
            and streets.distance(middle) < setback_m + 1.5
        ):
            yield start, end


def _houses_along(
    front: tuple[F64, F64],
    inner: BaseGeometry,
    style: _Style,
    taken: Taken,
    rng: np.random.Generator,
) -> list[tuple[Polygon, int]]:
    """Houses along a front, with their levels, each where there is room in `inner`."""
    start, end = front
    length_m = float(np.hypot(*(end - start)))
    along = (end - start) / length_m
    houses, at_m = [], 0.0
    while at_m < length_m - _SHORTEST_FRONT_M:
        front_m = min(rng.uniform(*style.front_m), length_m - at_m)
        size_m = (front_m, rng.uniform(*style.depth_m))
        house = _rectangle(start + at_m * along, along, size_m)
        if inner.contains(house) and taken.free(house.buffer(-0.02)):
            taken.add(house)
            houses.append((house, int(rng.integers(*style.levels, endpoint=True))))
            at_m += front_m + rng.uniform(*style.gap_m)
        else:
            at_m += _STEP_M
    return houses


def _rectangle(corner: F64, along: F64, size_m: tuple[float, float]) -> Polygon:
    """A rectangle with its front from `corner` along a way, to the left of it."""
    middle = corner + 0.5 * size_m[0] * along + 0.5 * size_m[1] * left_of(along)
    return rectangle(middle, *size_m, yaw_of(along))


def _largest(area: BaseGeometry) -> Polygon:
    return max(polygons_of(area), key=lambda part: part.area, default=Polygon())


def _dress(net: Net, rng: np.random.Generator) -> tuple[_Mapped, _Placed]:
    """Things along all pavements of a net, drawn for each pavement."""
    mapped: _Mapped = []
    placed: _Placed = []
    left_per_m = float(rng.uniform(0.0, 0.02))
    since_stop_m = rng.uniform(0.0, _STOP_EVERY_M)
    kerb = -1.0 if net.lefthand else 1.0
    pavements = [
        (lane, edge.lanes[-1].kind is LaneKind.MOTOR)
        for edge in net.streets
        for lane in edge.lanes
        if lane.kind in (LaneKind.SIDEWALK, LaneKind.SHARED) and lane.is_line
    ]
    for lane, has_motors in pavements:
        line = shapely.LineString(lane.points_m)
        # 1. Things in rows, at the kerb or at the wall.
        mapped += _rows_along(line, lane.width_m, kerb, rng)
        # 2. Things left on a wide pavement, off its middle: a chair must go round them.
        number = int(rng.poisson(left_per_m * max(0.0, line.length - 2.0 * _ENDS_M)))
        ends_m = _ENDS_M, max(_ENDS_M, line.length - _ENDS_M)
        for along_m in np.sort(rng.uniform(*ends_m, number)).tolist():
            side, kind = float(rng.choice((-1.0, 1.0))), str(rng.choice(_LEFT))
            reach_m = rng.uniform(0.5, 1.0) * (0.5 * lane.width_m - 0.4)
            xy_m, angle_deg = _beside(line, along_m, side * reach_m)
            if lane.width_m >= _IN_WAY_M:
                placed.append((f"wcsim.{kind}", xy_m, angle_deg))
        # 3. A stop for buses, far enough from the last one.
        since_stop_m += line.length
        if has_motors and line.length > _STOP_LANE_M and since_stop_m > _STOP_EVERY_M:
            mapped.append(("highway.bus_stop", _beside(line, 0.5 * line.length, 0.0)[0]))
            since_stop_m = 0.0
    return mapped, placed


def _rows_along(
    line: shapely.LineString, width_m: float, kerb: float, rng: np.random.Generator
) -> _Mapped:
    """Things in rows on a pavement that has its kerb to the left (1.0) or to the right (-1.0)."""
    things: _Mapped = []
    for row in _ROWS:
        has, every_m = rng.random() < row.share, rng.uniform(*row.every_m)
        if not has or width_m < row.least_m:
            continue
        aside_m = 0.5 * width_m - (_KERB_M if row.at_kerb else _WALL_M)
        left_m = kerb * (aside_m if row.at_kerb else -aside_m)
        at_m = _ENDS_M + rng.uniform(0.0, 0.5 * every_m)
        while at_m < line.length - _ENDS_M:
            things.append((str(rng.choice(row.kinds)), _beside(line, at_m, left_m)[0]))
            at_m += every_m
    return things


def _beside(line: shapely.LineString, along_m: float, left_m: float) -> tuple[F64, float]:
    """The place (2,) at a length along a line, so far to its left, and SUMO's angle in degrees."""
    here, ahead = (
        shapely.get_coordinates(line.interpolate(min(max(s_m, 0.0), line.length)))[0]
        for s_m in (along_m - 0.1, along_m + 0.1)
    )
    way = unit(ahead - here)
    place = 0.5 * (here + ahead) + left_m * left_of(way)
    return place, float(np.degrees(np.arctan2(way[0], way[1])) % 360.0)


def _park_things(park: shapely.Polygon, rng: np.random.Generator) -> Iterator[tuple[str, F64]]:
    """Trees, shrubs and benches in a park, of a square or in a garden."""
    x0, y0, x1, y1 = park.bounds
    inner = park.buffer(-2.0)
    number = int(min(150.0, park.area / 70.0))
    for xy_m in rng.uniform((x0, y0), (x1, y1), (number, 2)):
        kind = str(rng.choice(["natural.tree", "natural.tree", "natural.shrub", "amenity.bench"]))
        if inner.contains(shapely.Point(xy_m)):
            yield kind, xy_m


class _Writer:
    """Collects the elements of an additional file."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def point(self, kind: str, xy_m: F64, tags: _Pairs) -> None:
        """Add a point (2,)."""
        self._add("poi", kind, f'x="{xy_m[0]:.2f}" y="{xy_m[1]:.2f}" layer="1"', tags)

    def area(self, kind: str, outline: Polygon, tags: _Pairs) -> None:
        """Add an outline; its holes are left out."""
        self._shape(kind, shapely.get_coordinates(outline.exterior), tags, "1")

    def line(self, kind: str, points_m: F64) -> None:
        """Add a line (K, 2)."""
        self._shape(kind, points_m, [], "0")

    def text(self) -> str:
        """The file."""
        return "\n".join(["<additional>", *self._lines, "</additional>", ""])

    def _shape(self, kind: str, points_m: F64, tags: _Pairs, fill: str) -> None:
        shape = " ".join(f"{x:.2f},{y:.2f}" for x, y in points_m.tolist())
        self._add("poly", kind, f'fill="{fill}" layer="-1" shape="{shape}"', tags)

    def _add(self, tag: str, kind: str, more: str, tags: _Pairs) -> None:
        colour = _COLOURS.get(kind.partition(".")[0], "0.5,0.5,0.5")
        head = f'    <{tag} id="m{len(self._lines)}" type="{kind}" color="{colour}" {more}'
        params = (f"<param key={quoteattr(key)} value={quoteattr(value)}/>" for key, value in tags)
        inner = "".join(params)
        self._lines.append(f"{head}>{inner}</{tag}>" if inner else f"{head}/>")


def _write_crossings(net: Net, poly: _Writer, ground: _Writer, rng: np.random.Generator) -> None:
    """Paint and kerbs of all crossings: at signals they are painted, and no kerb is high."""
    lit = net.signalled()
    painted = rng.uniform(0.3, 1.0)
    for lane in net.lanes(LaneKind.CROSSING):
        if not lane.is_line:
            continue
        is_lit = lane.edge_id in lit
        middle = shapely.LineString(lane.points_m).interpolate(0.5, normalized=True)
        drawn = rng.random() < painted
        tags = [("crossing", "marked" if drawn or is_lit else "unmarked")]
        ground.point("highway.crossing", shapely.get_coordinates(middle)[0], tags)
        kerb = str(rng.choice(_KERBS, p=_KERB_SHARES))
        for end_m in (lane.points_m[0], lane.points_m[-1]):
            poly.point(f"kerb.{'lowered' if kerb == 'raised' and is_lit else kerb}", end_m, [])
