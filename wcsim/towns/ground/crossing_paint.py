"""Crossings without paint: those that a map calls unmarked, and those that netconvert guessed where the map has none.

They stay crossings for SUMO, and their kerbs are lowered; on the ground they look like the road.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import shapely

from wcsim.towns.sumo.additional import Item
from wcsim.towns.sumo.net import Lane, LaneKind, Net
from wcsim.types import F64

GROUP, KIND = "crossing", "unmarked"  # of the points that say so in a town's files
REACH_M = 12.0  # from a crossing of a map to the one that it is in the net
_ON_M = 1.0
_PLAIN = frozenset(("unmarked", "no", "informal"))


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossingMark:
    """A crossing as a map has it."""

    at_m: F64  # (2,) net coordinates
    tags: Mapping[str, str]

    @property
    def painted(self) -> bool:
        """Whether the map does not say that it has no markings."""
        return self.tags.get("crossing") not in _PLAIN and self.tags.get("crossing:markings", "yes") != "no"


def unmarked_crossings(items: Iterable[Item], net: Net) -> frozenset[str]:
    """The edges of crossings on which a point of type crossing.unmarked lies."""
    points = [item.points_W_m[0] for item in items if item.group == GROUP and item.kind == KIND]
    lanes, tree = _crossings(net)
    if not points or not lanes:
        return frozenset()
    found = (tree.query_nearest(shapely.Point(at_m), max_distance=_ON_M, all_matches=False) for at_m in points)
    return frozenset(lanes[index].edge_id for near in found for index in near.tolist())


def unpainted(net: Net, marks: Iterable[CrossingMark]) -> list[Lane]:
    """The crossings of a net that are neither the nearest one to a painted crossing of the map nor at a signal."""
    lanes, tree = _crossings(net)
    painted = {name for link in net.connections if link.tls_id for name in (link.start, link.end)}
    for mark in marks:
        if mark.painted and lanes:
            near = tree.query_nearest(shapely.Point(mark.at_m), max_distance=REACH_M, all_matches=False)
            painted |= {lanes[index].edge_id for index in near.tolist()}
    return [lane for lane in lanes if lane.edge_id not in painted]


def unmarked_points(lanes: Iterable[Lane]) -> tuple[str, ...]:
    """The points that say that these crossings have no paint, as elements of an additional file."""
    found = []
    for lane in lanes:
        x_m, y_m = shapely.LineString(lane.points_m).interpolate(0.5, normalized=True).coords[0]
        head = f'<poi id={quoteattr(f"{KIND}.{lane.edge_id}")} type="{GROUP}.{KIND}"'
        found.append(f'{head} x="{x_m:.2f}" y="{y_m:.2f}" color="0.6,0.6,0.6" layer="1"/>')
    return tuple(found)


def _crossings(net: Net) -> tuple[list[Lane], shapely.STRtree]:
    lanes = [lane for lane in net.lanes(LaneKind.CROSSING) if len(lane.points_m) > 1]
    return lanes, shapely.STRtree([shapely.LineString(lane.points_m) for lane in lanes])
