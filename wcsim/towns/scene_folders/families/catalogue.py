"""All families by name, and a scene of one written as a folder."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

import numpy as np

from wcsim.core import seeding
from wcsim.errors import ConfigError, meant
from wcsim.towns.scene_folders.families.cars_and_buses import bus_at_corner, car_door
from wcsim.towns.scene_folders.families.draft import Draft, files_of, mirrored
from wcsim.towns.scene_folders.families.edges_and_walls import (
    footplate_swing,
    reversing_off_kerb,
    turning_beside_drop,
    twisted_ramp,
)
from wcsim.towns.scene_folders.families.overtaking import overtaking_rider, scooter_cuts_in
from wcsim.towns.scene_folders.families.walkers import oncoming_pair, person_turns_round

_DRAWN = MappingProxyType[str, Callable[[np.random.Generator], Draft]](
    {
        "bus-at-corner": bus_at_corner,
        "car-door": car_door,
        "footplate-swing": footplate_swing,
        "oncoming-pair": oncoming_pair,
        "overtaking-rider": overtaking_rider,
        "person-turns-round": person_turns_round,
        "reversing-off-kerb": reversing_off_kerb,
        "scooter-cuts-in": scooter_cuts_in,
        "turning-beside-drop": turning_beside_drop,
        "twisted-ramp": twisted_ramp,
    }
)
FAMILIES: tuple[str, ...] = tuple(_DRAWN)


def write_scene(family: str, seed: int, folder: Path) -> Path:
    """Write the scene of a family that a seed draws, whole or not at all: plain XML, a joystick and `scene.toml`.

    Args:
        family: One of `FAMILIES`.
        seed: 0 or more; the same seed writes the same bytes.
        folder: To make; its parents are made too.

    Returns:
        The folder.

    Raises:
        ConfigError: There is no such family, the seed is negative, or the folder is there already or cannot be made.
    """
    if family not in FAMILIES:
        known = ", ".join(FAMILIES)
        raise ConfigError(f"unknown family of scenes {family!r}; expected one of: {known}{meant(family, FAMILIES)}")
    if seed < 0:
        raise ConfigError(f"seed {seed} cannot be used; expected 0 or more")
    if folder.exists():
        raise ConfigError(f"{folder} already exists; choose another name, or remove it first")
    rng = seeding.generator(seed, "scene", family)
    flipped = bool(rng.integers(2))
    draft = _DRAWN[family](rng)
    files = files_of(mirrored(draft) if flipped else draft, f"{family}-{seed}", seeding.derive(seed, "scene", family))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".new-") as work:
            part = Path(work) / "scene"
            part.mkdir()
            for name, text in files.items():
                (part / name).write_text(text, encoding="utf-8")
            part.rename(folder)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from None
    return folder
