"""What SUMO's polyconvert would lose of buildings: their courtyards and their parts, said in tags that it keeps.

polyconvert 1.28 gives the tags of a multipolygon to its inner ways as well, so a courtyard would become a building; and
it knows no key building:part. Both get a value of `building` that `towns/furniture/buildings.py` understands: courtyard
and part.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

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
