"""A generated scene as the street of a drive: made again of its family and seed, wherever the drive is replayed."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.core.constants import RECORDED
from wcsim.core.reading import escaped
from wcsim.errors import TownError
from wcsim.towns.cache.folder import cache_folder
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import build_scene, scene_digest
from wcsim.towns.scene_folders.families import FAMILIES, write_scene

_NAME: Final = re.compile(r"([a-z-]{1,40}) (\d{1,18}) ([0-9a-f]{64})")
_SCENE, _TOWN, _STICK = "scene", "town", "stick.csv"


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeScene:
    """What a drive's header says of it."""

    family: str
    seed: int
    sha256: str  # over the scene's files

    def told(self) -> str:
        """As the header has it.

        >>> made_scene_of(MadeScene(family="car-door", seed=7, sha256="0" * 64).told()).seed
        7
        """
        return f"{self.family} {self.seed} {self.sha256}"


def made_scene_of(text: str) -> MadeScene:
    """The scene that a header names. Raises TownError when it names none that this wcsim knows."""
    found = _NAME.fullmatch(text)
    if found is None or found[1] not in FAMILIES:
        raise TownError(
            f"the drive was in the scene {escaped(text, 80)}, which this wcsim does not know; expected one of "
            f"{', '.join(FAMILIES)}, with seed and hash: use the wcsim that recorded it"
        )
    return MadeScene(family=found[1], seed=int(found[2]), sha256=found[3])


def town_of_scene(scene: MadeScene) -> Town:
    """Its street. Raises TownError when this wcsim draws another scene of that seed."""
    return find_town(str(_folder_of(scene) / _TOWN))


def user_of_scene(scene: MadeScene) -> str:
    """The recorded joystick that sits in it, as a seat names it. Raises what `town_of_scene` does."""
    return f"{RECORDED}{_folder_of(scene) / _SCENE / _STICK}"


def _folder_of(scene: MadeScene) -> Path:
    """The scene and its street in the cache, made where they are not there yet."""
    held = cache_folder() / "drive-scenes"
    folder = held / f"{scene.family}-{scene.seed}-{scene.sha256[:16]}"
    if folder.is_dir():
        return folder
    try:
        held.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=held, prefix=".") as work:
            made = Path(work) / "made"
            _make(scene, made)
            _put(made, folder)
    except OSError as error:
        told = f"{escaped(folder)}: cannot be written ({error.strerror}); free some space, or clear the cache"
        raise TownError(told) from None
    return folder


def _make(scene: MadeScene, folder: Path) -> None:
    got = scene_digest(write_scene(scene.family, scene.seed, folder / _SCENE))
    if got != scene.sha256:
        raise TownError(
            f"the drive was in the scene {scene.family} {scene.seed} ({scene.sha256[:12]}), this wcsim generates "
            f"another one ({got[:12]}); expected the same: use the wcsim that recorded it"
        )
    build_scene(folder / _SCENE, folder / _TOWN)


def _put(made: Path, folder: Path) -> None:
    """Into its place, unless somebody else was there first."""
    try:
        made.rename(folder)
    except OSError:
        if not folder.is_dir():
            raise
