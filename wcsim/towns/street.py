"""A town's street: built once, by `build_street.py`, and kept in a cache."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from types import MappingProxyType

from wcsim.core.sources import sources_of
from wcsim.towns.cache.folder import shown_cache
from wcsim.towns.cache.street_arrays import street_of
from wcsim.towns.cache.street_cache import cached_street
from wcsim.towns.ground.tiles import Packed
from wcsim.towns.scenario.town import Town, content_hash
from wcsim.types import Street

log = logging.getLogger("wcsim.towns")

LIBRARIES = MappingProxyType(
    {
        "cv2": "opencv-python-headless",
        "filelock": "filelock",
        "networkx": "networkx",
        "numba": "numba",
        "numpy": "numpy",
        "shapely": "shapely",
        "zstandard": "zstandard",
    }
)
"""What a street is made with: modules, and the distributions they come from."""
_BUILDER = "wcsim.towns.build_street"


def load_street(town: Town, say: Callable[[str], object] = log.warning) -> Street:
    """The street of a town, from the cache where it is there.

    Args:
        town: The town.
        say: Called with a line before a street is built. By default a warning is logged: Python shows those on
            standard error to whoever has set up no logging, as the user of an environment.

    Raises:
        TownError: The town cannot be used.
    """

    def built() -> Packed:
        from wcsim.towns.build_street import build_street  # heavy, and not needed where the street is there

        say(f"building the street of {town.name}, up to a minute; it is done once, and kept in {shown_cache()}")
        return build_street(town)

    if town.passing:
        from wcsim.towns.build_street import build_street

        return street_of(build_street(town))
    return cached_street(street_key(town), built)


def street_key(town: Town) -> str:
    """Name of a town's state: its SUMO files, what town.toml says of its ground, and what makes a street of it."""
    file = town.file
    ground = f"{file.origin_m} {file.kerb_height_m} {file.lowered_kerb_m} {file.chair_ways}"
    still = content_hash(replace(town, routes=()))  # traffic leaves the street as it is
    return hashlib.sha256(f"{still} {ground} {_maker_digest()}".encode()).hexdigest()[:32]


def _maker_digest() -> str:
    """SHA-256 over the code that makes a street, by source text, and the versions of the libraries that it uses."""
    versions = " ".join(version(distribution) for distribution in LIBRARIES.values())
    digest = hashlib.sha256(versions.encode())
    for path in sources_of(_BUILDER):
        digest.update(path.read_bytes())
    return digest.hexdigest()
