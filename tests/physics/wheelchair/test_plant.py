"""Plants: their files, what is refused, what varies, and the body that PyBullet makes of them."""

import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.physics.rig import FORWARD, NEUTRAL, rig, step_street
from tests.support.samples import USUAL_OUTLINE
from wcsim.config import ChairConfig, ImuConfig
from wcsim.config.plant import list_plants
from wcsim.errors import ConfigError, PhysicsError
from wcsim.physics.wheelchair.plant import PlantSpec, _check_plant, plant_spec, varied
from wcsim.physics.wheelchair.plant_body import urdf
from wcsim.physics.wheelchair.wheelchair import Wheelchair

RWD, MWD = (plant_spec(ChairConfig(plant=name)) for name in ("rwd", "mwd"))
EACH_SPEC = pytest.mark.parametrize("spec", [pytest.param(RWD, id="rwd"), pytest.param(MWD, id="mwd")])


def user_file(folder: Path, old: str, new: str) -> str:
    """A plant file of a user's own: one of ours, with some text changed."""
    source = Path(__file__).parents[3] / "wcsim" / "config" / "plants" / "rwd.toml"
    text = source.read_text()
    assert old in text
    path = folder / "mine.toml"
    path.write_text(text.replace(old, new, 1))
    return str(path)


def body_of(chair) -> tuple[dict[str, tuple], dict[str, np.ndarray]]:
    """Dynamics and place of the centre of mass of every link, as PyBullet has them."""
    body, bullet = chair.body_id, chair._engine.bullet
    links = {"frame": -1, **chair._body.links}
    dynamics = {n: bullet.getDynamicsInfo(body, i) for n, i in links.items()}
    places = {"frame": bullet.getBasePositionAndOrientation(body)[0]}
    for name, index in chair._body.links.items():
        places[name] = bullet.getLinkState(body, index, computeForwardKinematics=1)[0]
    return dynamics, {name: np.array(place) for name, place in places.items()}


# --- files ---


def test_three_plants_come_with_wcsim():
    assert list_plants() == ("mwd", "rwd", "whill")
    assert [pair.arm is None for pair in RWD.casters] == [True]
    assert [pair.arm is None for pair in MWD.casters] == [False, False]


def test_a_user_adds_a_plant_by_a_file(tmp_path):
    spec = plant_spec(ChairConfig(plant=user_file(tmp_path, "radius_m = 0.178", "radius_m = 0.165")))
    assert spec.wheel.radius_m == 0.165
    with rig(plant=user_file(tmp_path, "radius_m = 0.178", "radius_m = 0.165")) as r:
        ride = r.drive(FORWARD, 40)
    assert ride.speed[-1] == pytest.approx(1.67, rel=0.01)


def test_mass_and_height_of_the_config_go_before_those_of_the_file():
    assert RWD.mass.user_kg == 80.0 and RWD.mass.com_z_m == 0.5
    spec = plant_spec(ChairConfig(user_mass_kg=120.0, com_height_m=0.6))
    assert spec.mass.user_kg == 120.0 and spec.mass.com_z_m == 0.6


@pytest.mark.parametrize(
    "old, new, said",
    [
        ("user_kg = 80.0", "user_kg = 300.0", ["mass.user_kg", "300", "150"]),
        ("user_kg = 80.0", "", ["mass.user_kg"]),
        ("user_kg = 80.0", "user_kg = nan", ["user_kg", "nan", "finite"]),
        ("user_kg = 80.0", "user_kg = 80.0\ncolour = 3", ["mass.colour", "unknown key", "chair_kg, user_kg, com_x_m"]),
        ("trail_m = 0.06", "trial_m = 0.06", ["casters.0.trial_m", "did you mean 'trail_m'?"]),
        ("pivot_z_m = 0.10", "pivot_m = 0.10", ["casters.0.beam.pivot_m", "did you mean 'pivot_z_m'?"]),
        ("com_x_m = 0.18", "com_x_m = 0.44", ["tips at rest", "0.44 m", "0.010 to 0.430 m"]),
        ("com_x_m = 0.18", "com_x_m = -0.05", ["tips at rest", "-0.05 m"]),
        ("p_m = [-0.30, 0.18, 0.07]", "p_m = [-0.30, 0.18, 0.03]", ["antitips.0", "-0.005 m", "0 m or more"]),
        ("swivel_x_m = 0.50", "swivel_x_m = 0.30", ["casters.0.swivel_x_m", "0.3 m", "0.340 m"]),
        ("track_m = 0.50", "track_m = 0.31", ["casters.0.track_m", "0.31 m", "0.324 m"]),
        ("height_m = 1.25", "height_m = 1.0", ["frame.height_m", "1.150 m"]),
        ("centre_m = [0.70, 0.0, 0.14]", "centre_m = [0.70, 0.0, 0.01]", ["frame.boxes.1", "above the ground"]),
        ("stall_torque_Nm = 90.0", "stall_torque_Nm = 5.0", ["motor.stall_torque_Nm", "5.0", "20"]),
        ("refused_m = [0.12]", "refused_m = [12]", ["climbs.refused_m.0", "12", "0.3"]),
        ("[wheel]", "[whel]", ["whel", "did you mean 'wheel'?"]),
    ],
)
def test_a_plant_that_cannot_be_is_refused_with_value_unit_and_bounds(tmp_path, old, new, said):
    chair = ChairConfig(plant=user_file(tmp_path, old, new))
    with pytest.raises(ConfigError) as caught:
        plant_spec(chair)
    for words in ("mine.toml", *said):
        assert words in str(caught.value)


@pytest.mark.parametrize(
    "values, said",
    [
        ({"casters.*.arm.preload_N": 450.0}, "push with 1800 N together; expected at most 80% of the weight, 1648 N"),
        ({"mass.com_x_m": 0.3, "casters.*.arm.down_m": 0.02}, r"casters\.1\.arm stands -\d+ mm up at rest"),
        ({"casters.1.swivel_x_m": 0.55}, r"casters\.0 and casters\.1 are 0\.130 m apart; expected 0\.284 m"),
    ],
)
def test_sprung_casters_must_carry_it_level(values, said):
    with pytest.raises(ConfigError, match=said):
        varied(MWD, values)


def test_wheels_that_weigh_more_than_the_chair_leave_no_frame():
    heavy = dict.fromkeys(("wheel.mass_kg", "casters.*.mass_kg", "casters.*.fork_mass_kg"), 30.0)
    with pytest.raises(ConfigError, match=r"leave -\d+\.\d kg for frame and user"):
        varied(RWD, {**heavy, "mass.chair_kg": 60.0, "mass.user_kg": 40.0})


def test_unknown_plants_and_files_that_are_none(tmp_path):
    with pytest.raises(ConfigError, match=r"'tank'; expected one of: mwd, rwd, whill, or the path of a \.toml file"):
        plant_spec(ChairConfig(plant="tank"))
    with pytest.raises(ConfigError, match="cannot be read"):
        plant_spec(ChairConfig(plant=str(tmp_path / "none.toml")))
    (tmp_path / "bad.toml").write_text("mass = [")
    with pytest.raises(ConfigError, match="is not TOML"):
        plant_spec(ChairConfig(plant=str(tmp_path / "bad.toml")))


@pytest.mark.parametrize(
    "key, value", [("accel_mps2", 3.5), ("decel_mps2", 9.0), ("jerk_mps3", 80.0), ("yaw_rate_max_radps", 3.5)]
)
def test_a_controller_beyond_the_limits_of_its_plant_is_refused(key, value):
    with pytest.raises(ConfigError, match=rf"chair\.{key} is {value} .*expected no more"):
        plant_spec(ChairConfig(**{key: value}))


# --- geometry ---


@EACH_SPEC
def test_the_outline_holds_all_that_collides(spec):
    with rig(plant="mwd" if len(spec.casters) == 2 else "rwd") as r:
        bullet, body = r.engine.bullet, r.chair.body_id
        boxes = [bullet.getAABB(body, i) for i in (-1, *r.chair._body.part)]
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    outline = spec.outline
    assert high[0] - low[0] == pytest.approx(outline.length_m, abs=0.01)
    assert 0.5 * (high[0] + low[0]) == pytest.approx(outline.middle_x_m, abs=0.005)
    assert high[1] - low[1] == pytest.approx(outline.width_m, abs=0.01)
    assert high[2] <= outline.height_m + 0.01
    assert outline.size_lwh_m == (outline.length_m, outline.width_m, outline.height_m)


@EACH_SPEC
def test_masses_centre_and_friction_are_those_of_the_file(spec):
    name = "mwd" if len(spec.casters) == 2 else "rwd"
    with rig(plant=name) as r:
        dynamics, places = body_of(r.chair)
    masses = [item[0] for item in dynamics.values()]
    assert sum(masses) == pytest.approx(spec.whole_kg)
    whole = np.average(list(places.values()), axis=0, weights=masses)
    assert whole == pytest.approx([spec.mass.com_x_m, 0.0, spec.mass.com_z_m], abs=0.003)
    assert dynamics["frame"][2] == pytest.approx(spec.frame_inertia_kgm2)
    disc_kgm2 = 0.5 * spec.wheel.mass_kg * spec.wheel.radius_m**2
    assert dynamics["wheel_l"][2][1] == pytest.approx(disc_kgm2 + spec.motor.rotor_inertia_kgm2)
    friction = {name.split("_")[0]: item[1] for name, item in dynamics.items()}
    assert (friction["wheel"], friction["caster"], friction["frame"]) == (0.9, 0.72, 0.5)
    assert all(antitip.friction == friction["antitip"] for antitip in spec.antitips)


@EACH_SPEC
def test_the_urdf_names_every_part(spec):
    text = urdf(spec)
    assert text.count("<joint ") == 2 + 4 * len(spec.casters) + 2 * len(spec.antitips) + (
        sum(2 * (pair.arm is not None) + (pair.beam is not None) for pair in spec.casters)
    )
    assert text.count("<box ") == len(spec.frame.boxes)


def test_the_lightest_beam_has_the_inertia_of_a_body():
    spec = varied(RWD, {"casters.0.beam.mass_kg": 0.1})
    for told in re.findall(r'ixx="([^"]*)" iyy="([^"]*)" izz="([^"]*)"', urdf(spec)):
        least, middle, most = sorted(map(float, told))
        assert 0.0 < most <= 1.000001 * (least + middle)


def test_a_caster_has_an_arm_or_a_beam():
    beam = RWD.casters[0].beam
    assert beam is not None
    both = tuple(pair.model_copy(update={"beam": beam}) for pair in MWD.casters)
    with pytest.raises(ConfigError, match=r"casters\.0 has an arm and a beam; expected one of them"):
        _check_plant(MWD.model_copy(update={"casters": both}), "both")


def test_the_casters_of_a_beam_stand_on_steps_of_different_height(on_flat):
    on_flat.drive(NEUTRAL, 10)
    beam = on_flat.chair._body.joints[2]
    for angle_rad in (0.08, -0.08):
        on_flat.engine.bullet.resetJointState(on_flat.chair.body_id, beam, angle_rad, 0.0)
        on_flat.drive(NEUTRAL, 20)
        turned = on_flat.engine.bullet.getJointState(on_flat.chair.body_id, beam)[0]
        assert abs(turned) < 0.01  # level ground brings it back


def test_a_sprung_caster_gives_way_and_comes_back():
    with rig(plant="mwd") as r:
        r.drive(NEUTRAL, 10)
        arms = slice(2, 2 + len(r.chair._body.arms))
        at_rest = [joint[0] for joint in r.chair._joints[arms]]
        for _ in range(48):
            r.chair.before_step()
            push = {"forceObj": (0.0, 0.0, -400.0), "posObj": (0.6, 0.0, 0.5), "flags": pybullet.WORLD_FRAME}
            r.engine.bullet.applyExternalForce(r.chair.body_id, -1, **push)
            r.engine.step()
            r.chair.after_step()
        pressed = [joint[0] for joint in r.chair._joints[arms]]
        r.drive(NEUTRAL, 40)
        after = [joint[0] for joint in r.chair._joints[arms]]
    assert np.abs(at_rest).max() < 0.002
    assert min(pressed[:2]) > 0.005 and max(pressed[2:]) < -0.005  # front casters up, rear ones down
    assert after == pytest.approx(at_rest, abs=5e-4)


@pytest.mark.parametrize("plant", list_plants())
def test_parked_across_a_slope_it_does_not_creep(plant):
    slope = step_street(0.0)
    tilted = replace(slope, vertices_W_m=slope.vertices_W_m + np.outer(slope.vertices_W_m[:, 1], (0, 0, 0.176)))
    with rig(replace(tilted, vertices_W_m=tilted.vertices_W_m.astype(np.float32)), plant=plant) as r:
        start = r.drive(NEUTRAL, 15).p_m[-1]
        end = r.drive(NEUTRAL, 30).p_m[-1]
    assert np.abs(end - start).max() < 0.001


# --- variation ---


@given(
    st.fixed_dictionaries(
        {
            "mass.chair_kg": st.floats(90.0, 150.0),
            "mass.user_kg": st.floats(25.0, 150.0),
            "mass.com_z_m": st.floats(0.45, 0.65),
            "wheel.friction": st.floats(0.3, 1.0),
            "casters.*.friction": st.floats(0.3, 1.0),
            "motor.stall_torque_Nm": st.floats(60.0, 120.0),
        }
    ),
    st.sampled_from([RWD, MWD]),
)
def test_parameters_vary_within_their_bounds(values, spec):
    out = varied(spec, values)
    assert out.mass.user_kg == values["mass.user_kg"]
    assert {pair.friction for pair in out.casters} == {values["casters.*.friction"]}
    assert out.wheel.radius_m == spec.wheel.radius_m and out.antitips == spec.antitips
    assert varied(out, {}) == out


def test_one_pair_and_one_number_of_a_list_vary_alone():
    out = varied(MWD, {"casters.1.trail_m": 0.04, "frame.boxes.0.size_m.0": 0.5})
    assert [pair.trail_m for pair in out.casters] == [0.05, 0.04]
    assert out.frame.boxes[0].size_m == (0.5, 0.44, 0.36)


@pytest.mark.parametrize(
    "name", ["nope", "mass", "mass.nope", "casters", "casters.7.trail_m", "casters.0.arm.preload_N"]
)
def test_unknown_names_are_refused(name):
    with pytest.raises(ConfigError, match="is unknown; expected a name like"):
        varied(RWD, {name: 1.0})


def test_values_out_of_bounds_are_refused():
    with pytest.raises(ConfigError, match=r"wheel\.friction"):
        varied(RWD, {"wheel.friction": 3.0})
    with pytest.raises(ConfigError, match="tips at rest"):
        varied(RWD, {"mass.com_x_m": 0.5})


def test_a_chair_becomes_another_and_the_first_again(on_flat):
    heavy = varied(RWD, {"mass.user_kg": 140.0, "mass.com_z_m": 0.6, "wheel.friction": 0.4})
    first, chair = on_flat.place().drive(FORWARD, 15), on_flat.chair
    chair.become(heavy)
    assert chair.parked and chair.spec is heavy
    dynamics, _ = body_of(chair)
    assert sum(item[0] for item in dynamics.values()) == pytest.approx(heavy.whole_kg)
    assert dynamics["wheel_l"][1] == 0.4
    other = on_flat.place().drive(FORWARD, 15)
    chair.become(RWD)
    again = on_flat.place().drive(FORWARD, 15)
    assert np.array_equal(first.p_m, again.p_m)
    assert not np.array_equal(first.p_m, other.p_m)


def test_the_engine_knows_the_body_of_today_only(on_flat):
    bodies = on_flat.engine.bullet.getNumBodies()
    other = Wheelchair(on_flat.engine, ChairConfig(), ImuConfig(), seat=1)
    on_flat.chair.become(MWD)
    assert on_flat.engine.tag_of(on_flat.chair.body_id).actor_id == "w:0"
    assert on_flat.engine.tag_of(other.body_id).actor_id == "w:1"
    assert on_flat.engine.bullet.getNumBodies() == bodies + 1
    ride = on_flat.place().drive(FORWARD, 40)
    assert ride.speed[-1] == pytest.approx(1.67, rel=0.01)


def test_a_body_that_was_taken_out_is_unknown(on_flat):
    body = on_flat.chair.body_id
    on_flat.engine.remove_body(body)
    with pytest.raises(PhysicsError, match="unknown"):
        on_flat.engine.tag_of(body)


def test_becoming_what_it_is_changes_nothing(on_flat):
    body = on_flat.chair.body_id
    on_flat.chair.become(plant_spec(ChairConfig()))
    assert on_flat.chair.body_id == body and on_flat.chair.parked


def test_frictions_motors_and_springs_change_without_a_new_body(monkeypatch):
    def refuse(*_):
        raise AssertionError("a new body")

    with rig(plant="mwd") as r:
        first, chair = r.place().drive(FORWARD, 8), r.chair
        monkeypatch.setattr("wcsim.physics.wheelchair.wheelchair.load_body", refuse)
        values = {"wheel.friction": 0.5, "casters.1.friction": 0.3, "frame.friction": 0.2}
        chair.become(varied(MWD, {**values, "casters.*.arm.stiffness_Npm": 2e4, "motor.stall_torque_Nm": 60.0}))
        dynamics, _ = body_of(chair)
        found = [dynamics[name][1] for name in ("wheel_r", "caster_0_l", "caster_1_l", "frame")]
        other = r.place().drive(FORWARD, 8)
        chair.become(MWD)
        again = r.place().drive(FORWARD, 8)
        with pytest.raises(AssertionError, match="a new body"):
            chair.become(varied(MWD, {"mass.user_kg": 90.0}))
    assert found == [0.5, 0.72, 0.3, 0.2]
    assert np.array_equal(first.p_m, again.p_m) and not np.array_equal(first.p_m, other.p_m)


def test_the_tests_usual_outline_is_that_of_plant_rwd():
    outline = RWD.outline
    got = (*outline.size_lwh_m, outline.middle_x_m, outline.front_x_m, *outline.half_lw_m)
    usual = USUAL_OUTLINE
    assert got == pytest.approx((*usual.size_lwh_m, usual.middle_x_m, 0.8, 0.5675, 0.31))


def test_springs_that_the_step_cannot_follow_are_refused():
    stiff = varied(MWD, {"casters.0.arm.damping_Nspm": 1000.0})
    with rig(hz=240) as r:
        r.chair.become(stiff)
        assert np.abs(r.place().drive(FORWARD, 10).lowpass).max() < 5.0
    with (
        rig(hz=100) as r,
        pytest.raises(ConfigError, match=r"casters\.0\.arm\.damping_Nspm is 1000 Ns/m.*0\.01000 s.*at most 660 Ns/m"),
    ):
        r.chair.become(stiff)
    assert r.chair.spec == RWD


def test_a_wet_wheel_slips():
    wet = varied(RWD, {"wheel.friction": 0.1, "casters.*.friction": 0.1})
    ways = []
    for spec in (RWD, wet):
        with rig(accel_mps2=2.0, jerk_mps3=40.0) as r:
            r.chair.become(spec)
            ways.append(r.place().drive(FORWARD, 12).p_m[-1][0])
    assert ways[1] < 0.75 * ways[0]


@pytest.mark.proof
def test_a_thousand_episodes_as_others_keep_little_memory(on_flat):
    specs: list[PlantSpec] = [varied(RWD, {"mass.user_kg": 60.0 + k}) for k in range(40)]
    seen = []
    for k in range(1000):
        on_flat.chair.become(specs[k % len(specs)])
        if k % 100 == 99:
            seen.append(psutil.Process().memory_info().rss)
    growth = [(late - early) / 100 for early, late in pairwise(seen)]
    assert math.fsum(growth[2:]) / len(growth[2:]) < 100e3  # bytes an episode
