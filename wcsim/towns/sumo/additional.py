"""What stands in a town, as SUMO's additional files say: polygons, points and stops."""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from wcsim.core.reading import read_module_toml
from wcsim.errors import TownError
from wcsim.towns.sumo.net import Lane, Net, points
from wcsim.towns.sumo.xml_io import is_true, read_root
from wcsim.types import F64

log = logging.getLogger("wcsim.towns")

AUTHOR_KINDS: tuple[str, ...] = tuple(read_module_toml(__file__)["kinds"].split())
AUTHOR_PREFIX = "wcsim."
_STOPS = ("busStop", "trainStop")
FARTHEST_M = 1e6  # from the town's middle: farther away is no place
_SIZES = ("length", "width", "height", "angle")  # SUMO knows the last three as attributes too
# Groups whose second word says no more than how it looks.
_WHOLE_GROUPS = ("building", "traffic_sign")
_Lanes = Mapping[str, Lane]


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One thing: an outline, a line, or a point."""

    id: str
    # The last word of SUMO's type, such as "tree" of "natural.tree"; but "building" of
    # "building.yes".
    kind: str
    detail: str
    points_W_m: F64  # (K, 2); K = 1 for a point
    filled: bool
    tags: dict[str, str]  # OpenStreetMap's, and the author's parameters
    group: str = ""  # the first word of SUMO's type
    author: bool = False  # of a type wcsim.*: it stands where it is, whatever it stands on
    source: str = ""  # the file that says so


def _points_at(
    lanes: _Lanes, lane_id: str, places_m: tuple[float, ...], left_m: float = 0.0
) -> F64:
    """Points (n, 2) at positions along a lane, negative ones from its end, all moved to its left.

    Raises ValueError.
    """
    lane = lanes.get(lane_id)
    if lane is None or not lane.is_line:
        raise ValueError(f"the net has no lane {lane_id!r}")
    line = shapely.LineString(lane.points_m)
    length_m = lane.length_m or line.length
    shares = [(p if p >= 0.0 else p + length_m) / length_m for p in places_m]
    along_m = np.clip(shares, 0.0, 1.0) * line.length
    here: F64 = shapely.get_coordinates(shapely.line_interpolate_point(line, along_m))
    if left_m == 0.0:
        return here
    ahead, behind = (
        shapely.get_coordinates(shapely.line_interpolate_point(line, at_m))
        for at_m in (np.minimum(along_m + 0.1, line.length), np.maximum(along_m - 0.1, 0.0))
    )
    way = (ahead - behind) / np.maximum(1e-9, np.linalg.norm(ahead - behind, axis=1))[:, None]
    return np.asarray(here + left_m * np.column_stack([-way[:, 1], way[:, 0]]))


def read_items(
    files: tuple[Path, ...], origin_m: tuple[int, int], net: Net | None = None
) -> list[Item]:
    """All polygons, points of interest and stops of SUMO additional files, without doubles.

    Raises:
        TownError: a polygon or point is broken, or of an unknown type wcsim.*.
    """
    items: dict[tuple[str, bytes], Item] = {}
    lanes = {lane.id: lane for lane in net.every_lane} if net is not None else {}
    for path in files:
        for element in read_root(path):
            if element.tag in ("poly", "poi"):
                try:
                    item = _item(element, origin_m, lanes, str(path))
                except (KeyError, ValueError) as error:
                    raise TownError(
                        f"{path}: <{element.tag}> {element.get('id')!r} is broken ({error}); "
                        "correct it"
                    ) from None
            elif element.tag in _STOPS:
                item = _stop(element, lanes, str(path))
            else:
                continue
            if item is not None:
                items.setdefault((item.kind, np.round(item.points_W_m, 1).tobytes()), item)
    return list(items.values())


def _item(element: Element, origin_m: tuple[int, int], lanes: _Lanes, source: str) -> Item | None:
    """The item of a <poly> or <poi>, or None for one that is not for the street.

    Raises KeyError or ValueError.
    """
    full = element.get("type", "")
    author = full.startswith(AUTHOR_PREFIX)
    group, _, detail = full.removeprefix(AUTHOR_PREFIX).partition(".")
    if author and group not in AUTHOR_KINDS:
        known = ", ".join(AUTHOR_PREFIX + kind for kind in AUTHOR_KINDS)
        raise ValueError(f"unknown type {full!r}, expected one of {known}")
    place = _place(element, origin_m, lanes, must=author)
    if place is None:
        return None
    if np.abs(place).max() > FARTHEST_M:
        raise ValueError(f"it lies {np.abs(place).max():.3g} m away from the town")
    sizes = {key: element.attrib[key] for key in _SIZES if author and key in element.attrib}
    tags = {child.get("key", ""): child.get("value", "") for child in element.iterfind("param")}
    return Item(
        id=element.get("id", ""),
        kind=group if author or group in _WHOLE_GROUPS else detail or group,
        detail=detail,
        points_W_m=place,
        filled=is_true(element.get("fill", "0")),
        tags=sizes | tags,
        group=group,
        author=author,
        source=source,
    )


def _place(element: Element, origin_m: tuple[int, int], lanes: _Lanes, must: bool) -> F64 | None:
    """The points (K, 2) of a <poly> or <poi>; None where there are none and none are needed."""
    if element.tag == "poi" and "lane" in element.attrib and "x" not in element.attrib:
        try:
            pos_m, left_m = _number(element.get("pos", "0")), _number(element.get("posLat", "0"))
            return _points_at(lanes, element.attrib["lane"], (pos_m,), left_m)
        except ValueError as error:
            _leave_out(element, str(error), must)
            return None
    if "lon" in element.attrib or is_true(element.get("geo", "0")):
        why = (
            "it is placed by longitude and latitude; save it from netedit with x and y, "
            "or with lane and pos"
        )
        _leave_out(element, why, must)
        return None
    if element.tag == "poi":
        return points(f"{element.attrib['x']},{element.attrib['y']}", origin_m)
    place = points(element.attrib["shape"], origin_m)
    if not len(place):
        _leave_out(element, "its shape is empty", must)
        return None
    return place


def _leave_out(element: Element, why: str, must: bool) -> None:
    """Log that something is left out. Raises ValueError for what an author placed by hand."""
    if must:
        raise ValueError(why)
    log.warning("<%s> %r is left out: %s", element.tag, element.get("id", ""), why)


def _stop(element: Element, lanes: _Lanes, source: str) -> Item | None:
    """A stop of buses or trams: start, middle and end (3, 2) on the middle of its lane."""
    lane_id = element.get("lane", "")
    try:
        start_m = _number(element.get("startPos", "0"))
        end_m = _number(element.get("endPos", "-0.1"))
        end = _points_at(lanes, lane_id, (start_m, end_m))
        # A point is a stop too; its way is that of the lane.
        if np.hypot(*(end[1] - end[0])) < 0.5:
            end = _points_at(lanes, lane_id, (max(0.0, start_m - 1.0), start_m + 1.0))
    except ValueError as error:
        _leave_out(element, str(error), must=False)
        return None
    return Item(
        id=element.get("id", ""),
        kind="stop",
        detail=element.tag,
        points_W_m=np.array([end[0], 0.5 * (end[0] + end[1]), end[1]]),
        filled=False,
        tags={"name": element.get("name", "")},
        group="stop",
        source=source,
    )


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is no position")
    return value
