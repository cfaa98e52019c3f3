"""Streets drawn over the pavement of others with which they share no junction, at one height."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry

from wcsim.towns.ground.surfaces import lane_area
from wcsim.towns.sumo.net import WALK_KINDS, Edge, LaneKind, Net

LEAST_M2 = 3.0  # of one pair: less comes of rounded corners
APART_M = 2.0  # ways with more between their heights pass over each other


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlap:
    """A carriageway on a pavement."""

    street: str  # edge ids
    pavement: str
    area_m2: float


def overlaps_of(net: Net) -> tuple[Overlap, ...]:
    """All overlaps of more than LEAST_M2, the largest first."""
    streets, driven = _areas(net, lambda kind: kind is LaneKind.MOTOR)
    paved, walked = _areas(net, lambda kind: kind in WALK_KINDS)
    found: list[Overlap] = []
    if not driven or not walked:
        return ()
    for i, j in shapely.STRtree(walked).query(driven, predicate="intersects").T.tolist():
        street, other = streets[i], paved[j]
        if {street.start, street.end} & {other.start, other.end} or abs(_z_m(street) - _z_m(other)) > APART_M:
            continue
        area_m2 = float(driven[i].intersection(walked[j]).area)
        if area_m2 > LEAST_M2:
            found.append(Overlap(street=street.id, pavement=other.id, area_m2=area_m2))
    return tuple(sorted(found, key=lambda item: (-item.area_m2, item.street, item.pavement)))


def _areas(net: Net, wanted: Callable[[LaneKind], bool]) -> tuple[list[Edge], list[BaseGeometry]]:
    edges = [e for e in net.edges if not e.function and any(wanted(lane.kind) for lane in e.lanes)]
    return edges, [shapely.union_all([lane_area(lane) for lane in e.lanes if wanted(lane.kind)]) for e in edges]


def _z_m(edge: Edge) -> float:
    return float(sum(lane.z_m.mean() for lane in edge.lanes) / len(edge.lanes))
