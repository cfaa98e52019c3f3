import os
import subprocess
import sys
from pathlib import Path

import pytest

from wcsim.towns.osm.read import side_at

LEFT = {
    "Leeds": (-1.53, 53.80),
    "Belfast": (-5.93, 54.60),
    "Dublin": (-6.26, 53.35),
    "Douglas": (-4.48, 54.15),
    "Valletta": (14.51, 35.90),
    "Nicosia": (33.36, 35.17),
    "Nicosia, north": (33.36, 35.19),
    "Tokyo": (139.70, 35.68),
    "Sydney": (151.21, -33.87),
    "Perth": (115.86, -31.95),
    "Auckland": (174.76, -36.85),
    "Cape Town": (18.42, -33.92),
    "Maputo": (32.58, -25.97),
    "Nairobi": (36.82, -1.29),
    "Hong Kong": (114.16, 22.28),
    "Macau": (113.543, 22.199),
    "Singapore": (103.85, 1.29),
    "Kuala Lumpur": (101.69, 3.14),
    "Mumbai": (72.87, 19.07),
    "Lahore": (74.35, 31.55),
    "Dhaka": (90.40, 23.80),
    "Colombo": (79.86, 6.93),
    "Bangkok": (100.50, 13.75),
    "Nong Khai": (102.74, 17.88),
    "Udon Thani": (102.79, 17.41),
    "Bueng Kan": (103.65, 18.36),
    "Nakhon Phanom": (104.78, 17.40),
    "Mukdahan": (104.72, 16.54),
    "Khong Chiam": (105.50, 15.32),
    "Nan": (100.77, 18.78),
    "Jakarta": (106.83, -6.18),
    "Dili": (125.57, -8.56),
    "Kingston": (-76.79, 17.97),
    "Charlotte Amalie": (-64.93, 18.34),
    "Paramaribo": (-55.20, 5.85),
    "Suva": (178.44, -18.14),
    "Apia": (-171.76, -13.83),
}
RIGHT = {
    "Calais": (1.86, 50.95),
    "Paris": (2.35, 48.85),
    "Lisbon": (-9.14, 38.72),
    "Gibraltar": (-5.353, 36.14),
    "Berlin": (13.44, 52.47),
    "Helsinki": (24.94, 60.17),
    "Monaco": (7.42, 43.74),
    "New York": (-73.98, 40.77),
    "San Juan": (-66.10, 18.46),
    "Cayenne": (-52.33, 4.93),
    "Shenzhen": (114.06, 22.54),
    "Zhuhai": (113.57, 22.27),
    "Taipei": (121.56, 25.04),
    "Seoul": (126.98, 37.57),
    "Vientiane": (102.60, 17.97),
    "Thakhek": (104.81, 17.41),
    "Hanoi": (105.85, 21.03),
    "Haiphong": (106.68, 20.86),
    "Vinh": (105.69, 18.67),
    "Dong Hoi": (106.60, 17.47),
    "Dien Bien Phu": (103.02, 21.39),
    "Lao Cai": (103.97, 22.48),
    "Hue": (107.58, 16.46),
    "Ho Chi Minh City": (106.66, 10.78),
    "Yangon": (96.16, 16.80),
    "Kabul": (69.20, 34.50),
    "Goma": (29.22, -1.68),
    "Lubumbashi": (27.48, -11.66),
    "Luanda": (13.23, -8.83),
    "Pago Pago": (-170.70, -14.28),
    "Manila": (120.98, 14.60),
    "the open sea": (-30.0, 0.0),
}


@pytest.mark.parametrize("place", [*LEFT, *RIGHT])
def test_traffic_keeps_to_the_side_of_the_country(place: str) -> None:
    side = side_at(*(LEFT | RIGHT)[place])
    assert side.lefthand == (place in LEFT), f"{place}: {side}"


def test_the_reason_is_said() -> None:
    assert str(side_at(*LEFT["Tokyo"])) == "left (time zone Asia/Tokyo)"
    assert str(side_at(*RIGHT["Hanoi"])) == "right (Vietnam, in time zone Asia/Bangkok)"
    assert str(side_at(-30.0, 0.0)) == "right (country unknown)"


def test_the_zone_is_found_where_wcsims_cache_alone_can_be_written(tmp_path: Path) -> None:
    code = (
        "from numba.core import caching\n"
        "for place in (caching.InTreeCacheLocator, caching.UserWideCacheLocator):\n"
        "    place.from_function = classmethod(lambda *_: None)\n"
        "from wcsim.towns.osm.read import side_at\n"
        "print(side_at(139.70, 35.68))"
    )
    env = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (0, "left (time zone Asia/Tokyo)\n", "")
    assert list(tmp_path.glob("wcsim/kernels/*/*.nbi"))
