"""One tree of seeds: every component has a child of its own, by name, not by order of creation.

>>> a, b = make_rng(7, "world"), make_rng(7, "world")
>>> bool(a.integers(1 << 30) == b.integers(1 << 30))
True
>>> int(derive_seed(7, "sumo")) == int(derive_seed(7, "user", 0))
False
"""

import zlib

import numpy as np


def _sequence(seed: int, *path: str | int) -> np.random.SeedSequence:
    """The seed sequence at `path`, such as ("user", seat, episode), under the root `seed` >= 0."""
    key = tuple(zlib.crc32(part.encode()) if isinstance(part, str) else int(part) for part in path)
    return np.random.SeedSequence(seed, spawn_key=key)


def make_rng(seed: int, *path: str | int) -> np.random.Generator:
    """A random generator of its own for the component at `path`."""
    return np.random.Generator(np.random.Philox(_sequence(seed, *path)))


def derive_seed(seed: int, *path: str | int) -> int:
    """A 31-bit integer seed for a library that takes only a number (SUMO, torch)."""
    return int(_sequence(seed, *path).generate_state(1, np.uint32)[0] >> 1)


def derive_rng_key(seed: int, *path: str | int) -> int:
    """A 64-bit key for numbers that depend on a key and a place, such as a pixel's noise."""
    return int(_sequence(seed, *path).generate_state(1, np.uint64)[0])
