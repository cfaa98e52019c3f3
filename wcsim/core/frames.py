"""SUMO's frames against the world frame W, and rotations.

Degrees and front bumpers are known here and nowhere else.

SUMO: heading in degrees clockwise from north; a vehicle's position is the middle of its FRONT
bumper (SUMO documentation, "TraCI/Vehicle Value Retrieval"), a person's is the middle of its front
as well. W: recentred by the town's integer origin.

Rotations are nine plain floats, row by row, as a substep is too short for arrays. Angles: yaw
counter-clockwise, pitch nose up positive, roll right side down positive, turned in this order.
"""

import math
from typing import Final

import numpy as np

from wcsim.types import F64

Vec3 = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]
Quat = tuple[float, float, float, float]
deg2rad: Final = math.radians
"""A configured angle (key `*_deg`) in radians."""
rad2deg: Final = math.degrees
"""An angle in degrees, for a file or a person."""
LEVEL: Final[Rotation] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def rotate_vector(r: Rotation, x: float, y: float, z: float) -> Vec3:
    """R times a vector."""
    return (
        r[0] * x + r[1] * y + r[2] * z,
        r[3] * x + r[4] * y + r[5] * z,
        r[6] * x + r[7] * y + r[8] * z,
    )


def rotate_vector_inverse(r: Rotation, x: float, y: float, z: float) -> Vec3:
    """R transposed times a vector."""
    return (
        r[0] * x + r[3] * y + r[6] * z,
        r[1] * x + r[4] * y + r[7] * z,
        r[2] * x + r[5] * y + r[8] * z,
    )


def add_vectors(a: Vec3, b: Vec3) -> Vec3:
    """Sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def compute_point_velocity(point: Vec3, known: Vec3, v_known: Vec3, w: Vec3) -> Vec3:
    """Velocity of a point of a rigid body, all in one frame.

    `v_known` is the velocity of the point `known`, `w` the angular velocity.
    """
    x, y, z = point[0] - known[0], point[1] - known[1], point[2] - known[2]
    wx, wy, wz = w
    return (
        v_known[0] + wy * z - wz * y,
        v_known[1] + wz * x - wx * z,
        v_known[2] + wx * y - wy * x,
    )


def matrix_from_quaternion(q: Quat) -> Rotation:
    """Rotation matrix of a unit quaternion (x, y, z, w).

    >>> matrix_from_quaternion((0.0, 0.0, 0.0, 1.0))
    (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    """
    x, y, z, w = q
    xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
    xy, xz, yz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
    wx, wy, wz = 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
    return (
        1.0 - yy - zz,
        xy - wz,
        xz + wy,
        xy + wz,
        1.0 - xx - zz,
        yz - wx,
        xz - wy,
        yz + wx,
        1.0 - xx - yy,
    )


def rpy_from_matrix(r: Rotation) -> tuple[float, float, float]:
    """Roll, pitch (nose up positive) and yaw of a rotation, in radians."""
    pitch = math.asin(min(max(r[6], -1.0), 1.0))
    return math.atan2(r[7], r[8]), pitch, math.atan2(r[3], r[0])


def integrate_quaternion(q: Quat, w: Vec3, dt_s: float) -> Quat:
    """A rotation after a turn with angular velocity w (world frame) for a short time."""
    hx, hy, hz = 0.5 * dt_s * w[0], 0.5 * dt_s * w[1], 0.5 * dt_s * w[2]
    x, y, z, s = q
    out = (x + hx * s + hy * z - hz * y, y + hy * s + hz * x - hx * z, z + hz * s + hx * y - hy * x)
    last = s - hx * x - hy * y - hz * z
    k = 1.0 / math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + last**2)
    return (k * out[0], k * out[1], k * out[2], k * last)


def quaternion_from_ypr(yaw_rad: float, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> Quat:
    """Unit quaternion (x, y, z, w) of yaw, pitch (nose up) and roll (right side down).

    >>> [round(part, 4) for part in quaternion_from_ypr(math.pi / 2)]
    [0.0, 0.0, 0.7071, 0.7071]
    """
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    x, y, z, w = sy * sp, 0.0 - cy * sp, sy * cp, cy * cp
    if roll_rad == 0.0:
        return (x, y, z, w)
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    return (w * sr + x * cr, y * cr + z * sr, z * cr - y * sr, w * cr - x * sr)


def yaw_from_sumo(heading_deg: float) -> float:
    """SUMO's heading as yaw in (-pi, pi].

    >>> round(yaw_from_sumo(90.0), 6), round(yaw_from_sumo(0.0), 4), round(yaw_from_sumo(270.0), 4)
    (0.0, 1.5708, 3.1416)
    """
    return wrap_angle(math.radians(90.0 - heading_deg))


def sumo_from_yaw(yaw_rad: float) -> float:
    """Yaw as SUMO's heading in [0, 360).

    >>> sumo_from_yaw(0.0)
    90.0
    """
    return (90.0 - math.degrees(yaw_rad)) % 360.0


def wrap_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi].

    >>> round(wrap_angle(3 * math.pi / 2), 4)
    -1.5708
    """
    turned = math.fmod(angle_rad, 2.0 * math.pi)
    if turned > math.pi:
        return turned - 2.0 * math.pi
    return turned + 2.0 * math.pi if turned <= -math.pi else turned


def front_from_centre(centre_m: F64, yaw_rad: float, pitch_rad: float, length_m: float) -> F64:
    """The middle (3,) of a box's front edge, from the ground point (3,) below the box's middle.

    >>> front_from_centre(np.array([8.0, 0.0, 0.0]), 0.0, 0.0, 4.0).tolist()
    [10.0, 0.0, 0.0]
    """
    return centre_m + 0.5 * length_m * forward_vector(yaw_rad, pitch_rad)


def forward_vector(yaw_rad: float, pitch_rad: float) -> F64:
    """Unit vector (3,) in W along yaw, nose up by pitch."""
    flat = math.cos(pitch_rad)
    return np.array([flat * math.cos(yaw_rad), flat * math.sin(yaw_rad), math.sin(pitch_rad)])


def world_from_net(p_net_m: F64, origin_m: tuple[float, float]) -> F64:
    """Net coordinates (..., 2 or 3) as W coordinates, which are relative to the town's origin."""
    moved = np.array(p_net_m, np.float64)
    moved[..., :2] -= origin_m
    return moved


def net_from_world(p_W_m: F64, origin_m: tuple[float, float]) -> F64:
    """The inverse of `world_from_net`."""
    moved = np.array(p_W_m, np.float64)
    moved[..., :2] += origin_m
    return moved
