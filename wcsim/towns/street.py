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


def load_street(town: Town, say: Callable[[str], object] | None = None) -> Street:
    """The street of a town, from the cache where it is there.

    Args:
        town: The town.
        say: Called every few seconds while a street is built, from a thread of its own, with a
            line: which part, and
            for how long already. By default a warning is logged: Python shows those on standard
            error where no
            logging was set up, as by the user of an environment.

    Raises:
        TownError: The town cannot be used.
    """

    def built() -> Packed:
        # Heavy, and not needed where the street is there.
        from wcsim.towns.build_street import build_street

        with _progress(town, say or log.warning) as at:
            return build_street(town, at)

    return unpack_street(built()) if town.passing else cached_street(_street_key(town), built)


@contextmanager
def _progress(town: Town, say: Callable[[str], object]) -> Iterator[Callable[[str], object]]:
    """Report the part of a street that is being built, as the builder names it."""
    over, began_s, parts = Event(), time.monotonic(), ["net"]
    once = "" if town.passing else " (once, then cached)"

    def report() -> None:
        more = once
        while not over.wait(_EVERY_S):
            with suppress(OSError):  # who listened is gone
                say(
                    f"street of {town.name}{more}: {parts[-1]}, after {time.monotonic() - began_s:.0f} s"
                )
            more = ""

    reporter = Thread(target=report, daemon=True)
    reporter.start()
    try:
        yield parts.append
    finally:
        over.set()
        reporter.join()


def _street_key(town: Town) -> str:
    """Name of a town's state.

    Its SUMO files, what town.toml says of its ground, and what makes a street of it.
    """
    file = town.file
    ground = f"{file.origin_m} {file.kerb_height_m} {file.lowered_kerb_m} {file.chair_ways}"
    still = content_hash(replace(town, routes=()))  # traffic leaves the street as it is
    return hashlib.sha256(f"{still} {ground} {_maker_digest()}".encode()).hexdigest()[:32]


@cache  # whoever edits the code of a process that runs changes nothing of what it makes
def _maker_digest() -> str:
    """SHA-256 over the code that makes a street, its text and data, and the versions of libraries that it uses."""
    versions = " ".join(version(distribution) for distribution in LIBRARIES.values())
    digest = hashlib.sha256(versions.encode())
    for path in find_imported_source_files(_BUILDER):
        digest.update(path.read_bytes())
        data = path.with_suffix(".toml")  # that a module reads stands beside it
        digest.update(data.read_bytes() if data.is_file() else b"")
    return digest.hexdigest()
