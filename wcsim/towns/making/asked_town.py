"""A town by the word that a user types: a name, a path, or `made:SEED` for one that is generated."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from wcsim.core.reading import escaped
from wcsim.errors import ConfigError
from wcsim.towns.cache.folder import cache_folder
from wcsim.towns.making.wishes import Wishes
from wcsim.towns.scenario.manifest import own_work
from wcsim.towns.scenario.town import Town, find_town, open_town

MADE: Final = "made"


def asked_town(word: str) -> Town:
    """The town to train in that a word means; `made:SEED` is saved in the cache, and made again where it is not there.

    Raises:
        ConfigError: A seed is none.
        TownError: There is no such town, or it cannot be made.
        SumoError: One of SUMO's tools failed.
    """
    seed = made_seed(word)
    return find_town(word) if seed is None else made_town(cache_folder() / "train-towns", seed, "train")


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
        raise ConfigError(f"town {escaped(word)!r}: expected {MADE}:SEED with a seed below 2147483648")
    return int(seed)


def made_town(folder: Path, seed: int, split: str = "test") -> Town:
    """The town `made-SEED` in a folder, made if it is not there as it was made. Raises TownError or SumoError."""
    out = folder / f"{MADE}-{seed}"
    if out.is_dir() and not own_work(out):
        return open_town(out)
    from wcsim.towns.making.maker import make_town  # loads what builds streets

    return make_town(out, seed, Wishes(split=split), overwrite=True)
