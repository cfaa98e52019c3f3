"""How a scene's seats become those of a world, a recorded joystick among them."""

import math
from pathlib import Path

import pytest

from wcsim.config import RunConfig, parse, resolve
from wcsim.config.scene import SceneFile
from wcsim.errors import ConfigError, TownError
from wcsim.towns.scene_folders.build import scene_config, seat_specs

SEAT = {"start_m": (12.0, -3.0), "heading_deg": 0.0}


def scene_with(**seat: object) -> SceneFile:
    given = {"name": "a", "shows": "b", "seed": 1, "duration_s": 5.0, "attention_share": 0.25, "warmup_s": 2.0}
    return parse(SceneFile, {**given, "seats": [{**SEAT, **seat}]}, "scene.toml")


def test_a_recording_lies_beside_the_scene_and_drives_its_seat(tmp_path: Path) -> None:
    scene = scene_with(goal_m=(20.0, -3.0), recording="stick.csv")
    with pytest.raises(TownError, match=r"stick\.csv"):
        seat_specs(tmp_path, scene, (0.0, 0.0))
    (tmp_path / "stick.csv").write_text("time_s,x,y\n0,0,0\n0.1,0,0\n")
    (spec,) = seat_specs(tmp_path, scene, (10.0, -10.0))
    assert spec.profile == f"recorded:{tmp_path / 'stick.csv'}"
    assert spec.start is not None
    assert (spec.start.p_W_m, spec.start.goal_W_m) == ((2.0, 7.0), (10.0, 7.0))
    assert spec.start.yaw_rad == pytest.approx(math.pi / 2)


def test_a_recording_cannot_be_a_link_to_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "secret.csv").write_text("")
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "stick.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(TownError, match="outside of its folder"):
        seat_specs(folder, scene_with(goal_m=(20.0, -3.0), recording="stick.csv"), (0.0, 0.0))


@pytest.mark.parametrize("name", ["../stick.csv", "a/b.csv", "stick.txt", ""])
def test_a_recording_is_a_plain_file_name(name: str) -> None:
    with pytest.raises(ConfigError, match="recording"):
        scene_with(goal_m=(20.0, -3.0), recording=name)


def test_a_recording_drives_alone() -> None:
    with pytest.raises(ConfigError, match="no profile"):
        scene_with(goal_m=(20.0, -3.0), recording="stick.csv", profile="competent")
    with pytest.raises(ConfigError, match="needs a goal_m"):
        scene_with(joystick=(0.0, 0.5), recording="stick.csv")


def test_a_scene_has_settings_of_its_own() -> None:
    base = RunConfig()
    world = scene_config(scene_with(goal_m=(20.0, -3.0)), base).world
    assert (world.attention_share, world.warmup_s) == (0.25, 2.0)
    assert world.model_copy(update={"attention_share": 0.95, "warmup_s": None}) == base.world


def test_who_looks_in_a_scene_is_not_drawn() -> None:
    drawn = ("vary.attention={all=[0.6,1.0]}", "vary.reaction={all=[1.0,2.0]}", "vary.action_delay_ticks=[0,2]")
    vary = scene_config(scene_with(goal_m=(20.0, -3.0)), resolve(RunConfig(), drawn)).vary
    assert (vary.attention, vary.reaction, vary.action_delay_ticks) == ({}, {}, (0, 2))
