"""Speed and place of the chair: from its commands alone, from its senses, and with commands on their way."""

import math

import numpy as np
import pytest

from wcsim.agents.perception.arcs import integrate_chair_state, predict_delayed_state
from wcsim.agents.perception.ego_motion import EgoMotionEstimator, body_to_odometric, odometric_to_body
from wcsim.config import ChairConfig
from wcsim.core.joystick import drive_limits_from_chair

LIMITS = drive_limits_from_chair(ChairConfig())
TICK_S = 0.1
REST, AHEAD, LEFT = np.zeros(2), np.array([0.0, 1.0]), np.array([-0.5, 0.5])


def seen(speed_mps=None, turn_radps=None, gyro_radps=None):
    """An observation with odometry and turn rates where they are given."""
    imu = np.zeros(5 if gyro_radps is None else 8, np.float32)
    if gyro_radps is not None:
        imu[7] = gyro_radps / 4.0
    observation = {"imu": imu}
    if speed_mps is not None:
        observation["odometry"] = np.array([speed_mps / 4.0, (turn_radps or 0.0) / 4.0], np.float32)
    return observation


def drive(ego, command, ticks, observation):
    for _ in range(ticks):
        ego.observe(observation, REST)
        ego.command(command)


def test_without_senses_the_commands_say_how_fast_it_is():
    ego = EgoMotionEstimator(LIMITS, TICK_S, 0)
    drive(ego, AHEAD, 30, seen())
    ego.observe(seen(), REST)
    assert ego.motion[0] == pytest.approx(1.67) and ego.pose_O[0] > 3.0
    assert ego.way_m == pytest.approx(ego.pose_O[0]) and abs(ego.pose_O[1:]).max() < 1e-9


def test_a_late_command_is_obeyed_late():
    prompt, late = EgoMotionEstimator(LIMITS, TICK_S, 0), EgoMotionEstimator(LIMITS, TICK_S, 3)
    speeds = {"prompt": [], "late": []}
    for _ in range(12):
        for name, ego in (("prompt", prompt), ("late", late)):
            ego.observe(seen(), REST)
            speeds[name].append(ego.motion[0])
            ego.command(AHEAD)
    assert speeds["late"][3:] == speeds["prompt"][:-3] and speeds["late"][:4] == [0.0] * 4
    assert late.waiting.tolist() == [AHEAD.tolist()] * 4 and len(prompt.waiting) == 1


def test_what_the_wheels_and_the_gyroscope_say_counts_more_than_what_was_commanded():
    ego = EgoMotionEstimator(LIMITS, TICK_S, 0)
    drive(ego, AHEAD, 40, seen(speed_mps=0.4, turn_radps=0.3, gyro_radps=-0.2))
    assert ego.motion[0] < 0.75 and ego.motion[1] == pytest.approx(-0.2, abs=0.1)
    assert ego.way_m == pytest.approx(39 * TICK_S * 0.4, rel=1e-3)
    assert ego.pose_O[2] == pytest.approx(-39 * TICK_S * 0.2, rel=1e-3)
    wheels = EgoMotionEstimator(LIMITS, TICK_S, 0)
    drive(wheels, AHEAD, 40, seen(speed_mps=0.4, turn_radps=0.3))
    assert wheels.pose_O[2] == pytest.approx(39 * TICK_S * 0.3, rel=1e-3)


def test_a_chair_that_is_taken_over_on_its_way_obeys_its_driver_for_a_while():
    moving, standing = EgoMotionEstimator(LIMITS, TICK_S, 2), EgoMotionEstimator(LIMITS, TICK_S, 2)
    moving.observe(seen(speed_mps=1.2), LEFT)
    standing.observe(seen(speed_mps=0.0), LEFT)
    assert moving.waiting.tolist() == [LEFT.tolist()] * 2 and moving.motion[0] == pytest.approx(1.2)
    assert standing.waiting.tolist() == [REST.tolist()] * 2


def test_without_odometry_a_chair_that_is_taken_over_drives_as_its_user_asks():
    ego, gyro = EgoMotionEstimator(LIMITS, TICK_S, 2), EgoMotionEstimator(LIMITS, TICK_S, 2)
    ego.observe(seen(), LEFT)
    gyro.observe(seen(gyro_radps=-0.2), LEFT)
    assert ego.waiting.tolist() == gyro.waiting.tolist() == [LEFT.tolist()] * 2
    assert ego.motion[0] == gyro.motion[0] == pytest.approx(0.5 * 1.67)
    assert ego.motion[1] > 0.2 and gyro.motion[1] == pytest.approx(-0.2)
    steady = ego.motion.copy()
    ego.command(LEFT)
    ego.observe(seen(), LEFT)
    assert np.allclose(ego.motion, steady)


def test_what_is_on_its_way_is_driven_before_the_next_command():
    motion = np.array([1.0, 0.0, 0.0])
    waiting = np.array([AHEAD, LEFT])
    state = np.concatenate([np.zeros(3), motion])
    for command in waiting:
        integrate_chair_state(state, command, LIMITS, TICK_S)
    assert predict_delayed_state(motion, waiting, LIMITS, TICK_S).tolist() == state.tolist()
    assert state[0] > 0.19 and state[4] > 0.0
    assert predict_delayed_state(motion, np.zeros((0, 2)), LIMITS, TICK_S).tolist() == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]


def test_places_go_to_the_odometric_frame_and_back():
    pose = np.array([2.0, -1.0, 0.7])
    points = np.random.default_rng(0).uniform(-4, 4, (20, 2))
    assert np.allclose(odometric_to_body(body_to_odometric(points, pose), pose), points)
    (front,) = body_to_odometric(np.array([[1.0, 0.0]]), pose)
    assert front == pytest.approx([2.0 + math.cos(0.7), -1.0 + math.sin(0.7)])
