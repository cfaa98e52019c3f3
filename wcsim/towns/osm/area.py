"""Places on the globe, in degrees as OpenStreetMap and SUMO's tools take them."""

from __future__ import annotations

import math

from wcsim.core.frames import rad
from wcsim.errors import TownError

Box = tuple[float, float, float, float]
"""west, south, east, north in degrees."""

LONGEST_M = 12_000.0  # of a side: netconvert and the street mesh of more take minutes and gigabytes
_M_PER_DEG = 111_320.0


def check_box(box: Box) -> None:
    """Raise TownError unless a box is one that a town can be made of."""
    west, south, east, north = box
    if not (-180 <= west < east <= 180 and -84 <= south < north <= 84):
        raise TownError(f"bounding box {box} is not west,south,east,north in degrees, from -84 to 84 north")
    wide_m, high_m = size_m(box)
    if max(wide_m, high_m) > LONGEST_M:
        raise TownError(
            f"the bounding box is {wide_m / 1e3:.0f} x {high_m / 1e3:.0f} km; expected at most "
            f"{LONGEST_M / 1e3:.0f} km each way: choose a part of it, such as its middle: {bbox_option(_core(box))}"
        )


def size_m(box: Box) -> tuple[float, float]:
    """Width and height of a box in metres."""
    west, south, east, north = box
    return (east - west) * _M_PER_DEG * math.cos(rad((south + north) / 2)), (north - south) * _M_PER_DEG


def bbox_option(box: Box) -> str:
    """A box as the command line takes it."""
    return f"--bbox={','.join(map(str, box))}"


def _core(box: Box) -> Box:
    """A kilometre in the middle of a box, in 1e-5 degrees."""
    west, south, east, north = grown((*middle_of(box), *middle_of(box)), 500.0)
    return round(west, 5), round(south, 5), round(east, 5), round(north, 5)


def grown(box: Box, margin_m: float) -> Box:
    """A box with a margin in metres on each side, within the globe."""
    west, south, east, north = box
    high = margin_m / _M_PER_DEG
    wide = high / max(0.05, math.cos(rad((south + north) / 2)))
    return max(-180.0, west - wide), max(-90.0, south - high), min(180.0, east + wide), min(90.0, north + high)


def is_within(place: tuple[float, float], box: Box) -> bool:
    """Whether a place (longitude, latitude) lies in a box."""
    west, south, east, north = box
    return west <= place[0] <= east and south <= place[1] <= north


def middle_of(box: Box) -> tuple[float, float]:
    """Longitude and latitude of the middle of a box."""
    west, south, east, north = box
    return (west + east) / 2, (south + north) / 2
