"""Properties of the frames: the file tests of `wcsim/core/frames.py`."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wcsim.core import frames

ANGLES = st.floats(-20.0, 20.0)
COORDINATES = st.tuples(*[st.floats(-1e4, 1e4)] * 3).map(np.array)


@given(COORDINATES, ANGLES, st.floats(-0.4, 0.4), st.floats(0.2, 30.0))
def test_centre_and_front_are_inverse(p, yaw, pitch, length):
    there = frames.front_from_centre(p, yaw, pitch, -length)
    assert np.allclose(frames.front_from_centre(there, yaw, pitch, length), p, atol=1e-9)
    assert math.isclose(np.linalg.norm(there - p), length / 2, rel_tol=1e-6, abs_tol=1e-9)


@given(st.floats(0.0, 359.99))
def test_heading_survives_the_round_trip(heading_deg):
    back = frames.sumo_from_yaw(frames.yaw_from_sumo(heading_deg))
    assert min(abs(back - heading_deg), 360.0 - abs(back - heading_deg)) < 1e-9


@given(st.floats(0.0, 359.99))
def test_a_vehicle_that_drives_along_its_heading_moves_along_its_yaw(heading_deg):
    ahead = frames.forward_vector(frames.yaw_from_sumo(heading_deg), 0.0)
    angle = math.radians(heading_deg)
    assert np.allclose(ahead, [math.sin(angle), math.cos(angle), 0.0], atol=1e-12)


@given(ANGLES)
def test_wrap_keeps_the_direction(angle):
    wrapped = frames.wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


def test_a_nose_up_car_has_its_middle_below_its_front():
    centre = frames.front_from_centre(np.zeros(3), 0.0, math.radians(5.0), -4.5)
    assert centre[2] < 0.0 < -centre[0]


@given(COORDINATES, st.tuples(st.integers(-10000, 10000), st.integers(-10000, 10000)))
def test_net_and_world_are_inverse(p, origin):
    there = frames.world_from_net(p, origin)
    assert np.allclose(frames.net_from_world(there, origin), p, atol=1e-9)
    assert there[2] == p[2]


@given(
    COORDINATES,
    st.floats(0.0, 359.99),
    st.floats(-15.0, 15.0),
    st.floats(0.1, 60.0),
    st.tuples(st.integers(-10000, 10000), st.integers(-10000, 10000)),
)
def test_from_sumo_s_front_to_our_middle_and_back(front_net, heading_deg, slope_deg, length, origin):
    """Net to W, front to middle and all the way back, any heading and slope; a person is a vehicle in this."""
    yaw, pitch = frames.yaw_from_sumo(heading_deg), frames.deg2rad(slope_deg)
    middle = frames.front_from_centre(frames.world_from_net(front_net, origin), yaw, pitch, -length)
    back = frames.net_from_world(frames.front_from_centre(middle, yaw, pitch, length), origin)
    assert np.allclose(back, front_net, rtol=0.0, atol=1e-9)
    way = frames.world_from_net(front_net, origin) - middle
    assert math.isclose(way[2], 0.5 * length * math.sin(pitch), abs_tol=1e-9), "the nose is up by the slope"
    assert math.isclose(math.hypot(way[0], way[1]), 0.5 * length * math.cos(pitch), abs_tol=1e-9)
