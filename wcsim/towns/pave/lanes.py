"""Where the lanes and positions of a net lie in the same net with pavements: a pavement becomes lane 0 of its edge."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import shapely

from wcsim.errors import TownError

_NEAR_END_M = 1.0  # how far before its end a lane still sees what lay beyond it: SUMO's vehicles stand so far back


@dataclass(frozen=True, slots=True, kw_only=True)
class _LaneLine:
    """A lane as a line with SUMO's positions on it, which may be longer or shorter than it is drawn."""

    id: str
    length_m: float
    line: shapely.LineString

    def point(self, pos_m: float) -> shapely.Point:
        """The place of a position, in net coordinates."""
        point: shapely.Point = self.line.interpolate(min(1.0, max(0.0, pos_m / self.length_m)), normalized=True)
        return point

    def nearest(self, point: shapely.Point) -> float:
        """The position in m of the nearest point on the lane; 0 or the length for a place before or behind it."""
        return float(self.line.project(point, normalized=True)) * self.length_m


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneMap:
    """The lanes of a net before and after; edges by id, lanes from right to left."""

    before: Mapping[str, tuple[_LaneLine, ...]]
    after: Mapping[str, tuple[_LaneLine, ...]]
    moved: Mapping[str, str]  # id of every lane before -> after
    lines: Mapping[str, _LaneLine]  # all lanes of before by id, those within junctions too
    new_lines: Mapping[str, _LaneLine]

    def shift(self, edge: str) -> int:
        """By how many indices the lanes of an edge moved; 0 for an edge that the net does not have."""
        return len(self.after.get(edge, ())) - len(self.before.get(edge, ()))

    def position(self, lane: str, pos_m: float, *, span: bool) -> tuple[float, float]:
        """A position on a lane of before, found again where it lay.

        Args:
            lane: Its id in the net of before.
            pos_m: The position; negative ones count from the end.
            span: Whether it is an end of something long, which may reach to the very ends of the lane.

        Returns:
            The position on that lane of after, and how far in m the place has moved along the lane: not at all,
            unless a junction has grown over it.
        """
        old, new = self.lines[lane], self.new_lines[self.moved[lane]]
        at_m = min(old.length_m, max(0.0, old.length_m + pos_m if pos_m < 0.0 else pos_m))
        place = old.point(at_m)
        found_m = new.nearest(place)
        if not span:
            low_m, high_m = min(at_m, _NEAR_END_M), new.length_m - min(old.length_m - at_m, _NEAR_END_M)
            found_m = min(max(found_m, min(low_m, high_m)), high_m)
        found_m = math.floor(found_m * 100.0 + 0.5) / 100.0
        found_m = max(0.0, min(found_m, math.floor(new.length_m * 100.0 + 1e-6) / 100.0))
        return found_m, _along_m(new.line, place, new.point(found_m))


def _along_m(line: shapely.LineString, old: shapely.Point, new: shapely.Point) -> float:
    """How far two places are from each other in the direction of a line; what lies sideways is left out."""
    at_m, step_m = line.project(new), min(0.5, 0.5 * line.length)
    start, end = line.interpolate(max(0.0, at_m - step_m)), line.interpolate(min(line.length, at_m + step_m))
    way = (end.x - start.x, end.y - start.y)
    size_m = math.hypot(*way)
    if not size_m:
        return float(old.distance(new))
    return float(abs((new.x - old.x) * way[0] + (new.y - old.y) * way[1])) / size_m


def lane_map(before: Element, after: Element) -> LaneMap:
    """The lanes of two nets, of which the second is the first with pavements.

    Raises:
        TownError: an edge of the first is not in the second, or has fewer lanes there.
    """
    old, new = _edges(before), _edges(after)
    moved: dict[str, str] = {}
    for edge, lanes in old.items():
        shift = len(new.get(edge, ())) - len(lanes)
        if not 0 <= shift <= 1:
            raise TownError(
                f"edge {edge!r} has {len(lanes)} lanes, and {len(new.get(edge, ()))} after netconvert; expected at "
                "most one more: repair the net in netedit, and try again"
            )
        moved |= {lane.id: new[edge][index + shift].id for index, lane in enumerate(lanes)}
    inner_old, inner_new = _inner(before), _inner(after)
    vias = _vias(after, {})
    for link, via in _vias(before, {edge: len(new[edge]) - len(lanes) for edge, lanes in old.items()}).items():
        if via in inner_old and vias.get(link) in inner_new:
            moved[via] = vias[link]
    return LaneMap(
        before=old,
        after=new,
        moved=moved,
        lines={lane.id: lane for lanes in old.values() for lane in lanes} | inner_old,
        new_lines={lane.id: lane for lanes in new.values() for lane in lanes} | inner_new,
    )


def _edges(net: Element) -> dict[str, tuple[_LaneLine, ...]]:
    return {
        edge.get("id", ""): _lines(edge.iterfind("lane"))
        for edge in net.iterfind("edge")
        if not edge.get("function") or edge.get("function") in ("normal", "connector")
    }


def _inner(net: Element) -> dict[str, _LaneLine]:
    """Lanes within junctions, which other nets call by other names."""
    return {
        lane.id: lane
        for edge in net.iterfind("edge")
        if edge.get("function") == "internal"
        for lane in _lines(edge.iterfind("lane"))
    }


def _lines(lanes: Iterable[Element]) -> tuple[_LaneLine, ...]:
    found = sorted(lanes, key=lambda lane: int(lane.get("index", "0")))
    return tuple(
        _LaneLine(
            id=lane.get("id", ""), length_m=max(0.01, float(lane.get("length", "0"))), line=_line(lane.get("shape", ""))
        )
        for lane in found
    )


def _line(shape: str) -> shapely.LineString:
    places = [tuple(float(part) for part in place.split(",")[:2]) for place in shape.split()]
    return shapely.LineString(places if len(places) > 1 else [*places, *places])


def _vias(net: Element, shifts: Mapping[str, int]) -> dict[tuple[str, str, int, int], str]:
    """The inner lane of each connection (from, to, lane, lane), counted as after the shift of its edges."""
    found = {}
    for link in net.iterfind("connection"):
        start, end = link.get("from", ""), link.get("to", "")
        if link.get("via") and not start.startswith(":"):
            lanes = (int(link.get("fromLane", "0")), int(link.get("toLane", "0")))
            key = (start, end, lanes[0] + shifts.get(start, 0), lanes[1] + shifts.get(end, 0))
            found[key] = link.get("via", "")
    return found
