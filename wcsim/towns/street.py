"""A town's street: built once, by `build_street.py`, and kept in a cache."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from dataclasses import replace

import cv2
import networkx
import numba
import numpy as np
import shapely
import zstandard

from wcsim.core.sources import sources_of
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.folder import shown_cache
from wcsim.towns.cache.street_cache import cached_street
from wcsim.towns.ground.tiles import Packed
from wcsim.towns.scenario.town import Town, content_hash
from wcsim.types import Street

log = logging.getLogger("wcsim.towns")

LIBRARIES = (cv2, networkx, numba, np, shapely, zstandard)
_BUILDER = build_street.__module__


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
        say(f"building the street of {town.name}, up to a minute; it is done once, and kept in {shown_cache()}")
        return build_street(town)

    return cached_street(street_key(town), built)


def street_key(town: Town) -> str:
    """Name of a town's state: its SUMO files, what town.toml says of its ground, and what makes a street of it."""
    file = town.file
    ground = f"{file.origin_m} {file.kerb_height_m} {file.lowered_kerb_m} {file.chair_ways}"
    still = content_hash(replace(town, routes=()))  # traffic leaves the street as it is
    return hashlib.sha256(f"{still} {ground} {_maker_digest()}".encode()).hexdigest()[:32]


def _maker_digest() -> str:
    """SHA-256 over the code that makes a street, by source text, and the versions of the libraries that it uses."""
    versions = " ".join(str(library.__version__) for library in LIBRARIES)
    digest = hashlib.sha256(f"{versions} {shapely.geos_version_string}".encode())
    for path in sources_of(_BUILDER):
        digest.update(path.read_bytes())
    return digest.hexdigest()
