"""A town by the word that a user types: a name, a path, or `made:SEED`."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.config.held_out import refuse_held_out
from wcsim.core.reading import escape
from wcsim.errors import ConfigError, TownError
from wcsim.towns.cache.folder import cache_folder
from wcsim.towns.scenario.town import Town, find_town, open_town, own_work

MADE: Final = "made"
KINDS = ("grid", "spider", "random")
SIZES_M = (300.0, 1500.0)
MOST_SEED = 2**31 - 1  # SUMO takes no larger one
HIGHEST_M = 200.0
MOST_TRAFFIC = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """Properties of a generated town that the seed does not choose."""

    size_m: float = 700.0  # about, from edge to edge
    kind: str = ""  # of the streets, one of KINDS; "": the seed's choice
    split: str = "train"  # or "test"
    traffic: float = 1.0  # how dense, against `demand.MIX`; 0: none
    parked: float = 0.7  # share of the parking spaces that is taken
    hill_m: float | None = None  # height of its land; None: the seed's choice


def check_town_properties(seed: int, wishes: Wishes) -> None:
    """Raise TownError for a seed that is none, or a property out of its limits."""
    if not 0 <= seed <= MOST_SEED:
        raise TownError(f"seed {seed}; expected 0 to {MOST_SEED}")
    if not SIZES_M[0] <= wishes.size_m <= SIZES_M[1]:
        raise TownError(
            f"a size of {wishes.size_m:g} m; "
            f"expected {SIZES_M[0]:g} to {SIZES_M[1]:g} m from edge to edge"
        )
    if wishes.kind not in ("", *KINDS):
        known = ", ".join(KINDS)
        raise TownError(f"unknown kind {wishes.kind!r} of streets; expected one of: {known}")
    if not 0.0 <= wishes.traffic <= MOST_TRAFFIC or not 0.0 <= wishes.parked <= 1.0:
        raise TownError(
            f"traffic {wishes.traffic:g}, parked {wishes.parked:g}; "
            f"expected 0 to {MOST_TRAFFIC:g}, and 0 to 1"
        )
    if wishes.hill_m is not None and not 0.0 <= wishes.hill_m <= HIGHEST_M:
        raise TownError(
            f"a hill of {wishes.hill_m:g} m is not possible; expected 0 to {HIGHEST_M:g} m"
        )


def requested_town(word: str) -> Town:
    """The town to train in that a word means; `made:SEED` is made where the cache has none.

    Raises:
        ConfigError: A seed is none.
        TownError: There is no such town, or it cannot be made.
        SumoError: One of SUMO's tools failed.
    """
    seed = made_seed(word)
    if seed is None:
        return find_town(word)
    return made_town(cache_folder() / "train-towns", seed, "train")


def refuse_held_out_town(town: Town) -> None:
    """Raise ConfigError for a made town that is kept for tests, whatever it is called."""
    found = re.search("town make .*--seed ([0-9]+)", town.file.rebuild)
    refuse_held_out("town", (f"{MADE}:{found[1]}",) if found else (), town.name)


def made_seed(word: str) -> int | None:
    """The seed of `made:SEED`; None for any other word.

    >>> made_seed("made:7"), made_seed("helsinki")
    (7, None)

    Raises:
        ConfigError: The seed is none.
    """
    kind, colon, seed = word.partition(":")
    if kind != MADE or not colon:
        return None
    if not seed.isdecimal() or int(seed) >= 1 << 31:
        raise ConfigError(
            f"town {escape(word)!r}: expected {MADE}:SEED with a seed below 2147483648"
        )
    return int(seed)


def made_town(folder: Path, seed: int, split: str = "test") -> Town:
    """The town `made-SEED` in a folder, made if it is not there as it was made.

    Raises:
        TownError: It cannot be made.
        SumoError: One of SUMO's tools failed.
    """
    out = folder / f"{MADE}-{seed}"
    if out.is_dir() and not own_work(out):
        return open_town(out)
    # It loads what builds streets.
    from wcsim.towns.making.maker import make_town

    return make_town(out, seed, Wishes(split=split), overwrite=True)
