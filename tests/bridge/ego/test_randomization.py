"""What is drawn for each episode, what it does, and which ranges are refused."""

import math

import numpy as np
import pytest

from tests.support.worlds import hashes, open_world, quick_config
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.bridge.ego.randomization import Randomization, _draw
from wcsim.bridge.world import World
from wcsim.config import VaryConfig, resolve
from wcsim.errors import ConfigError
from wcsim.server.protocol.messages import Frame, decode_reply, encode_message
from wcsim.types import Command, Joystick

EVERYTHING = VaryConfig(
    light=(0.5, 1.5),
    friction=(0.5, 1.0),
    user_mass_kg=(45.0, 120.0),
    camera_shift_m=(-0.05, 0.05),
    camera_turn_deg=(-3.0, 3.0),
    action_delay_ticks=(0, 5),
    plant={"motor.stall_torque_Nm": (60.0, 90.0), "casters.*.swivel_friction_Nm": (0.2, 1.0)},
)


def drive(world: World, ticks: int) -> list[float]:
    """Forward speed after each tick, with the stick fully forward."""
    speeds, ahead = [], Joystick(0.0, 1.0)
    for _ in range(ticks):
        commands = [Command(seat=seat.index, tick=world.snapshot.tick, joystick=ahead) for seat in world.seats]
        speeds.append(float(world.tick(commands).clients[0].plant.v_B_mps[0]))
    return speeds


def numbers(drawn):
    return [drawn.light, drawn.friction, drawn.user_mass_kg, *drawn.camera_shift_m[0], *drawn.camera_turn_rad[0],
            *(value for _, value in drawn.plant)]  # fmt: skip


def test_the_same_seed_draws_the_same_and_everybody_else_something_else():
    first = _draw(EVERYTHING, 2, 7, seat=0, episode=3)
    assert _draw(EVERYTHING, 2, 7, seat=0, episode=3) == first
    others = [_draw(EVERYTHING, 2, *where) for where in ((8, 0, 3), (7, 1, 3), (7, 0, 4))]
    for other in others:
        assert not set(numbers(first)) & set(numbers(other))
    assert len(first.camera_shift_m) == len(first.camera_turn_rad) == 2
    assert first.camera_shift_m[0] != first.camera_shift_m[1]


def test_another_range_changes_no_other_draw():
    alone = _draw(VaryConfig(friction=(0.5, 1.0)), 1, 7, seat=0, episode=0)
    assert alone.friction == _draw(EVERYTHING, 1, 7, seat=0, episode=0).friction
    assert alone.light is None and alone.camera_shift_m == () and alone.plant == ()


def test_draws_fill_their_ranges_evenly():
    drawn = [_draw(EVERYTHING, 1, 1, seat=0, episode=k) for k in range(600)]
    delays = np.bincount([d.action_delay_ticks for d in drawn], minlength=6)
    assert len(delays) == 6 and delays.min() > 70
    for values, low, high in (
        ([d.user_mass_kg for d in drawn], 45.0, 120.0),
        ([d.camera_turn_rad[0][1] for d in drawn], -math.radians(3), math.radians(3)),
        ([dict(d.plant)["motor.stall_torque_Nm"] for d in drawn], 60.0, 90.0),
    ):
        assert low <= min(values) and max(values) <= high
        counts, _ = np.histogram(values, 4, (low, high))
        assert counts.min() > 110


def test_without_ranges_there_is_nothing_to_draw(corner):
    assert Randomization(quick_config(), 0).fitting(1, 0) is None
    with open_world(corner) as world:
        plain = hashes(world, 30)
        assert world.snapshot.clients[0].drawn is None
    with open_world(corner, "vary.light=[0.5,0.5]") as world:  # changes colours, which nobody asked for
        assert hashes(world, 30) == plain


def test_mass_and_friction_and_plant_are_those_of_the_body(corner):
    words = ("vary.user_mass_kg=[120,120]", "vary.friction=[0.5,0.5]", 'vary.plant={"mass.chair_kg"=[100,100]}')
    with open_world(corner, *words) as world:
        chair, bullet = world.seats[0].chair, world._open.engine.bullet
        links = range(-1, bullet.getNumJoints(chair.body_id))
        facts = [bullet.getDynamicsInfo(chair.body_id, link) for link in links]
        assert sum(fact[0] for fact in facts) == pytest.approx(220.0, abs=0.01)
        frictions = {round(fact[1], 3) for fact in facts}
        assert {0.45, 0.36} <= frictions and not {0.9, 0.72} & frictions  # half of wheel's and caster's


def test_what_was_drawn_reaches_the_client_through_an_environment_and_a_message(corner):
    words = ("vary.friction=[0.5,0.9]", "vary.camera_turn_deg=[-2,2]", 'vary.plant={"motor.no_load_radps"=[20,24]}')
    config = quick_config(*words)
    env = WheelchairEnv(str(corner), config=config, seed=4)
    try:
        _, info = env.reset()
        drawn = info["objects"].drawn
        assert drawn == _draw(config.vary, 1, 4, 0, 0)
        assert env.step(0)[-1]["objects"].drawn == drawn
        reply = decode_reply(encode_message(Frame(epoch=0, tick=1, life=0, client=env._chair.now)))
        assert isinstance(reply, Frame) and reply.client.drawn == drawn
    finally:
        env.close()


def test_ranges_can_be_taken_away_again():
    config = quick_config("vary.friction=[0.5,0.9]", "vary=none")
    assert config.vary.nothing and config == quick_config()


def test_on_ice_the_chair_does_not_get_going(corner):
    with open_world(corner) as world:
        dry = drive(world, 12)
    with open_world(corner, "vary.friction=[0.05,0.05]") as world:
        ice = drive(world, 12)
    assert dry[-1] > 0.7
    assert ice[-1] < 0.6 * dry[-1]


def test_a_delay_of_three_ticks_is_three_ticks(corner):
    with open_world(corner) as world:
        plain = drive(world, 10)
    for word in ("vary.action_delay_ticks=[3,3]", "world.action_delay_ticks=3"):
        with open_world(corner, word) as world:
            late = drive(world, 13)
            assert max(map(abs, late[:3])) < 0.01
            assert late[3:] == pytest.approx(plain, abs=0.02)
            world.respawn(0)
            assert abs(drive(world, 1)[0]) < 0.01, "the last episode's commands must not reach the next one"


def test_a_camera_sees_from_where_it_was_put(corner):
    def bottom_m(*words):
        with open_world(corner, "cameras.0.p_BC_m=[0.9,0.0,1.0]", "cameras.0.pitch_deg=-40", *words) as world:
            return float(np.median(world.snapshot.clients[0].sensors.cameras[0].depth_m[-1]))

    usual = bottom_m()
    raised = bottom_m("vary.camera_shift_m=[0.2,0.2]")
    assert raised / usual == pytest.approx(1.2, abs=0.02)  # level ground, seen from 1.2 m instead of 1.0 m
    lowered = bottom_m("vary.camera_turn_deg=[-10,-10]")
    down = math.atan(11.5 / 12.0 * 0.75 * math.tan(math.radians(87 / 2)))  # the last row's angle below the axis
    expected = math.sin(down + math.radians(40)) / math.sin(down + math.radians(50))
    assert lowered / usual == pytest.approx(expected, abs=0.02)


def test_a_camera_that_looks_back_turns_past_180_degrees(corner):
    def behind(*words):
        with open_world(corner, "cameras.0.p_BC_m=[-0.5,0.0,1.0]", *words) as world:
            return world.snapshot.clients[0].sensors.cameras[0].depth_m

    turned = behind("cameras.0.yaw_deg=180", "vary.camera_turn_deg=[2,2]", "cameras.0.pitch_deg=-17")
    assert np.array_equal(turned, behind("cameras.0.yaw_deg=-178", "cameras.0.pitch_deg=-15"))


def test_light_brightens_colours_and_nothing_else(corner):
    def frame(*words):
        with open_world(corner, "cameras.0.rgb=true", *words) as world:
            return world.snapshot.clients[0].sensors.cameras[0]

    usual, dim = frame(), frame("vary.light=[0.5,0.5]")
    assert np.abs(dim.rgb.astype(float) - 0.5 * usual.rgb).max() <= 1.0
    assert np.array_equal(dim.depth_m, usual.depth_m) and np.array_equal(dim.class_id, usual.class_id)
    assert frame("vary.light=[4,4]").rgb.max() == 255


@pytest.mark.parametrize(
    "word, told",
    [
        ("vary.user_mass_kg=[60,400]", ("vary.user_mass_kg", "400", "150 kg")),
        ("vary.user_mass_kg=[90,60]", ("vary.user_mass_kg", "90", "low <= high")),
        ("vary.friction=[0,1]", ("vary.friction", "0.05")),
        ("vary.light=[0.5,nan]", ("vary.light", "nan", "finite")),
        ("vary.action_delay_ticks=[0,11]", ("vary.action_delay_ticks", "10 ticks")),
        ("vary.camera_turn_deg=[0,90]", ("vary.camera_turn_deg", "45 deg")),
        ("vary.fog=[0,1]", ("vary.fog", "unknown key")),
        ("world.action_delay_ticks=99", ("world.action_delay_ticks", "10 ticks")),
        ("vary.camera_turn_deg=[-40,0]", ("vary.camera_turn_deg", "front", "-100", "-80", "deg")),
        ("vary.camera_shift_m=[-0.5,0]", ("vary.camera_shift_m", "front", "inside")),
        ('vary.plant={"wheel.radius_m"=[0.1,2.0]}', ("vary.plant.wheel.radius_m", "0.1 m", "0.12", "0.32 m")),
        ('vary.plant={"wheel.colour"=[1,2]}', ("wheel.colour", "unknown")),
        ('vary.plant={"mass.com_x_m"=[-0.4,0.2]}', ("vary.plant.mass.com_x_m",)),
    ],
)  # fmt: skip
def test_a_range_out_of_bounds_is_refused_before_anything_moves(word, told):
    with pytest.raises(ConfigError) as error:
        Randomization(quick_config("cameras.0.pitch_deg=-60", word), 0)
    for text in told:
        assert text in str(error.value), str(error.value)


def test_a_chair_that_cannot_stand_is_drawn_again():
    ranges = '{"mass.com_x_m"=[0.2,0.32], "casters.*.swivel_x_m"=[0.35,0.5]}'  # short and front-heavy tips over
    variation = Randomization(quick_config(f"vary.plant={ranges}"), 0)
    fitted = [variation.fitting(1, episode) for episode in range(12)]
    first = [_draw(quick_config(f"vary.plant={ranges}").vary, 1, 1, 0, episode) for episode in range(12)]
    again = [fitting.drawn != drawn for fitting, drawn in zip(fitted, first, strict=True)]
    assert 0 < sum(again) < 12
    assert [variation.fitting(1, episode).drawn for episode in range(12)] == [fitting.drawn for fitting in fitted]


def test_ranges_in_which_no_chair_can_stand_are_refused(monkeypatch):
    monkeypatch.setattr("wcsim.bridge.ego.randomization.TRIES", 3)
    ranges = '{"mass.com_x_m"=[0.3,0.3], "casters.*.swivel_x_m"=[0.35,0.35]}'
    with pytest.raises(ConfigError, match=r"no chair that can stand.*narrower"):
        Randomization(quick_config(f"vary.plant={ranges}"), 0).fitting(1, 0)


@pytest.mark.parametrize(
    "words, says",
    [
        (("chair.plant=mwd", 'vary.plant={"casters.*.arm.damping_Nspm"=[400,2300]}'), "too stiff for physics steps"),
        (('vary.plant={"limits.speed_mps"=[0.2,0.5]}',), "expected a number of its body"),
        (('vary.plant={"chair.accel_mps2"=[0.2,0.5]}',), "expected a number of its body"),
        (('vary.plant={"mass.user_kg"=[40,50]}', "vary.user_mass_kg=[30,40]"), "expected only one of them"),
    ],
)
def test_ranges_that_cannot_be_driven_or_change_nothing_are_refused_at_once(words, says):
    with pytest.raises(ConfigError, match=says):
        Randomization(resolve("quick", words), 0)
