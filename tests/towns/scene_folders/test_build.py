import shutil
from pathlib import Path

import numpy as np
import pytest

from wcsim.errors import ConfigError, SumoError, TownError
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.scenario.town import content_hash
from wcsim.towns.scene_folders.build import build_scene, find_scene, list_scenes
from wcsim.types import ClassId


def test_shipped_scenes_are_found_and_build_and_their_seats_start_on_pavement(tmp_path: Path) -> None:
    names = [folder.name for folder in list_scenes()]
    assert {"kerb-drop", "pedestrian-crossing"} <= set(names)
    for name in names:
        town, scene = build_scene(find_scene(name), tmp_path / name)
        assert (town.split, town.file.origin_m, town.name) == ("scene", (0, 0), scene.name)
        validate_net(town.net)
        grid = unpack_street(build_street(town)).grid
        for seat in scene.seats:
            assert grid.class_at(np.array(seat.start_m)) in (ClassId.SIDEWALK, ClassId.CROSSWALK), name


def test_building_twice_gives_the_same_town(tmp_path: Path) -> None:
    towns = [build_scene(find_scene("kerb-drop"), tmp_path / part)[0] for part in ("a", "b")]
    assert content_hash(towns[0]) == content_hash(towns[1])
    assert towns[0].net.read_bytes() == towns[1].net.read_bytes()


def test_faults_in_scenes_are_named(tmp_path: Path) -> None:
    with pytest.raises(TownError, match=r"unknown scene 'moon'.*kerb-drop"):
        find_scene("moon")
    scene = tmp_path / "scene"
    shutil.copytree(find_scene("kerb-drop"), scene)
    (scene / "more.edg.xml").write_text("<edges/>")
    with pytest.raises(TownError, match=r"2 files \*\.edg\.xml"):
        build_scene(scene, tmp_path / "work")
    (scene / "more.edg.xml").unlink()
    (scene / "street.nod.xml").write_text("<nodes/>")
    with pytest.raises(SumoError, match="scene kerb-drop"):
        build_scene(scene, tmp_path / "work")
    (scene / "scene.toml").write_text("name = 3")
    with pytest.raises(ConfigError, match="name"):
        build_scene(scene, tmp_path / "work")
