"""Buildings: footprints cleared of the street, with heights from tags, or from a seed."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.core.reading import read_module_toml
from wcsim.core.seeding import make_rng
from wcsim.towns.ground.plane_geometry import Patches, buffered, polygons_of, valid
from wcsim.towns.osm.tags import STOREY_M, metres, number, rise_m
from wcsim.towns.sumo.additional import Item

GAP_M = 0.1  # between a wall and walkable ground or road
_SMALLEST_M2 = 3.0
_STANDS_M = 2.0  # what begins above this lets people pass below
PASSAGE_M = 4.2  # free height of a passage through a house: buses and trams fit
# A building covered to this share by its parts has no body of its own, unless more than the other
# share of it would hang in the air.
_MODELLED = 0.8
_OPEN_BELOW = 0.35
_HELD = 0.5  # what lies on other bodies to this share stands on them
_KINDS = {name: words.split() for name, words in read_module_toml(__file__).items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Building:
    """One block with vertical walls and a flat roof; heights are above the ground."""

    outline: Polygon
    height_m: float
    low_m: float = 0.0  # where it begins: above 0 for what hangs over the street


@dataclass(frozen=True, slots=True, kw_only=True)
class _Body:
    """One mapped outline."""

    area: BaseGeometry
    rise_m: float
    height_m: float
    part: bool


def make_buildings(
    items: list[Item], street: BaseGeometry, hull: BaseGeometry
) -> tuple[list[Building], list[Building]]:
    """Buildings beside the street, and those over it: skywalks, and houses over a passage.

    What stands on the street (arcades, passages) or outside the town is cut off.
    """
    # 1. Tell what stands from what starts on an upper floor.
    solid, raised = _composed(_hollowed(*_outlines(items, hull)))

    # 2. Clear what stands of the street. No ground is taken twice: what comes first has it.
    patches = Patches(street)
    tree = shapely.STRtree([body.area for body in solid])
    taken: list[BaseGeometry] = []
    standing: list[Building] = []
    overhead: list[Building] = []
    for i, body in enumerate(solid):
        before = [taken[j] for j in sorted(tree.query(body.area).tolist()) if j < i]
        area = body.area.difference(shapely.union_all(before).buffer(0.02)) if before else body.area
        body = replace(body, area=_areas(area))
        taken.append(body.area)
        near = patches.near(_around(body.area, 1.0))
        gap = buffered(near, GAP_M, join_style="mitre", mitre_limit=2.0)
        parts = [part for part in _cleared(body.area.difference(gap)) if not part.intersects(near)]
        standing += [Building(outline=part, height_m=body.height_m) for part in parts]
        overhead += _over_passages(body, near)

    # 3. What starts on an upper floor starts higher up where it reaches over the street.
    for body in raised:
        above = _widened(patches.near(_around(body.area, 1.0)))
        beside, over = body.area.difference(above), body.area.intersection(above)
        for area, low_m in ((beside, body.rise_m), (over, max(body.rise_m, PASSAGE_M))):
            if body.height_m > low_m + 0.3:
                overhead += [
                    Building(outline=part, height_m=body.height_m, low_m=low_m)
                    for part in _cleared(area)
                ]
    return standing, overhead


def _outlines(items: list[Item], hull: BaseGeometry) -> tuple[list[_Body], list[BaseGeometry]]:
    """All outlines of buildings and their parts, the large ones first, and those of courtyards."""
    shapely.prepare(hull)
    bodies: list[_Body] = []
    courtyards: list[BaseGeometry] = []
    for item in items:
        if (
            item.kind != "building"
            or item.author
            or not item.filled
            or len(item.points_W_m) < 4
            or _hidden(item)
        ):
            continue
        area = _areas(shapely.make_valid(Polygon(item.points_W_m)))
        if not hull.contains(area):
            area = _areas(area.intersection(hull))
        if area.is_empty:
            continue
        if item.detail == "courtyard":
            courtyards.append(area)
        else:
            low_m = max(rise_m(item.tags), PASSAGE_M if item.detail == "bridge" else 0.0)
            least_m = low_m + (STOREY_M if low_m > 0.0 else 0.0)
            height_m = max(_height_m(item, area.area), least_m)
            is_part = item.detail == "part"
            bodies.append(_Body(area=area, rise_m=low_m, height_m=height_m, part=is_part))
    return sorted(bodies, key=lambda body: -body.area.area), courtyards


def _hidden(item: Item) -> bool:
    """True for roofs on posts, which have no walls, and for what lies under ground."""
    return (
        item.detail in _KINDS["open"]
        or item.tags.get("building:part", "") in _KINDS["open"]
        or item.tags.get("location", "") == "underground"
        or number(item.tags, "layer") < 0.0
        or number(item.tags, "building:levels") < 0.0
    )


def _hollowed(bodies: list[_Body], courtyards: list[BaseGeometry]) -> list[_Body]:
    """The same bodies, with courtyards cut out of the buildings around them."""
    tree = shapely.STRtree(courtyards)
    hollowed: list[_Body] = []
    for body in bodies:
        inside = [courtyards[i] for i in sorted(tree.query(body.area).tolist())]
        inside = [yard for yard in inside if yard.area < 0.98 * body.area.area]
        yards = [y for y in inside if y.intersection(body.area).area > 0.9 * y.area]
        if yards:
            body = replace(body, area=_areas(body.area.difference(shapely.union_all(yards))))
        hollowed.append(body)
    return hollowed


def _composed(bodies: list[_Body]) -> tuple[list[_Body], list[_Body]]:
    """Bodies that stand, parts before the building that they belong to, and raised bodies."""
    parts = [body for body in bodies if body.part]
    wholes = [body for body in bodies if not body.part]
    tree = shapely.STRtree([part.area for part in parts])
    bases: list[_Body] = []
    for whole in wholes:
        near = [parts[i] for i in sorted(tree.query(whole.area).tolist())]
        own = [p for p in near if p.area.intersection(whole.area).area > 0.5 * p.area.area]
        bases.append(_base(whole, own) if own else whole)
    every = [*parts, *bases]
    standing = [body for body in every if body.rise_m <= _STANDS_M and not body.area.is_empty]
    return standing, _supported(standing, [body for body in every if body.rise_m > _STANDS_M])


def _base(whole: _Body, parts: list[_Body]) -> _Body:
    """What of a building its parts leave; nothing if they are all of it, so people pass below."""
    grounded = shapely.union_all([part.area for part in parts if part.rise_m <= _STANDS_M])
    raised = shapely.union_all([part.area for part in parts if part.rise_m > _STANDS_M])
    left = _areas(whole.area.difference(grounded))
    open_below = left.intersection(raised).area
    modelled = left.difference(raised).area <= (1.0 - _MODELLED) * whole.area.area
    if modelled and open_below <= _OPEN_BELOW * whole.area.area:
        return replace(whole, area=_areas(left.difference(raised)))
    # It ends below the parts that stand on it.
    height_m = whole.height_m
    for part in parts:
        if part.rise_m > _STANDS_M and part.area.intersection(left).area > _SMALLEST_M2:
            height_m = min(height_m, max(part.rise_m, STOREY_M))
    return replace(whole, area=left, height_m=height_m)


def _supported(standing: list[_Body], raised: list[_Body]) -> list[_Body]:
    """Raised bodies, drawn down to the roof below where a map leaves out the floors between."""
    upwards = sorted(raised, key=lambda body: body.rise_m)
    below = [*standing, *upwards]
    tree = shapely.STRtree([other.area for other in below])
    found: list[_Body] = []
    for place, body in enumerate(upwards, start=len(standing)):
        under = [below[i] for i in sorted(tree.query(body.area).tolist()) if i < place]
        shares = [
            (other.area.intersection(body.area).area / body.area.area, other.height_m)
            for other in under
        ]
        if sum(share for share, _ in shares) > _HELD:
            lowest_m = min(height_m for share, height_m in shares if share > 0.1 * _HELD)
            body = replace(body, rise_m=min(body.rise_m, max(lowest_m, _STANDS_M)))
        found.append(body)
    return found


def _widened(street: BaseGeometry) -> BaseGeometry:
    """The street and a little more: what hangs over it leaves no slot beside the walls below."""
    return buffered(street, 2.0 * GAP_M, join_style="mitre", mitre_limit=2.0)


def _over_passages(body: _Body, street: BaseGeometry) -> list[Building]:
    """The upper floors where a street runs through a building."""
    # A street along its front cuts off an edge only.
    if body.height_m < PASSAGE_M + 1.0:
        return []
    found: list[Building] = []
    for cut in _cleared(body.area.intersection(_widened(street))):
        inner_m = cut.boundary.difference(body.area.boundary.buffer(0.1)).length
        if inner_m > 0.5 * cut.length and not cut.buffer(-1.0).is_empty:
            found.append(Building(outline=cut, height_m=body.height_m, low_m=PASSAGE_M))
    return found


def _cleared(area: BaseGeometry) -> list[Polygon]:
    """The polygons of an area without crumbs and thin strips, on a centimetre grid."""
    if area.is_empty:
        return []
    wide = area.buffer(-0.15).buffer(0.15, join_style="mitre").simplify(0.1)
    opened = shapely.set_precision(valid(wide), 0.01)
    return [part for part in polygons_of(opened) if part.is_valid and part.area >= _SMALLEST_M2]


def _areas(geometry: BaseGeometry) -> BaseGeometry:
    """Only the polygons of a geometry."""
    polygons = polygons_of(geometry, 1e-6)
    return polygons[0] if len(polygons) == 1 else MultiPolygon(polygons)


def _around(area: BaseGeometry, margin_m: float) -> tuple[float, float, float, float]:
    x0, y0, x1, y1 = area.bounds if not area.is_empty else (0.0, 0.0, 0.0, 0.0)
    return x0 - margin_m, y0 - margin_m, x1 + margin_m, y1 + margin_m


def _height_m(item: Item, area_m2: float) -> float:
    height_m = metres(item.tags.get("height", "")) or metres(item.tags.get("building:height", ""))
    if height_m is not None and 2.0 <= height_m <= 400.0:
        return height_m
    storeys = metres(item.tags.get("building:levels", "")) or metres(item.tags.get("levels", ""))
    if storeys is not None and 0.5 <= storeys <= 120.0:
        roof_m = metres(item.tags.get("roof:height", ""))
        if roof_m is None:
            roof_m = STOREY_M * float(np.clip(number(item.tags, "roof:levels"), 0.0, 4.0))
        return STOREY_M * storeys + float(np.clip(roof_m, 0.0, 30.0)) + 1.0
    # Without tags, a height is drawn from those that are usual for its kind and size.
    if item.detail in _KINDS["low"] or area_m2 < 25.0:
        bounds_m = 2.6, 3.4
    elif item.detail in _KINDS["houses"]:
        bounds_m = 6.0, 9.0
    elif item.detail in _KINDS["high"]:
        bounds_m = 15.0, 25.0
    else:
        bounds_m = (5.0, 9.0) if area_m2 < 80.0 else (9.0, 18.0)
    return round(float(make_rng(0, "building", item.id).uniform(*bounds_m)), 1)
