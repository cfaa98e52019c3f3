"""What OpenStreetMap's tags mean: on the ground, below it, above it or indoors, and lengths.

What becomes of the tags of pavements, crossings, kerbs and footways is a table, `tags.toml`.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import shapely

from wcsim.core.reading import read_module_toml
from wcsim.towns.ground.kerb_heights import KerbMark
from wcsim.towns.sumo.additional import Item

_FOOT_M = 0.3048
_UNIT_M = {"cm": 0.01, "ft": _FOOT_M, "feet": _FOOT_M}
_INSIDE = ("underground", "indoor", "roof", "rooftop", "overhead", "overground", "kiosk")
_NO = ("", "no")
STOREY_M = 3.2
_CONDITION = re.compile(r"([\w:]+)([=<>])(\S+)")
_SIDES = {"kerb_left": 1, "kerb_right": -1, "kerb": 0, "barrier": 0}


@dataclass(frozen=True, slots=True, kw_only=True)
class _TagRow:
    """What becomes of some tags: a row of the table."""

    on: str  # what they are on
    tags: str  # key=value|value, key=*, key<number or key>number, with blanks between them
    becomes: str  # in words
    means: str = ""  # word=word; "": they are not read here


ROWS: Final = tuple(_TagRow(**row) for row in read_module_toml(__file__)["row"])


def metres(text: str) -> float | None:
    """A length in OpenStreetMap's spelling, or None; of several the largest.

    >>> metres("12.5 m"), metres("4 cm"), metres("40 ft")
    (12.5, 0.04, 12.192)
    >>> metres("3;4,5"), metres("12'"), metres("about ten")
    (4.5, 3.6576, None)
    """
    known = [value for value in map(_one, text.split(";")) if value is not None]
    return max(known) if known else None


def off_ground(tags: Mapping[str, str]) -> bool:
    """True for things under ground, indoors, on bridges or upper floors.

    >>> off_ground({"level": "0;1"}), off_ground({"level": "-1"})
    (False, True)
    >>> off_ground({"layer": "1"}), off_ground({})
    (True, False)
    """
    # "0-2" names the levels 0 and 2.
    texts = re.findall(r"-?\d+(?:\.\d+)?", tags.get("level", ""))
    levels = [float(text) for text in texts]
    return (
        number(tags, "layer") != 0.0
        or (bool(levels) and 0.0 not in levels)
        or tags.get("location", "") in _INSIDE
        or tags.get("indoor", "no") not in _NO
        or tags.get("tunnel", "no") not in _NO
        or tags.get("bridge", "no") not in _NO
        or rise_m(tags) > 2.0
    )


def rise_m(tags: Mapping[str, str]) -> float:
    """How far above the ground a thing begins: 0 for what stands on it.

    >>> rise_m({"min_height": "4 m"}), rise_m({"min_height": "low"})
    (4.0, 0.0)
    >>> rise_m({"building:min_level": "2"})
    6.4
    """
    height_m = metres(tags.get("min_height", ""))
    if height_m is not None:
        return max(0.0, height_m)
    for key in ("building:min_level", "min_level"):
        storeys = metres(tags.get(key, ""))
        if storeys is not None:
            return max(0.0, STOREY_M * storeys)
    return 0.0


def number(tags: Mapping[str, str], key: str) -> float:
    """A tag as a number; 0 where there is none or it cannot be read."""
    value = metres(tags.get(key, ""))
    return 0.0 if value is None else value


def meanings(on: str, tags: Mapping[str, str]) -> dict[str, str]:
    """What the table makes of the tags of a thing.

    >>> meanings("crossings", {"crossing": "informal"}), meanings("footways", {"width": "80 cm"})
    ({'paint': 'no'}, {'chairs': 'no'})
    """
    found: dict[str, str] = {}
    for row in ROWS:
        conditions = _CONDITION.findall(row.tags) if row.on == on else ()
        if any(_fits(key, sign, values, tags) for key, sign, values in conditions):
            found |= dict(word.split("=") for word in row.means.split())
    return found


def kerb_marks(items: Iterable[Item]) -> list[KerbMark]:
    """The kerbs among the things of a town; many are there twice, as a barrier and as a kerb."""
    found: dict[tuple[int, bytes], KerbMark] = {}
    for item in items:
        barrier = item.group == "barrier"
        if (
            item.group not in _SIDES
            or (barrier and item.detail != "kerb")
            or not len(item.points_W_m)
        ):
            continue
        keys = ("kerb:height", "height") if barrier else ("kerb:height",)
        tags = {key: item.tags[key] for key in keys if metres(item.tags.get(key, "")) is not None}
        word = item.tags.get("kerb", "") if barrier else item.detail
        means = meanings("kerbs", {"kerb": word} | tags).get("height_m")
        if means is None:
            continue
        points = item.points_W_m
        mark = KerbMark(
            line=shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0]),
            height_m=number(tags, next(iter(tags))) if means == "measured" else float(means),
            side=_SIDES[item.group],
            crossing=item.tags.get("highway") == "crossing",
        )
        found.setdefault((mark.side, points.tobytes()), mark)
    return list(found.values())


def _one(text: str) -> float | None:
    plain = text.strip().lower().replace(",", ".").lstrip("~")
    feet = re.fullmatch(r"(\d{1,4}(?:\.\d+)?)\s*'\s*(?:(\d{1,2}(?:\.\d+)?)\s*\")?", plain)
    if feet:
        return round((float(feet[1]) + float(feet[2] or 0.0) / 12.0) * _FOOT_M, 4)
    found = re.fullmatch(
        r"(-?\d{1,6}(?:\.\d+)?)\s*(m|metre|metres|meter|meters|cm|ft|feet)?", plain
    )
    if not found:
        return None
    return round(float(found[1]) * _UNIT_M.get(found[2], 1.0), 4)


def _fits(key: str, sign: str, values: str, tags: Mapping[str, str]) -> bool:
    text = tags.get(key)
    if text is None or values == "*":
        return text is not None
    if sign == "=":
        return not {word.strip() for word in text.split(";")}.isdisjoint(values.split("|"))
    amount = metres(text.rstrip("% "))
    return amount is not None and (
        abs(amount) < float(values) if sign == "<" else abs(amount) > float(values)
    )
