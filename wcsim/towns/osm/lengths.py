"""Lengths as people write them into OpenStreetMap."""

from __future__ import annotations

import re

_FOOT_M = 0.3048


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
