import re

import pytest
from pydantic import ValidationError

from tools.readability import ROOT
from wcsim.cli.main import main
from wcsim.config import RunConfig, TownFile, parse, read_toml, resolve
from wcsim.config.plant import PlantFile, read_plant
from wcsim.config.run_file import QPolicyFile, RunManifestFile
from wcsim.config.scene import SceneFile
from wcsim.config.suite import SuiteFile
from wcsim.core.reading import SETTINGS, parse_toml
from wcsim.errors import ConfigError


@pytest.mark.parametrize("preset", ["quick", "laptop", "best", "reward", "dqn", "paper"])
def test_a_shared_world_lives_for_ten_episodes(preset):
    config = resolve(preset)
    assert config.epoch_ticks >= 10 * config.learn.episode_steps
    assert resolve(config, "world.epoch_ticks=50").epoch_ticks == 50, "what a user asks for is taken as it is"


def test_the_table_of_presets_is_that_of_the_page(capsys):
    assert main(["train-q", "--preset"]) == 0
    table = capsys.readouterr().out
    assert table in (ROOT / "docs" / "learning.md").read_text()
    told = re.findall(r"^\| `(\w+)` .*? \| ([\d,]+) \|", table, re.MULTILINE)
    assert [name for name, _ in told] == ["quick", "laptop", "best", "reward", "dqn", "paper"]
    for name, steps in told:
        learn, collect = resolve(name).learn, resolve(name).collect
        driven = collect.rounds * collect.segments * collect.ticks * collect.chairs
        assert steps == f"{driven if learn.head == 'danger' else learn.total_steps:,}"


def test_an_override_reaches_its_key_and_nothing_else():
    plain, changed = resolve("quick"), resolve("quick", ("learn.gamma=0.9", "env.profile=competent"))
    assert changed.learn.gamma == 0.9
    assert changed.env.profile == "competent"
    assert changed.learn.model_copy(update={"gamma": plain.learn.gamma}) == plain.learn
    assert changed.digest() != plain.digest()


@pytest.mark.parametrize(
    "override, says",
    [
        ("learn.gama=0.9", "learn.gama"),
        ("learn.gamma=1.5", "less than 1"),
        ("learn.gamma", "section.key=value"),
        ("world.tick_s=0.05x", "world.tick_s"),
        ("world.substeps=1", "physics step"),
        ("world.tick_s=0.0333333333", r"whole milliseconds.*expected .* milliseconds, for example 0\.033"),
        ("world.tick_s=0.0415", "whole milliseconds"),
        ("world.action_step_s=0.26", r"action_step_s is 0\.26 s .*expected a multiple of tick_s: 0\.3"),
        ("world.action_step_s=0.05", r"expected a multiple of tick_s: 0\.1"),
        ("nothing.here=1", "nothing"),
        ("reward.accel_window_mps2=[40.0, 20.0]", "low < high"),
        ("reward.max_follow_distance=3.0", "low < high"),
        ("imu.saturation_mps2=10.0", "saturation"),
        ("cameras.0.range_m=150", r"'front' has range_m 150, .* set world\.mirror_radius_m=150, or a smaller range_m"),
        ("env.camera=rear", "env.camera is 'rear'; expected the name of a camera: front"),
        ('env.camera=["left","rear"]', r"env.camera is \('left', 'rear'\); expected the name of a camera: front, rear"),
        ('env.camera=["","front"]', "in a list each once"),
        ("env.camera=[]", "at least 1 item"),
        ("env.observation=compact_rgb", r"draws no colours; expected cameras\.0\.rgb=true"),
        # Numbers out of bounds are told with their unit and their bounds.
        ("cameras.0.range_m=500", "range_m.* got 500 m; expected at least 1 and at most 200 m"),
        ("cameras.0.hfov_deg=10", "hfov_deg.* got 10 deg; expected at least 20 and at most 140 deg"),
        ("cameras.0.p_BC_m=[0.3, 0.0, 9.0]", "p_BC_m.2.* got 9.0 m; expected at least 0.02 and at most 3 m"),
        ("cameras.0.name='a b'", "name"),
        (
            "cameras.0.noise=some",
            "noise: got .some.; expected typical, none, or a table of depth, classes, rgb, objects$",
        ),
        ("cameras.0.noise.depth=typical", "depth: got .typical.; expected none, or a table of baseline_m, sigma_px"),
        ("sensors.odometry=typicla", "odometry: got .typicla.; expected typical, none, .*did you mean 'typical'"),
        ("learn=3", "learn: got 3; expected a table of keys"),
        ("cameras.0.noise.depth.sigma_px=-1", "sigma_px.* got -1 px; expected at least 0 and at most 2 px"),
        ("cameras.0.noise.rgb.snr_db=100", "snr_db.* got 100 dB; expected at least 6 and at most 80 dB"),
        ("cameras.0.noise.classes.border_px=1.5", "border_px"),
        ("imu.gyro_range_deg=100", "gyro_range_deg.* got 100 deg; expected at least 250 and at most 2000 deg"),
        ("imu.accel_density_ug=nan", "accel_density_ug.* got .nan. ug; expected at least 0 and at most 10000"),
        ("imu.tilt=perfect", "ideal.*accelerometer.*complementary"),
        ("world.reaction_s=inf", "reaction_s.* got .inf. s; expected at least 0 and at most 60 s"),
        ("learn.total_steps=10_000_000_000", "total_steps"),
        ("learn.replay_frames=100_000_000", "replay_frames"),
        ("reward.crash=1e300", "crash.*at most 1e.09"),
        ("reward.max_distance=1000", "max_distance"),
        ("env.profile='" + "a" * 20_000 + "'", "profile"),
    ],
)
def test_a_wrong_override_says_what_is_wrong(override, says):
    with pytest.raises(ConfigError, match=says):
        resolve("quick", override)


def test_what_is_wrong_with_an_item_is_told_without_what_follows_for_its_list():
    with pytest.raises(ConfigError) as told:
        resolve("quick", "cameras.0.widht_px=80")
    assert str(told.value).endswith("remove it or correct its name; did you mean 'width_px'?")
    with pytest.raises(ConfigError, match=r"cameras: Tuple should have at least 1 item"):
        resolve("quick", "cameras=[]")


def test_a_rear_camera_is_mounted_when_it_is_named_and_follows_the_first_until_it_is_changed():
    two = resolve("quick", ("cameras.0.noise=typical", 'env.camera=["front","rear"]'))
    front, rear = two.cameras
    assert two.eyes == {"": front, "rear_": rear} and two.eye == front
    assert (rear.yaw_deg, rear.noise, rear.width_px) == (180.0, front.noise, 80)
    assert resolve(two, "cameras.0.width_px=40").cameras[1].width_px == 40
    own = resolve(two, "cameras.1.pitch_deg=-20")
    assert own.cameras[0] == front and resolve(own, "cameras.0.width_px=40").cameras[1] == own.cameras[1]
    back = resolve(two, 'env.camera=["rear",""]')
    assert back.eyes == {"": rear, "front_": front} and resolve(two, "env.camera=rear").eyes == {"": rear}
    assert resolve("quick").eyes == {"": resolve("quick").cameras[0]}
    assert parse(RunConfig, two.model_dump(mode="json"), "file") == two


def test_a_camera_must_see_something():
    with pytest.raises(ConfigError, match=r"from 2.0 m to range_m 1.5 m"):
        resolve("quick", ("cameras.0.noise.depth.z_min_m=2.0", "cameras.0.range_m=1.5"))


def test_noise_goes_by_a_word_or_part_by_part():
    plain, typical = resolve("quick"), resolve("quick", "cameras.0.noise=typical")
    assert plain.cameras[0].noise is None
    noise = typical.cameras[0].noise
    assert noise is not None and noise.depth is not None and noise.classes is not None and noise.rgb is not None
    changed = resolve(typical, "cameras.0.noise.depth.sigma_px=0.5").cameras[0].noise
    assert changed == noise.model_copy(update={"depth": noise.depth.model_copy(update={"sigma_px": 0.5})})
    assert resolve(typical, "cameras.0.noise=none") == plain
    depth_only = resolve("quick", "cameras.0.noise.depth.baseline_m=0.1").cameras[0].noise
    assert depth_only is not None and depth_only.classes is None and depth_only.depth is not None
    assert depth_only.depth.baseline_m == 0.1 and depth_only.depth.sigma_px == noise.depth.sigma_px


def test_a_number_of_typical_noise_leaves_the_other_noises_on(tmp_path):
    word, own = "cameras.0.noise=typical", "cameras.0.noise.depth.sigma_px=0.2"
    wanted = resolve(resolve("quick", word), own).cameras[0].noise
    assert wanted is not None and wanted.classes is not None and wanted.rgb is not None
    assert resolve("quick", (word, own)).cameras[0].noise == wanted
    laptop = resolve("laptop")
    assert resolve("laptop", own) == resolve(laptop, own)
    file = tmp_path / "own.toml"
    file.write_text("[cameras.0.noise.depth]\nsigma_px = 0.2\n")
    assert resolve("laptop", file).cameras[0].noise == wanted
    assert resolve("laptop", (own, word)) == laptop
    alone = resolve("quick", ("cameras.0.noise=none", own)).cameras[0].noise
    assert alone is not None and alone.depth is not None and alone.classes is None
    exact = tuple(f"cameras.0.noise.{part}=none" for part in ("classes", "rgb"))
    assert resolve("laptop", (own, *exact)).cameras[0].noise == alone


def test_a_named_speed_of_the_chair_is_taken_over_a_resolved_configuration_too(tmp_path):
    plain, file = resolve("quick"), tmp_path / "a.toml"
    file.write_text('[chair]\nprofile = "road"\n')
    slow = resolve(plain, "chair.profile=indoor")
    assert slow.chair == resolve("quick", "chair.profile=indoor").chair and slow.chair.v_max_mps == 0.6
    assert resolve(slow, file).chair.v_max_mps == 2.78
    assert resolve(slow, "chair.profile=custom").chair.v_max_mps == 0.6
    for more in (("chair.profile=road", "chair.v_max_mps=1.0"), ("chair.v_max_mps=1.0", "chair.profile=road")):
        with pytest.raises(ConfigError, match="v_max_mps is 1"):
            resolve(plain, more)


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


def test_an_item_of_a_list_of_numbers_is_reached_by_its_number():
    changed = resolve(resolve("quick"), ("imu.p_BI_m.2=0.6", "reward.roll_window_deg.0=4"))
    assert changed.imu.p_BI_m == (0.18, 0.0, 0.6)
    assert changed.reward.roll_window_deg == (4.0, 20.0)


def test_as_many_cameras_as_a_world_has_room_for():
    tiny = '[[cameras]]\nname = "c{}"\nwidth_px = 16\nheight_px = 12\n'
    for count, fits in ((64, True), (65, False), (1000, False)):
        data = parse_toml("".join(tiny.format(i) for i in range(count)), "here", SETTINGS)
        if fits:
            assert len(parse(RunConfig, data, "here").cameras) == 64
        else:
            with pytest.raises(ConfigError, match="at most 64"):
                parse(RunConfig, data, "here")


@pytest.mark.parametrize(
    "overrides",
    [
        ("cameras.0.width_px=2048", "cameras.0.height_px=2048", "env.window=16"),
        ('cameras=[{name="a", width_px=2048, height_px=2048}, ' + ", ".join(
            f'{{name="b{k}", width_px=2048, height_px=2048}}' for k in range(9)
        ) + "]",),
    ],
)  # fmt: skip
def test_pictures_that_would_fill_the_memory_are_refused(overrides):
    with pytest.raises(ConfigError, match=r"pixels.*make width_px and height_px smaller"):
        resolve("quick", overrides)


def test_few_of_many_faults_are_told():
    with pytest.raises(ConfigError, match="and more") as caught:
        parse(RunConfig, {f"x{number}": 1 for number in range(1000)}, "here")
    assert len(str(caught.value)) < 2000


@pytest.mark.parametrize(
    "wrong", [{"blocks": [{}] * 9999}, {"blocks": [{"episodes": [{}] * 9999}]}, {"towns": [0] * 9999}]
)
def test_not_every_wrong_item_of_a_list_costs_memory(wrong):
    with pytest.raises(ValidationError) as caught:
        SuiteFile.model_validate(wrong)
    assert caught.value.error_count() < 24


def test_a_batch_that_would_fill_the_memory_is_refused():
    with pytest.raises(ConfigError, match=r"a batch of 4096 observations.*learn\.batch_size"):
        resolve("quick", ("cameras.0.width_px=640", "cameras.0.height_px=480", "learn.batch_size=4096"))


def unbounded(schema, definitions, where=""):
    """Where a file could hold anything: texts, numbers, lists and tables without a bound."""
    schema = definitions[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema
    if {"enum", "const", "pattern", "anyOf"} & schema.keys():
        return [name for part in schema.get("anyOf", ()) for name in unbounded(part, definitions, where)]
    match schema.get("type"):
        case "string":
            return [] if "maxLength" in schema else [where]
        case "integer" | "number":
            low, high = {"minimum", "exclusiveMinimum"}, {"maximum", "exclusiveMaximum"}
            return [] if low & schema.keys() and high & schema.keys() else [where]
        case "array":
            parts = [*schema.get("prefixItems", ()), schema.get("items", {"enum": []})]
            found = [name for part in parts if part for name in unbounded(part, definitions, f"{where}[]")]
            return found if "maxItems" in schema else [where, *found]
        case "object" if "properties" in schema:
            parts = schema["properties"].items()
            return [name for key, part in parts for name in unbounded(part, definitions, f"{where}.{key}")]
        case "object":
            values = (*schema.get("patternProperties", {}).values(), schema.get("additionalProperties"))
            found = [name for part in values if part for name in unbounded(part, definitions, f"{where}.*")]
            return found if "maxProperties" in schema else [where, *found]
    return []


@pytest.mark.parametrize("model", [RunConfig, PlantFile, SceneFile, TownFile, QPolicyFile, RunManifestFile])
def test_every_field_of_every_file_has_bounds(model):
    schema = model.model_json_schema()
    assert unbounded(schema, schema.get("$defs", {})) == []


def test_a_missing_key_is_told_with_those_that_are_there():
    data = read_plant("rwd").model_dump(mode="json")
    del data["wheel"]["radius_m"], data["wheel"]["friction"], data["motor"]
    data["wheel"]["radius_mm"] = 178.0
    with pytest.raises(ConfigError) as told:
        parse(PlantFile, data, "mine")
    said = str(told.value)
    assert "wheel.radius_m: is missing; expected it beside width_m, mass_kg, track_m, radius_mm; " in said
    assert "motor: is missing; expected it beside shows, mass, " in said and "{" not in said


def test_a_beams_stop_is_no_value_in_rad():
    data = read_plant("rwd").model_dump(mode="json")
    beam = next(pair["beam"] for pair in data["casters"] if pair["beam"])
    beam["stop_deg"] = 0.105
    with pytest.raises(ConfigError, match=r"stop_deg: .*got 0\.105 deg; expected at least 0\.5"):
        parse(PlantFile, data, "mine")
