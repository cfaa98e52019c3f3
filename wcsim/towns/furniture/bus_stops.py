"""Stops of buses and trams: a pole with a sign, and a shelter where the pavement has room for one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import shapely

from wcsim.towns.furniture.placement import FreeGround, StandingObject, Taken, stood_if_free
from wcsim.towns.sumo.additional import Item
from wcsim.types import F64

_SAME_STOP_M = 12.0  # a mapped stop so near to one of SUMO's is the same one
FARTHEST_M = 14.0  # from the middle of the lane to the pole
STEP_M = 0.35
ALONG_M = (0.0, 1.5, -1.5, 3.0, -3.0, 5.0, -5.0, 7.0, -7.0)


def stop_things(
    items: list[Item], place: FreeGround, standing: Iterable[StandingObject], lefthand: bool
) -> list[StandingObject]:
    """What stands at SUMO's stops, and at mapped ones of which SUMO knows nothing."""
    place.prepare()
    taken = Taken(standing)
    found: list[StandingObject] = []
    known = [item for item in items if item.group == "stop"]
    middles = shapely.MultiPoint([item.points_W_m[1] for item in known])
    for item in known:
        found += _at_stop(item, place, taken, lefthand)
    for item in items:
        if item.group == "highway" and item.kind == "bus_stop" and not item.author:
            here = shapely.Point(item.points_W_m.mean(axis=0))
            if middles.is_empty or not shapely.dwithin(middles, here, _SAME_STOP_M):
                found += _mapped(item, place, taken)
    return found


def _at_stop(item: Item, place: FreeGround, taken: Taken, lefthand: bool) -> list[StandingObject]:
    """A pole near the front of the stop and a shelter near its middle, both on the side where people wait."""
    start, middle, end = item.points_W_m
    along = (end - start) / max(1e-6, float(np.hypot(*(end - start))))
    aside = np.array([along[1], -along[0]]) * (-1.0 if lefthand else 1.0)
    front_yaw = float(np.arctan2(-aside[1], -aside[0]))  # both look at the road
    pole_at = end - min(1.0, 0.25 * float(np.hypot(*(end - start)))) * along
    pole = _first("stop_pole", _outward(pole_at, along, aside), float(np.arctan2(-along[1], -along[0])), place, taken)
    shelter = _first("shelter", _outward(middle, along, aside, 1.2), front_yaw, place, taken)
    return [*pole, *shelter]


def _mapped(item: Item, place: FreeGround, taken: Taken) -> list[StandingObject]:
    """A pole where the map has it, or near by; a shelter only where the map says so."""
    middle = item.points_W_m.mean(axis=0)
    nearest = shapely.get_coordinates(shapely.shortest_line(place.low, shapely.Point(middle)))
    towards = nearest[0] - middle if len(nearest) else np.array([0.0, 1.0])
    distance_m = float(np.hypot(*towards))
    aside = -towards / distance_m if distance_m > 1e-6 else np.array([0.0, -1.0])
    along = np.array([-aside[1], aside[0]])
    facing = float(np.arctan2(-aside[1], -aside[0]))
    if item.tags.get("shelter") == "yes":
        shelter = _first("shelter", _outward(middle, along, aside, 0.0, 3.0), facing, place, taken)
        if shelter:
            return shelter
    return _first("stop_pole", _outward(middle, along, aside, 0.0, 3.0), facing, place, taken)


def _outward(start_m: F64, along: F64, aside: F64, least_m: float = 0.5, most_m: float = FARTHEST_M) -> Iterator[F64]:
    """Places beside a point, the nearest to the road first."""
    for aside_m in np.arange(least_m, most_m, STEP_M):
        for along_m in ALONG_M:
            yield start_m + aside_m * aside + along_m * along


def _first(
    kind: str, places_m: Iterable[F64], facing_rad: float, place: FreeGround, taken: Taken
) -> list[StandingObject]:
    """A thing at the first place that is free, if there is one."""
    for xy_m in places_m:
        thing = stood_if_free(kind, xy_m, facing_rad - np.pi / 2, place, taken)
        if thing is not None:
            taken.add(thing.footprint)
            return [thing]
    return []
