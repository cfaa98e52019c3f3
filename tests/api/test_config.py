from __future__ import annotations

import pytest

from wcsim.config import RunConfig, TownFile, load_run_config, read_toml
from wcsim.errors import ConfigError
from wcsim.scene_file import SceneFile


@pytest.mark.parametrize("preset", ["quick", "paper"])
def test_presets_are_complete(preset):
    assert isinstance(load_run_config(preset), RunConfig)


def test_an_override_reaches_its_key_and_nothing_else():
    plain, changed = load_run_config("quick"), load_run_config("quick", ("learn.gamma=0.9", "env.profile=competent"))
    assert changed.learn.gamma == 0.9
    assert changed.env.profile == "competent"
    assert changed.learn.model_copy(update={"gamma": plain.learn.gamma}) == plain.learn
    assert changed.digest() != plain.digest()


def test_a_camera_is_reached_by_its_number():
    assert load_run_config("quick", ("cameras.0.width_px=160",)).cameras[0].width_px == 160


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("learn.gama=0.9", "learn.gama"),
        ("learn.gamma=1.5", "less than 1"),
        ("learn.gamma", "section.key=value"),
        ("world.tick_s=0.05x", "world.tick_s"),
        ("world.substeps=1", "physics step"),
        ("nothing.here=1", "nothing"),
        ("reward.accel_window_mps2=[40.0, 20.0]", "low < high"),
        ("reward.max_follow_distance=3.0", "low < high"),
        ("imu.saturation_mps2=10.0", "saturation"),
    ],
)
def test_a_wrong_override_says_what_is_wrong(override, says):
    with pytest.raises(ConfigError, match=says):
        load_run_config("quick", (override,))


def test_an_unknown_preset_names_the_known_ones():
    with pytest.raises(ConfigError, match=r"paper.*quick"):
        load_run_config("fast")


@pytest.mark.parametrize("text", ["name =", "name = 'a'\nsplit = 'train'\nxx = 1", "name = 'a b'\nsplit = 'train'"])
def test_a_broken_file_is_refused_in_one_line(tmp_path, text):
    path = tmp_path / "town.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_toml(path, TownFile)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_scene_that_is_too_long(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read_toml(tmp_path / "none.toml", TownFile)
    path = tmp_path / "scene.toml"
    path.write_text("name='s'\nshows='x'\nseed=1\nduration_s=61\nseats=[]\n")
    with pytest.raises(ConfigError, match="duration_s"):
        read_toml(path, SceneFile)
