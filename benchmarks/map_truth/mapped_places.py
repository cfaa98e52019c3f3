"""Crossings, kerbs and squares of the map, and what the street has there."""

import re
from typing import Any, Final

import numpy as np
import shapely

from benchmarks.map_truth.raw_map import MapArea, RawMap, Tags, below_ground
from wcsim.types import F64, ClassId, Ground

_UPON: Final = 0.5  # of the smaller crossing's ground
_BESIDE_M: Final = 1.0  # of a crossing: a place so near is still on it
_CARRIAGEWAY: Final = (ClassId.ROAD, ClassId.CROSSWALK, ClassId.PARKING, ClassId.RAIL_TRACK)
_PAVED: Final = (ClassId.SIDEWALK, ClassId.CROSSWALK)
_REACH_M: Final = 3.0
_CELL_M: Final = 0.1
_ALONG_M: Final = 0.5  # of the kerb, from its nearest place
_RAISED_M: Final = 0.03  # what the map calls a kerb of more
_BUILT_LOW_M: Final = 0.03
_BUILT_HIGH_M: Final = 0.06
_EACH_M: Final = 2.0  # of a mapped line of kerbs
_UNITS_M: Final = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}


class Crossings:
    """The crossings of a net of sumolib: their lines, their ground, and where they are."""

    def __init__(self, net: Any) -> None:
        lanes = [edge.getLanes()[0] for edge in net.getEdges() if edge.getFunction() == "crossing"]
        self.lines = [shapely.LineString(lane.getShape()) for lane in lanes]
        half_m = [0.5 * lane.getWidth() for lane in lanes]
        self.shapes = shapely.buffer(self.lines, half_m, cap_style="flat")
        self._tree = shapely.STRtree(self.shapes)

    def pairs(self) -> int:
        """How many pairs share more than half of the smaller one's ground."""
        found = self._tree.query(self.shapes, predicate="intersects")
        first, second = self.shapes[found[:, found[0] < found[1]]]
        smaller_m2 = np.minimum(shapely.area(first), shapely.area(second))
        return int((shapely.area(shapely.intersection(first, second)) > _UPON * smaller_m2).sum())

    def at(self, place_net_m: F64) -> int | None:
        """The nearest crossing that a place (2,) lies on, None for none."""
        found = self._tree.query_nearest(shapely.Point(place_net_m), _BESIDE_M, all_matches=False)
        return int(found[0]) if len(found) else None


def count_crossings(crossings: Crossings, raw: RawMap, ground: Ground, origin_net_m: F64) -> dict[str, float]:
    """Crossings upon each other, those that the map denies, and zebras where it says that there is none."""
    denied = [node for node in raw.nodes if node.tags.get("crossing") == "no"]
    bare = [
        node
        for node in raw.nodes
        if node.tags.get("crossing") in ("unmarked", "informal") or node.tags.get("crossing:markings") == "no"
    ]
    painted = [ground.class_at(node.p_net_m - origin_net_m) == ClassId.CROSSWALK for node in bare]
    return {
        "crossings": len(crossings.lines),
        "crossings upon each other, pairs": crossings.pairs(),
        "nodes of crossing=no": len(denied),
        "nodes of crossing=no with a crossing": sum(crossings.at(node.p_net_m) is not None for node in denied),
        "nodes of crossings without markings": len(bare),
        "nodes of crossings without markings, painted": sum(map(bool, painted)),
    }


def mapped_kerb(tags: Tags) -> str:
    """What the map calls a kerb: "raised", "lowered", or "" where it does not say.

    A height is stronger than a word. A sloped, a rolled, or some kerb may be of any height.
    """
    height = tags.get("kerb:height", tags.get("height", "") if tags.get("barrier") == "kerb" else "")
    if found := re.fullmatch(r"(\d+(?:[.,]\d+)?) ?(|m|cm|mm)", height.strip()):
        height_m = float(found[1].replace(",", ".")) * _UNITS_M[found[2]]
        return "raised" if height_m > _RAISED_M else "lowered"
    if tags.get("kerb") in ("raised", "normal", "regular"):
        return "raised"
    return "lowered" if tags.get("kerb") in ("lowered", "flush", "no") else ""


def count_kerbs(crossings: Crossings, raw: RawMap, ground: Ground, origin_net_m: F64) -> dict[str, float]:
    """Kerbs whose height the map knows, and how many of them the street has otherwise."""
    places = list[tuple[str, F64]]()
    for node in raw.nodes:
        called = mapped_kerb(node.tags)
        # A node amid the carriageway speaks of the kerbs at both ends of the crossing there, of none without one.
        crossing = crossings.at(node.p_net_m)
        if not node.on_street:
            places.append((called, node.p_net_m))
        elif crossing is not None:
            places += [(called, end) for end in shapely.get_coordinates(crossings.lines[crossing])[[0, -1]]]
    for way in raw.ways.values():
        called = mapped_kerb(way.tags)
        if way.tags.get("barrier") == "kerb":
            along = way.line.interpolate(np.arange(0.0, way.line.length, _EACH_M))
            places += [(called, place) for place in shapely.get_coordinates(along)]
        elif not way.street:
            # A way on foot meets kerbs where it ends.
            places += [(called, end) for end in shapely.get_coordinates(way.line)[[0, -1]]]

    counts = dict[str, float]()
    for called, wrong in (("raised", f"below {_BUILT_LOW_M:g} m"), ("lowered", f"above {_BUILT_HIGH_M:g} m")):
        here = [place for each, place in places if each == called]
        built_m = [found for place in here if (found := built_kerb_m(ground, place - origin_net_m)) is not None]
        faults = [found < _BUILT_LOW_M if called == "raised" else found > _BUILT_HIGH_M for found in built_m]
        counts[f"kerbs {called}, places in the map"] = len(here)
        counts[f"kerbs {called}, with a kerb of the street"] = len(built_m)
        counts[f"kerbs {called}, built {wrong}"] = sum(faults)
    return counts


def built_kerb_m(ground: Ground, place_W_m: F64) -> float | None:
    """The step of the ground at the nearest edge of a carriageway, None without one within 3 m of a place (2,)."""
    steps_m = np.arange(-_REACH_M, _REACH_M + 0.5 * _CELL_M, _CELL_M)
    offsets_m = np.stack(np.meshgrid(steps_m, steps_m), axis=-1)
    height_m, kind = ground.raised_at(place_W_m + offsets_m), ground.class_at(place_W_m + offsets_m)
    if (kind == ClassId.VOID).any():
        return None  # the street ends here

    # Cells beside each other of which one alone is carriageway, along either axis.
    low = np.isin(kind, _CARRIAGEWAY)
    across = [np.diff(low, axis=axis) for axis in (0, 1)]
    edges_m = np.concatenate([offsets_m[:-1][across[0]], offsets_m[:, :-1][across[1]]])
    jumps_m = np.concatenate([np.abs(np.diff(height_m, axis=axis))[across[axis]] for axis in (0, 1)])
    away_m = np.hypot(*edges_m.T)
    if not len(away_m) or away_m.min() > _REACH_M:
        return None
    near = np.hypot(*(edges_m - edges_m[away_m.argmin()]).T) <= _ALONG_M
    return float(np.median(jumps_m[near]))


def count_squares(net: Any, raw: RawMap, ground: Ground, origin_net_m: F64) -> dict[str, float]:
    """Squares of the map as far as the net reaches, and how much of them is paved ground of the street."""
    box = shapely.box(*net.getBoundary())
    squares = [area.shape.intersection(box) for area in raw.areas if is_square(area)]
    squares = [shape for shape in squares if shape.area > 0.0]
    whole = shapely.unary_union(squares)
    counts = {"squares": float(len(squares)), "squares, m2": whole.area, "squares, paved m2": 0.0}
    if squares:
        west_m, south_m, east_m, north_m = whole.bounds
        x_m, y_m = np.meshgrid(np.arange(west_m, east_m) + 0.5, np.arange(south_m, north_m) + 0.5)
        places = np.stack([x_m, y_m], axis=-1)[shapely.contains_xy(whole, x_m, y_m)]
        paved = np.isin(ground.class_at(places - origin_net_m), _PAVED)
        counts["squares, paved m2"] = whole.area * float(paved.mean())
    return counts


def is_square(area: MapArea) -> bool:
    """Whether people may cross an area in the open."""
    square = area.tags.get("highway") == "pedestrian" or area.tags.get("place") == "square"
    return square and not below_ground(area.tags)
