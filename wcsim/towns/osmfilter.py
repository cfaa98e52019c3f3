"""What is taken out of an OpenStreetMap extract before SUMO's tools read it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from wcsim.towns.osmbuildings import mark_buildings

_NO_STREET = {"corridor", "elevator", "proposed", "construction"}
_NO_RAIL = {"subway", "construction", "disused", "abandoned", "proposed", "razed"}
_NUMBERS = re.compile(r"^(lanes|width|est_width|layer|maxspeed|((cycleway|sidewalk):.*:?width))(:(forward|backward))?$")
_NUMBER = re.compile(r"^[+-]?\d{1,4}([.,]\d+)?\s*[a-z/'\"]*$")
_WORDS = {"none", "signals", "walk", "variable", "default", "national"}
_NO_BUILDING = {"entrance", "underpass_entrance", "roof", "no"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """A cleaned extract."""

    data: bytes
    dropped_ways: int  # streets under ground, indoors or not built
    orphan_crossings: int  # crossing nodes on no street: with --osm.crossings they crash netconvert 1.28


def filter_osm(root: Element) -> Filtered:
    """Drop ways that are not at street level, and the crossing tag of nodes that lie on no street; changes `root`."""
    tags = {way: _tags(way) for way in root.iterfind("way")}
    dead = [way for way, tag in tags.items() if _is_hidden(tag)]
    for way in dead:
        root.remove(way)
    for item in (*root.iterfind("way"), *root.iterfind("node")):
        for tag in item.findall("tag"):
            if _is_senseless(tag.get("k", ""), tag.get("v", "")):
                item.remove(tag)
    orphans = strip_orphans(root)
    mark_buildings(root)
    data = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return Filtered(data=data, dropped_ways=len(dead), orphan_crossings=orphans)


def strip_orphans(root: Element) -> int:
    """Take the crossing tag off nodes that lie on no street, and say how many there were; changes `root`."""
    on_street = {
        node.get("ref")
        for way in root.iterfind("way")
        if any(item.get("k") == "highway" for item in way.iterfind("tag"))
        for node in way.iterfind("nd")
    }
    orphans = 0
    for node in root.iterfind("node"):
        for item in node.findall("tag"):
            if item.get("k") == "highway" and item.get("v") == "crossing" and node.get("id") not in on_street:
                node.remove(item)
                orphans += 1
    return orphans


def _is_senseless(key: str, value: str) -> bool:
    """True for a tag without a value, or a word where netconvert wants a number: it stops at some of them."""
    if not key or not value.strip():
        return True
    if not _NUMBERS.match(key):
        return False
    told = value.strip()
    return not (_NUMBER.match(told) or told in _WORDS or ":" in told)  # as "DE:urban"


def _tags(way: Element) -> dict[str, str]:
    return {item.get("k", ""): item.get("v", "") for item in way.iterfind("tag")}


def _is_hidden(tag: dict[str, str]) -> bool:
    """True for what nobody in the street sees or drives on."""
    if "building" in tag or "building:part" in tag:
        return (
            tag.get("building", "yes") in _NO_BUILDING
            or tag.get("location") == "underground"
            or _level(tag, "layer") < 0
        )
    if "highway" not in tag and "railway" not in tag:
        return False
    return (
        tag.get("tunnel", "no") not in ("no", "building_passage")
        or tag.get("indoor") == "yes"
        or tag.get("highway") in _NO_STREET
        or tag.get("railway") in _NO_RAIL
        or tag.get("location") in ("underground", "indoor")
        or _level(tag, "layer") < 0
        or tag.get("level", "0").split(";")[0] not in ("0", "")
    )


def _level(tag: dict[str, str], key: str) -> float:
    try:
        return float(tag.get(key, "0"))
    except ValueError:
        return 0.0
