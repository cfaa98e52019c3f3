"""What OpenStreetMap's tags say about being on the ground, below it, above it, or indoors, and lengths in them."""

import re
from collections.abc import Mapping

_FOOT_M = 0.3048
_INSIDE = ("underground", "indoor", "roof", "rooftop", "overhead", "overground", "kiosk")
_NO = ("", "no")
STOREY_M = 3.2


def metres(text: str) -> float | None:
    """A length in OpenStreetMap's spelling, or None; of several the largest.

    >>> metres("12.5 m"), metres("40 ft"), metres("3;4,5"), metres("12'"), metres("about ten")
    (12.5, 12.192, 4.5, 3.6576, None)
    """
    known = [value for value in map(_one, text.split(";")) if value is not None]
    return max(known) if known else None


def _one(text: str) -> float | None:
    plain = text.strip().lower().replace(",", ".").lstrip("~")
    feet = re.fullmatch(r"(\d{1,4}(?:\.\d+)?)\s*'\s*(?:(\d{1,2}(?:\.\d+)?)\s*\")?", plain)
    if feet:
        return round((float(feet[1]) + float(feet[2] or 0.0) / 12.0) * _FOOT_M, 4)
    found = re.fullmatch(r"(-?\d{1,6}(?:\.\d+)?)\s*(m|metre|metres|meter|meters|ft|feet)?", plain)
    if not found:
        return None
    return round(float(found[1]) * (_FOOT_M if found[2] in ("ft", "feet") else 1.0), 4)


def off_ground(tags: Mapping[str, str]) -> bool:
    """True for things that are not on the street: under ground, indoors, on bridges or upper floors.

    >>> off_ground({"level": "0;1"}), off_ground({"level": "-1"}), off_ground({"layer": "1"}), off_ground({})
    (False, True, True, False)
    """
    return (
        number(tags, "layer") != 0.0
        or not _has_ground_level(tags.get("level", ""))
        or tags.get("location", "") in _INSIDE
        or tags.get("indoor", "no") not in _NO
        or tags.get("tunnel", "no") not in _NO
        or tags.get("bridge", "no") not in _NO
        or rise_m(tags) > 2.0
    )


def rise_m(tags: Mapping[str, str]) -> float:
    """How far above the ground a thing begins: 0 for what stands on it.

    >>> rise_m({"min_height": "4 m"}), rise_m({"building:min_level": "2"}), rise_m({"min_height": "low"})
    (4.0, 6.4, 0.0)
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


def _has_ground_level(text: str) -> bool:
    """True for no level at all, or levels with 0 among them; "0-2" names 0 and 2."""
    levels = [float(found) for found in re.findall(r"-?\d+(?:\.\d+)?", text)]
    return not levels or 0.0 in levels
