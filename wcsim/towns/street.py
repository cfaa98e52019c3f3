"""A town's street: built once, by `build_street.py`, and saved in a cache."""

import hashlib
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from threading import Event, Thread
from types import MappingProxyType

from wcsim.core.sources import find_imported_source_files
from wcsim.towns.cache.street_cache import cached_street, unpack_street
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
_EVERY_S = 5.0  # most streets are ready before the first message


def load_street(town: Town, report: Callable[[str], object] | None = None) -> Street:
    """The street of a town, from the cache where it is there.

    Args:
        town: The town.
        report: Called every few seconds while a street is built, from a thread of its own, with a
            line: which part, and for how long already. By default a warning is logged: Python shows
            those on standard error where no logging was set up, as by the user of an environment.

    Raises:
        TownError: The town cannot be used.
    """

    def built() -> Packed:
        # Heavy, and not needed where the street is there.
        from wcsim.towns.build_street import build_street

        with _progress(town, report or log.warning) as at:
            return build_street(town, at)

    return unpack_street(built()) if town.passing else cached_street(_street_key(town), built)


@contextmanager
def _progress(town: Town, report: Callable[[str], object]) -> Iterator[Callable[[str], object]]:
    """Report the part of a street that is being built, as the builder names it."""
    over, start_s, parts = Event(), time.monotonic(), ["net"]
    once = "" if town.passing else " (once, then cached)"

    def run() -> None:
        more = once
        while not over.wait(_EVERY_S):
            elapsed_s = time.monotonic() - start_s
            # The one who listened may have left.
            with suppress(OSError):
                report(f"street of {town.name}{more}: {parts[-1]}, after {elapsed_s:.0f} s")
            more = ""

    reporter = Thread(target=run, daemon=True)
    reporter.start()
    try:
        yield parts.append
    finally:
        over.set()
        reporter.join()


def _street_key(town: Town) -> str:
    """Name of a town's state: its SUMO files, its ground, and what makes a street of it."""
    file = town.file
    ground = f"{file.origin_m} {file.kerb_height_m} {file.lowered_kerb_m} {file.chair_ways}"
    # Traffic leaves the street as it is.
    still = content_hash(replace(town, routes=()))
    return hashlib.sha256(f"{still} {ground} {_maker_digest()}".encode()).hexdigest()[:32]


# It is cached: an edit of the code of a process that runs changes nothing of what it makes.
@cache
def _maker_digest() -> str:
    """SHA-256 over the code and data that make a street, and the versions of its libraries."""
    versions = " ".join(version(distribution) for distribution in LIBRARIES.values())
    digest = hashlib.sha256(versions.encode())
    for path in find_imported_source_files(_BUILDER):
        digest.update(path.read_bytes())
        # The data of a module stands beside it.
        data = path.with_suffix(".toml")
        digest.update(data.read_bytes() if data.is_file() else b"")
    return digest.hexdigest()
