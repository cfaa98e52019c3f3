"""What stands along the pavements: trees, lamps, benches, signs, stops, and things that somebody left in the way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import shapely

from wcsim.towns.sumo.net import Lane, LaneKind, Net
from wcsim.types import F64

_ENDS_M = 5.0  # at both ends of a pavement nothing stands: people wait and turn there
_KERB_M = 0.35  # from the kerb to the middle of a post
_WIDE_M = 2.2  # narrower pavements have lamps and signs alone
_IN_WAY_M = 2.4  # narrower ones nobody leaves anything on
_WALL_M = 0.45  # from the inner edge of a pavement
_STOP_EVERY_M = 180.0
_STOP_LANE_M = 40.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Dressing:
    """What a town's pavements have, as pairs of SUMO's type and place (2,)."""

    mapped: list[tuple[str, F64]] = field(default_factory=list)  # gives way where there is no room
    placed: list[tuple[str, F64, float]] = field(default_factory=list)  # stands where it is; with its angle in degrees


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """Things of a kind in a row along pavements."""

    kinds: tuple[str, ...]
    every_m: tuple[float, float]
    share: float  # of the pavements have it
    at_kerb: bool
    least_m: float  # width of a pavement that has it


_ROWS = (
    _Row(kinds=("highway.street_lamp",), every_m=(24.0, 38.0), share=0.75, at_kerb=True, least_m=0.0),
    _Row(kinds=("natural.tree",), every_m=(8.0, 18.0), share=0.4, at_kerb=True, least_m=_WIDE_M),
    _Row(kinds=("barrier.bollard",), every_m=(2.0, 6.0), share=0.06, at_kerb=True, least_m=_WIDE_M),
    _Row(
        kinds=("traffic_sign.speed", "traffic_sign.parking", "traffic_sign.way"),
        every_m=(25.0, 70.0), share=0.7, at_kerb=True, least_m=0.0,
    ),
    _Row(
        kinds=("amenity.bench", "amenity.bench", "amenity.waste_basket", "man_made.planter", "amenity.bicycle_parking"),
        every_m=(18.0, 45.0), share=0.6, at_kerb=False, least_m=_WIDE_M,
    ),
    _Row(
        kinds=(
            "amenity.post_box", "man_made.street_cabinet", "amenity.vending_machine", "amenity.parking_meter",
            "emergency.fire_hydrant", "tourism.information", "advertising.poster_box", "amenity.telephone",
            "amenity.waste_basket",
        ),
        every_m=(40.0, 120.0), share=0.7, at_kerb=False, least_m=1.8,
    ),
)  # fmt: skip
_LEFT = ("wcsim.board", "wcsim.bin", "wcsim.scooter", "wcsim.bicycle", "wcsim.box", "wcsim.planter", "wcsim.table")


def dress(net: Net, rng: np.random.Generator) -> Dressing:
    """Things along all pavements of a net, drawn for each pavement."""
    found = Dressing()
    left_per_m = rng.uniform(0.0, 0.02)
    since_stop_m = float(rng.uniform(0.0, _STOP_EVERY_M))
    for edge in net.edges:
        if edge.function:
            continue
        for lane in edge.lanes:
            if lane.kind not in (LaneKind.SIDEWALK, LaneKind.SHARED) or len(lane.points_m) < 2:
                continue
            line = shapely.LineString(lane.points_m)
            _in_rows(lane, line, -1.0 if net.lefthand else 1.0, found, rng)
            _in_the_way(lane, line, float(left_per_m), found, rng)
            since_stop_m += line.length
            if line.length > _STOP_LANE_M and since_stop_m > _STOP_EVERY_M and edge.lanes[-1].kind is LaneKind.MOTOR:
                found.mapped.append(("highway.bus_stop", _beside(line, 0.5 * line.length, 0.0)[0]))
                since_stop_m = 0.0
    return found


def _in_rows(lane: Lane, line: shapely.LineString, kerb: float, found: Dressing, rng: np.random.Generator) -> None:
    for row in _ROWS:
        has, every_m = rng.random() < row.share, float(rng.uniform(*row.every_m))
        if not has or lane.width_m < row.least_m:
            continue
        aside_m = 0.5 * lane.width_m - (_KERB_M if row.at_kerb else _WALL_M)
        for along_m in _places(line, every_m, rng):
            kind = str(rng.choice(row.kinds))
            left_m = kerb * (aside_m if row.at_kerb else -aside_m)
            found.mapped.append((kind, _beside(line, along_m, left_m)[0]))


def _in_the_way(lane: Lane, line: shapely.LineString, per_m: float, found: Dressing, rng: np.random.Generator) -> None:
    """Things that somebody left on a wide pavement, off its middle: a chair must go round them."""
    number = int(rng.poisson(per_m * max(0.0, line.length - 2.0 * _ENDS_M)))
    for along_m in np.sort(rng.uniform(_ENDS_M, max(_ENDS_M, line.length - _ENDS_M), number)).tolist():
        side, kind = float(rng.choice((-1.0, 1.0))), str(rng.choice(_LEFT))
        reach_m = rng.uniform(0.5, 1.0) * (0.5 * lane.width_m - 0.4)
        at_m, angle_deg = _beside(line, along_m, side * reach_m)
        if lane.width_m >= _IN_WAY_M:
            found.placed.append((kind, at_m, angle_deg))


def _places(line: shapely.LineString, every_m: float, rng: np.random.Generator) -> Iterator[float]:
    at_m = _ENDS_M + float(rng.uniform(0.0, 0.5 * every_m))
    while at_m < line.length - _ENDS_M:
        yield at_m
        at_m += every_m


def _beside(line: shapely.LineString, along_m: float, left_m: float) -> tuple[F64, float]:
    """The place (2,) at a length along a line, so far to its left, and the way there as SUMO's angle in degrees."""
    here, ahead = (
        shapely.get_coordinates(line.interpolate(min(max(s_m, 0.0), line.length)))[0]
        for s_m in (along_m - 0.1, along_m + 0.1)
    )
    way = (ahead - here) / max(1e-9, float(np.hypot(*(ahead - here))))
    place = 0.5 * (here + ahead) + left_m * np.array([-way[1], way[0]])
    return place, float(np.degrees(np.arctan2(way[0], way[1])) % 360.0)


def park_things(park: shapely.Polygon, rng: np.random.Generator) -> Iterator[tuple[str, F64]]:
    """Trees, shrubs and benches in a park, of a square or in a garden."""
    x0, y0, x1, y1 = park.bounds
    inner = park.buffer(-2.0)
    number = int(min(150.0, park.area / 70.0))
    for xy_m in rng.uniform((x0, y0), (x1, y1), (number, 2)):
        kind = str(rng.choice(["natural.tree", "natural.tree", "natural.shrub", "amenity.bench"]))
        if inner.contains(shapely.Point(xy_m)):
            yield kind, xy_m
