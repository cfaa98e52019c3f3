"""What stands in a town, as SUMO's polygon files say: buildings, fences, and points such as trees and benches."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from wcsim.errors import TownError
from wcsim.towns.netread import points
from wcsim.towns.xmlio import read_root
from wcsim.types import F64


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One thing: an outline, a line, or a point."""

    id: str
    kind: str  # the last word of SUMO's type: "building.yes" is kind "building", "natural.tree" is "tree"
    detail: str
    points_W_m: F64  # (K, 2); K = 1 for a point
    filled: bool
    tags: dict[str, str]  # OpenStreetMap's


def read_items(files: tuple[Path, ...], origin_m: tuple[int, int]) -> list[Item]:
    """All polygons and points of interest of SUMO additional files, without doubles. Raises TownError."""
    items: dict[tuple[str, bytes], Item] = {}
    for path in files:
        for element in read_root(path):
            if element.tag in ("poly", "poi"):
                try:
                    item = _item(element, origin_m)
                except (KeyError, ValueError) as error:
                    raise TownError(
                        f"{path}: <{element.tag}> {element.get('id')!r} is broken ({error!r}); correct it"
                    ) from None
                items.setdefault((item.kind, np.round(item.points_W_m, 1).tobytes()), item)
    return list(items.values())


def _item(element: Element, origin_m: tuple[int, int]) -> Item:
    kind = element.get("type", "").removeprefix("wcsim.")
    group, _, detail = kind.partition(".")
    if element.tag == "poi":
        place = points(f"{element.attrib['x']},{element.attrib['y']}", origin_m)
    else:
        place = points(element.attrib["shape"], origin_m)
    return Item(
        id=element.get("id", ""),
        kind="building" if group == "building" else detail or group,
        detail=detail,
        points_W_m=place,
        filled=element.get("fill", "0").lower() in ("1", "true"),
        tags={child.get("key", ""): child.get("value", "") for child in element.iterfind("param")},
    )


def metres(text: str) -> float | None:
    """A length in OpenStreetMap's spelling ("12", "12.5 m"), or None.

    >>> metres("12.5 m"), metres("about ten")
    (12.5, None)
    """
    try:
        value = float(text.strip().removesuffix("m").strip().replace(",", "."))
    except ValueError:
        return None
    return value if np.isfinite(value) else None
