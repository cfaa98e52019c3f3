"""States of warmed traffic: SUMO saves one, and every world of this scenario and seed loads it.

A state is made by steps of a second, which takes a fifth of the time. A world never goes on from
the steps that made it: it loads what was saved. So it is the same whether the state was there
before or not.
"""

import gzip
import re
import zlib
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Final

from wcsim.core.files import sha256_from_text, write_bytes
from wcsim.errors import DiskFullError
from wcsim.towns.cache.folder import cache_folder, remove_older_half

COARSE_STEP_S: Final = 1.0
SAVING: Final = {
    "save_state.transportables": "true",
    "save_state.precision": "16",
}
"""SUMO's options for a state that has people, and numbers with all digits.

It has no random numbers: SUMO saves how many a process has drawn, over all of its runs.
"""
_LEAST_S: Final = 60.0  # a shorter warm-up costs little; scenes time their actors to a tick
_FORM: Final = 1  # of these files; another one makes all of them anew
_MOST_STATES: Final = 1000  # 20 kB each in a town


def coarse_warmup_s(warmup_s: float, tick_s: float) -> float:
    """The part of a warm-up that is made by coarse steps; the rest is made by ticks.

    >>> coarse_warmup_s(240.5, 0.1), coarse_warmup_s(30.0, 0.1), coarse_warmup_s(241.0, 0.3)
    (240.0, 0.0, 0.0)
    """
    coarse_s = warmup_s // COARSE_STEP_S * COARSE_STEP_S
    ticks = coarse_s / tick_s
    if coarse_s < _LEAST_S or abs(ticks - round(ticks)) > 1e-6:
        return 0.0
    return coarse_s


def state_file(digest: str, seed: int, coarse_s: float) -> Path:
    """Where the cache has the state.

    Args:
        digest: Of the scenario, see `Scenario`.
        seed: SUMO's own.
        coarse_s: As of `coarse_warmup_s`.
    """
    state = f"{digest} {version('libsumo')} {seed} {coarse_s!r} {SAVING} {_FORM}"
    return cache_folder() / f"warm-{sha256_from_text(state)[:32]}.xml.gz"


def read_state(path: Path) -> bytes | None:
    """The state of that file; None where there is none, or a damaged one."""
    try:
        return gzip.decompress(path.read_bytes()) or None
    except (OSError, EOFError, zlib.error):
        return None


def save_state(path: Path, state: bytes) -> None:
    """Save a state for the worlds to come; a cache that cannot be written is no error."""
    with suppress(DiskFullError):
        write_bytes(path, gzip.compress(state, compresslevel=3, mtime=0))
    remove_older_half(path, _MOST_STATES)


def mend_state(state: bytes) -> bytes:
    """Close two gaps in a state that SUMO 1.28 has saved.

    SUMO skips what its reader of routes has read, and with it all that departs in the very
    millisecond that the reader has reached: a town's walkers of ten minutes. From a millisecond
    earlier on, it reads some of them twice, and ignores the second.

    And it reads back a vehicle's advices for changes of lane, but not whether they may make it
    brake: that byte is whatever lay in memory. Without advices it is not looked at.
    """
    reached = re.compile(rb'(?<= loaderTime=")[0-9]+(?=")')
    state = reached.sub(lambda found: b"%d" % max(0, int(found[0]) - 1), state)
    return re.sub(rb'(?<= lcStateBase=")([^" ]+)[^"]*(?=")', rb"\1", state)
