"""Rotations as nine plain floats, row by row: a substep is too short for arrays.

Angles: yaw counter-clockwise, pitch nose up positive, roll right side down positive, turned in this order.
"""

from __future__ import annotations

import math
from typing import Final

Vec3 = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]
Quat = tuple[float, float, float, float]
LEVEL: Final[Rotation] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def rotate(r: Rotation, x: float, y: float, z: float) -> Vec3:
    """R times a vector."""
    return (r[0] * x + r[1] * y + r[2] * z, r[3] * x + r[4] * y + r[5] * z, r[6] * x + r[7] * y + r[8] * z)


def rotate_back(r: Rotation, x: float, y: float, z: float) -> Vec3:
    """R transposed times a vector."""
    return (r[0] * x + r[3] * y + r[6] * z, r[1] * x + r[4] * y + r[7] * z, r[2] * x + r[5] * y + r[8] * z)


def added(a: Vec3, b: Vec3) -> Vec3:
    """Sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def velocity_at(point: Vec3, known: Vec3, v_known: Vec3, w: Vec3) -> Vec3:
    """Velocity of a point of a rigid body, from that of a known point and the angular velocity, all in one frame."""
    x, y, z = point[0] - known[0], point[1] - known[1], point[2] - known[2]
    wx, wy, wz = w
    return (v_known[0] + wy * z - wz * y, v_known[1] + wz * x - wx * z, v_known[2] + wx * y - wy * x)


def matrix(q: Quat) -> Rotation:
    """Rotation matrix of a unit quaternion (x, y, z, w).

    >>> matrix((0.0, 0.0, 0.0, 1.0))
    (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    """
    x, y, z, w = q
    xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
    xy, xz, yz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
    wx, wy, wz = 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
    return (1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy)


def euler(r: Rotation) -> tuple[float, float, float]:
    """Roll, pitch (nose up positive) and yaw of a rotation, in radians."""
    pitch = math.asin(min(max(r[6], -1.0), 1.0))
    return math.atan2(r[7], r[8]), pitch, math.atan2(r[3], r[0])


def turned(q: Quat, w: Vec3, dt_s: float) -> Quat:
    """A rotation after turning with angular velocity w (world frame) for a short time."""
    hx, hy, hz = 0.5 * dt_s * w[0], 0.5 * dt_s * w[1], 0.5 * dt_s * w[2]
    x, y, z, s = q
    out = (x + hx * s + hy * z - hz * y, y + hy * s + hz * x - hx * z, z + hz * s + hx * y - hy * x)
    last = s - hx * x - hy * y - hz * z
    k = 1.0 / math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + last**2)
    return (k * out[0], k * out[1], k * out[2], k * last)


def quaternion(yaw_rad: float, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> Quat:
    """Unit quaternion (x, y, z, w) of something that looks along yaw, nose up by pitch, right side down by roll.

    >>> [round(part, 4) for part in quaternion(math.pi / 2)]
    [0.0, 0.0, 0.7071, 0.7071]
    """
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    x, y, z, w = sy * sp, 0.0 - cy * sp, sy * cp, cy * cp
    if roll_rad == 0.0:
        return (x, y, z, w)
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    return (w * sr + x * cr, y * cr + z * sr, z * cr - y * sr, w * cr - x * sr)
