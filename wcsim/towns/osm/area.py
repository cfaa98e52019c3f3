"""Areas on the globe, in degrees as OpenStreetMap and SUMO's tools take them, and the driving side of a place.

The time zone of a place gives the country, and the country gives the side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from wcsim.core.frames import rad
from wcsim.errors import TownError

Box = tuple[float, float, float, float]
"""west, south, east, north in degrees."""

LONGEST_M = 12_000.0  # of a side: netconvert and the street mesh of more take minutes and gigabytes
_M_PER_DEG = 111_320.0

# IANA time zones of the countries and territories that drive on the left.
_LEFT = frozenset(
    f"{region}/{city}"
    for region, cities in {
        "Europe": "London Dublin Jersey Guernsey Isle_of_Man Malta",
        "Asia": (
            "Nicosia Famagusta Karachi Kolkata Colombo Kathmandu Thimphu Dhaka Bangkok "
            "Kuala_Lumpur Kuching Singapore Brunei Jakarta Pontianak Makassar Jayapura Dili Tokyo "
            "Hong_Kong Macau"
        ),
        "Africa": (
            "Johannesburg Maseru Mbabane Windhoek Gaborone Harare Lusaka Maputo Blantyre Dar_es_Salaam Nairobi Kampala"
        ),
        "Indian": "Maldives Mauritius Mahe Christmas Cocos",
        "Australia": ("Adelaide Brisbane Broken_Hill Darwin Eucla Hobart Lindeman Lord_Howe Melbourne Perth Sydney"),
        "Antarctica": "Macquarie",
        "Pacific": (
            "Auckland Chatham Port_Moresby Bougainville Guadalcanal Fiji Tongatapu Apia Nauru Tarawa Kanton "
            "Kiritimati Funafuti Rarotonga Niue Fakaofo Norfolk Pitcairn"
        ),
        "Atlantic": "Bermuda Stanley South_Georgia St_Helena",
        "America": (
            "Jamaica Nassau Cayman Grand_Turk Barbados Port_of_Spain Antigua St_Kitts Dominica St_Lucia St_Vincent "
            "Grenada Anguilla Montserrat Tortola St_Thomas Guyana Paramaribo"
        ),
    }.items()
    for city in cities.split()
)
_SHARED = "Asia/Bangkok"  # of Thailand, and of Vietnam north of the 17th parallel, where traffic keeps right
_VIETNAM_DEG = ((105.0, 16.5), (102.0, 18.55))  # of that zone, what lies east and north of either; Laos lies between


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
    west, south, east, north = grown((*box_centre(box), *box_centre(box)), 500.0)
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


def box_centre(box: Box) -> tuple[float, float]:
    """Longitude and latitude of the middle of a box."""
    west, south, east, north = box
    return (west + east) / 2, (south + north) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """The side of the street that traffic keeps to, and why it is believed to."""

    lefthand: bool
    why: str

    def __str__(self) -> str:
        """In words: "left (time zone Asia/Tokyo)"."""
        return f"{'left' if self.lefthand else 'right'} ({self.why})"


def side_at(longitude_deg: float, latitude_deg: float) -> Side:
    """The side on which traffic drives at a place; on the right where no country is known.

    >>> str(side_at(139.70, 35.68)), str(side_at(1.86, 50.95))
    ('left (time zone Asia/Tokyo)', 'right (time zone Europe/Paris)')
    """
    from timezonefinder import TimezoneFinder  # half a second, which only an import needs

    zone = TimezoneFinder().timezone_at(lng=longitude_deg, lat=latitude_deg)
    known = zone is not None and not zone.startswith("Etc/")  # those lie at sea
    if zone == _SHARED and _in_vietnam(longitude_deg, latitude_deg):
        return Side(lefthand=False, why=f"Vietnam, in time zone {zone}")
    return Side(lefthand=zone in _LEFT, why=f"time zone {zone}" if known else "country unknown")


def _in_vietnam(longitude_deg: float, latitude_deg: float) -> bool:
    """Whether a place of the time zone that Thailand and Vietnam share lies in Vietnam."""
    return any(longitude_deg > west_deg and latitude_deg > south_deg for west_deg, south_deg in _VIETNAM_DEG)
