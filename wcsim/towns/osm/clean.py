"""What is taken out of an OpenStreetMap extract before SUMO's tools read it.

What SUMO's polyconvert would lose of buildings: their courtyards and their parts, said in tags that it keeps.

polyconvert 1.28 gives the tags of a multipolygon to its inner ways as well, so a courtyard would become a building; and
it knows no key building:part. Both get a value of `building` that `towns/furniture/buildings.py` understands: courtyard
and part.
"""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element, SubElement

from wcsim.towns.osm.sidewalk_rules import quicken_motorways

_COURTYARD = "courtyard"
_PART = "part"


def mark_buildings(root: Element) -> None:
    """Mark courtyards and parts of buildings; changes `root`."""
    ways = {way.get("id", ""): way for way in root.iterfind("way")}
    for thing in (*ways.values(), *root.iterfind("relation")):
        if _tag(thing, "building") is None and _tag(thing, "building:part") not in (None, "no"):
            SubElement(thing, "tag", {"k": "building", "v": _PART})
    for relation in root.iterfind("relation"):
        if _tag(relation, "type") != "multipolygon":
            _drop(relation, "building")  # it only says which ways belong together
        elif _tag(relation, "building") is not None or any(
            _tag(way, "building") for way in _ways(relation, "outer", ways)
        ):
            for way in _ways(relation, "inner", ways):
                if _tag(way, "building") is None:
                    SubElement(way, "tag", {"k": "building", "v": _COURTYARD})


def _ways(relation: Element, role: str, ways: dict[str, Element]) -> list[Element]:
    """The ways that a relation has in a role, as far as they are in the extract."""
    refs = [m.get("ref", "") for m in relation.iterfind("member") if (m.get("type"), m.get("role")) == ("way", role)]
    return [ways[ref] for ref in refs if ref in ways]


def _tag(thing: Element, key: str) -> str | None:
    return next((tag.get("v", "") for tag in thing.iterfind("tag") if tag.get("k") == key), None)


def _drop(thing: Element, key: str) -> None:
    for tag in thing.findall("tag"):
        if tag.get("k") == key:
            thing.remove(tag)


_NO_STREET = {"corridor", "elevator", "proposed", "construction"}
_NO_RAIL = {"subway", "construction", "disused", "abandoned", "proposed", "razed"}
_NUMBERS = re.compile(r"^(lanes|width|est_width|layer|maxspeed|((cycleway|sidewalk):.*:?width))(:(forward|backward))?$")
_NUMBER = re.compile(r"^[+-]?\d{1,4}([.,]\d+)?\s*[a-z/'\"]*$")
_WORDS = {"none", "signals", "walk", "variable", "default", "national"}
_NO_BUILDING = {"entrance", "underpass_entrance", "roof", "no"}


def filter_osm(root: Element) -> None:
    """Drop ways that are not at street level, and the crossing tag of nodes that lie on no street; changes `root`."""
    root[:] = [item for item in root if item.tag != "way" or not is_hidden(tags_of(item))]
    for item in (*root.iterfind("way"), *root.iterfind("node")):
        item[:] = [tag for tag in item if tag.tag != "tag" or not _is_senseless(tag.get("k", ""), tag.get("v", ""))]
    strip_orphans(root)
    mark_buildings(root)
    quicken_motorways(root)


def strip_orphans(root: Element) -> None:
    """Take the crossing tag off nodes that lie on no street: it crashes netconvert 1.28; changes `root`."""
    on_street = {
        node.get("ref")
        for way in root.iterfind("way")
        if any(item.get("k") == "highway" for item in way.iterfind("tag"))
        for node in way.iterfind("nd")
    }
    for node in root.iterfind("node"):
        if node.get("id") not in on_street:
            node[:] = [tag for tag in node if (tag.get("k"), tag.get("v")) != ("highway", "crossing")]


def _is_senseless(key: str, value: str) -> bool:
    """True for a tag without a value, or a word where netconvert wants a number: it stops at some of them."""
    if not key or not value.strip():
        return True
    if not _NUMBERS.match(key):
        return False
    told = value.strip()
    return not (_NUMBER.match(told) or told in _WORDS or ":" in told)  # as "DE:urban"


def tags_of(item: Element) -> dict[str, str]:
    """The tags of a node or a way."""
    return {tag.get("k", ""): tag.get("v", "") for tag in item.iterfind("tag")}


def is_hidden(tag: dict[str, str]) -> bool:
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
