"""Streets that the tests of this package share."""

from __future__ import annotations

from pathlib import Path

import pytest

from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.ground.tiles import Packed
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import build_scene, find_scene
from wcsim.types import Street

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="session")
def corner_town(tmp_path_factory: pytest.TempPathFactory) -> Town:
    """A hand-written crossroads with pavements and four zebra crossings."""
    return build_scene(find_scene("pedestrian-crossing"), tmp_path_factory.mktemp("corner"))[0]


@pytest.fixture(scope="session")
def corner(corner_town: Town) -> Street:
    return unpack_street(build_street(corner_town))


@pytest.fixture(scope="session")
def manhattan_town() -> Town:
    return find_town(str(REPOSITORY / "scenarios" / "sumo" / "manhattan"))


@pytest.fixture(scope="session")
def manhattan_packed(manhattan_town: Town) -> Packed:
    return build_street(manhattan_town)


@pytest.fixture(scope="session")
def manhattan(manhattan_packed: Packed) -> Street:
    return unpack_street(manhattan_packed)
