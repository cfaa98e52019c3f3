"""Streets without pavements: motorways, streets closed to walkers, and those of which the map says that there is none.

netconvert guesses pavements by speed alone, and crossings wherever two pavements face each other across a slow street.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import Element

from wcsim.towns.sumo.net import LaneKind, Net
from wcsim.towns.walking.islands import ways_of

_SLOWEST_KMH = 66  # just above netconvert's --crossings.guess.speed-threshold: nobody crosses a motorway on foot
_KMH = {"": 1.0, "km/h": 1.0, "kmh": 1.0, "kph": 1.0, "mph": 1.609, "knots": 1.852}
_SPEED = re.compile(r"^(\d+(?:\.\d+)?)\s*([a-z/]*)$")
_SPEEDS = ("maxspeed", "maxspeed:forward", "maxspeed:backward")
_NONE = {"no", "none"}


def quicken_motorways(root: Element) -> None:
    """Make slow motorways of an extract as fast as netconvert needs to see that nobody crosses them on foot."""
    for way in root.iterfind("way"):
        if not _is_motorway(_tags(way)):
            continue
        for tag in [tag for tag in way.findall("tag") if tag.get("k") in _SPEEDS]:
            if _kmh(tag.get("v", "")) < _SLOWEST_KMH:
                tag.set("v", str(_SLOWEST_KMH))


def unpaved_ways(root: Element) -> frozenset[str]:
    """Ids, without a sign, of the ways of an extract that have no pavement of their own."""
    return frozenset(way.get("id", "").lstrip("-") for way in root.iterfind("way") if _is_unpaved(_tags(way)))


def wrongly_paved(net: Net, net_path: Path, ways: frozenset[str]) -> tuple[str, ...]:
    """Edges of a net that have a pavement although all ways that they were made of have none; sorted."""
    if not ways:
        return ()
    made_of = ways_of(net_path)
    paved = (edge.id for edge in net.edges if any(lane.kind is LaneKind.SIDEWALK for lane in edge.lanes))
    return tuple(sorted(edge for edge in paved if made_of.get(edge) and ways.issuperset(made_of[edge])))


def _is_motorway(tag: dict[str, str]) -> bool:
    return tag.get("highway") == "motorway" or ("highway" in tag and tag.get("motorroad") == "yes")


def _is_unpaved(tag: dict[str, str]) -> bool:
    if "highway" not in tag:
        return False
    barred = _is_motorway(tag) or tag["highway"] == "motorway_link" or tag.get("foot") == "no"
    return barred or tag.get("sidewalk") in _NONE or tag.get("sidewalk:both") in _NONE


def _kmh(text: str) -> float:
    """A speed in km/h; without a limit, or by a rule, motorways are fast."""
    match = _SPEED.match(text.strip().lower())
    return float(match[1]) * _KMH.get(match[2], 1.0) if match else float("inf")


def _tags(way: Element) -> dict[str, str]:
    return {item.get("k", ""): item.get("v", "") for item in way.iterfind("tag")}
