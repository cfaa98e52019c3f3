"""On which side of the street traffic drives, from the place: the time zone of a point says the country."""

from __future__ import annotations

from dataclasses import dataclass

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
