"""Download an extract with SUMO's own tool, osmGet.py, as a child under limits."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from urllib.parse import urlsplit

from wcsim.errors import SumoError, TownError
from wcsim.towns.osm.area import Box, check_box
from wcsim.towns.sumo.tools import Limits, run_child, sumo_home
from wcsim.towns.sumo.xml_io import MAX_XML_BYTES

WAIT_S = 120.0
_CURE = "try again later or with another --url, or download the area by hand and pass it with --osm FILE"


def download(box: Box, folder: Path, url: str = "", wait_s: float = WAIT_S) -> Path:
    """The extract of an area, from the Overpass server at `url` or from those that SUMO knows, in `folder`.

    Raises TownError with one line when no server answers in time, or answers something else.
    """
    check_box(box)
    if url and (urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).netloc):
        raise TownError(f"--url {url!r} is not a server address; expected http://... or https://...")
    home = sumo_home()
    words = [str(home / "tools" / "osmGet.py"), f"--bbox={','.join(map(repr, box))}", "--prefix", "area"]
    words += ["--output-dir", str(folder), "--retries", "1", "--retry-delay", "1"]
    words += ["--url", url] if url else []
    environment = os.environ | {"SUMO_HOME": str(home)}
    limits = Limits(wall_s=wait_s, cpu_s=60, memory_bytes=4 << 30, file_bytes=MAX_XML_BYTES)
    where = url or "the Overpass servers"
    try:
        run = run_child("osmGet.py", [sys.executable, *words], folder, environment, limits)
    except SumoError:
        raise TownError(f"{where} did not answer within {wait_s:.0f} s; {_CURE}") from None
    out = folder / "area_bbox.osm.xml"
    if run.returncode or not out.is_file():
        raise TownError(f"no map could be downloaded from {where} ({_last_words(run.output)}); {_CURE}")
    return out


def _last_words(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    words = lines[-1] if lines else "no message"
    return words.removeprefix("urllib.error.")[:200]
