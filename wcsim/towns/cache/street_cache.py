"""The cache of built streets: one .npz file for each state of a town, written whole or not at all."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wcsim.core.files import alone
from wcsim.towns.cache.folder import cache_folder, write_whole
from wcsim.towns.cache.pread_file import PreadFile
from wcsim.towns.cache.street_arrays import street_of
from wcsim.towns.ground.tiles import Packed
from wcsim.types import Street


def cached_street(key: str, build: Callable[[], Packed]) -> Street:
    """The street kept under `key`, or a new one, which is kept where that is possible."""
    path = cache_folder() / f"street-{key}.npz"
    found = _read(path)
    if found is not None:
        return found
    with alone(path.with_suffix(".lock")):  # worlds that begin together build it once
        found = _read(path)  # somebody else may have built it meanwhile
        if found is not None:
            return found
        packed = build()
        write_whole(path, lambda file: _save(file, packed))
    return _read(path) or street_of(packed)  # from the file, if there is one, so that only what is used is in memory


def _save(path: Path, packed: Packed) -> None:
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **packed)


def _read(path: Path) -> Street | None:
    """A street over an open file, from which its tiles are read later."""
    try:
        if not zipfile.is_zipfile(path):
            return None
        data = np.load(PreadFile(path), allow_pickle=False)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    try:
        return street_of(data)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        data.close()
        return None
