"""Where cameras look: mounts, poses, and the ideal camera of a configuration."""

import math
from collections.abc import Sequence

import numpy as np

from wcsim.config import CameraConfig
from wcsim.core import frames
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.instances import rotation_of
from wcsim.types import F64

# Axes of a camera in the frame of its mount, along whose x it looks: x right, y down, z forward.
_R_CM = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def pinhole(camera: CameraConfig) -> Pinhole:
    """The ideal camera of a configuration."""
    return Pinhole(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=focal_px(camera.width_px, frames.deg2rad(camera.hfov_deg)),
        near_m=camera.near_m,
        range_m=camera.range_m,
    )


def focal_px(width_px: int, hfov_rad: float) -> float:
    """Focal length in pixels of a camera that sees hfov_rad over its width.

    >>> round(focal_px(320, math.pi / 2), 6)
    160.0
    """
    return 0.5 * width_px / math.tan(0.5 * hfov_rad)


def mount(camera: CameraConfig) -> F64:
    """Pose (3, 4) in the chair's frame B of the camera's mount: it looks along x, y left, z up."""
    turns_deg = camera.yaw_deg, camera.pitch_deg, camera.roll_deg
    return pose_of(camera.p_BC_m, *map(frames.deg2rad, turns_deg))


def pose_of(
    p_m: Sequence[float] | F64, yaw_rad: float, pitch_rad: float, roll_rad: float = 0.0
) -> F64:
    """Pose (3, 4) of a frame at p along yaw, nose up by pitch, right side down by roll."""
    return np.column_stack([turn_of(yaw_rad, pitch_rad, roll_rad), np.asarray(p_m, np.float64)])


def turn_of(yaw_rad: float, pitch_rad: float, roll_rad: float) -> F64:
    """Rotation (3, 3) of such a frame: its axes x ahead, y left and z up, as columns."""
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    level = np.array([[cy * cp, -sy, -cy * sp], [sy * cp, cy, -sy * sp], [sp, 0.0, cp]])
    if roll_rad == 0.0:
        return level
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    ahead, left, up = level.T
    return np.column_stack([ahead, cr * left + sr * up, cr * up - sr * left])


def pose_matrix(p_WB_m: F64, q_WB: F64) -> F64:
    """Pose (3, 4) of a body from its place (3,) and quaternion (4,) x, y, z, w."""
    T_WB = np.empty((3, 4))
    T_WB[:, :3] = rotation_of(q_WB)
    T_WB[:, 3] = p_WB_m
    return T_WB


def camera_matrix(T_WB: F64, T_BM: F64) -> F64:
    """World to camera frame (3, 4), x right, y down, of a camera on mount M of body B."""
    R_WM = T_WB[:, :3] @ T_BM[:, :3]
    p_WM = T_WB[:, :3] @ T_BM[:, 3] + T_WB[:, 3]
    R_CW = _R_CM @ R_WM.T
    T_CW = np.empty((3, 4))
    T_CW[:, :3] = R_CW
    T_CW[:, 3] = -R_CW @ p_WM
    return T_CW


def look_along(p_W_m: Sequence[float] | F64, yaw_rad: float, pitch_rad: float) -> F64:
    """World to camera frame (3, 4) of a camera at p along yaw, nose up by pitch (-pi/2: down)."""
    return camera_matrix(np.eye(3, 4), pose_of(p_W_m, yaw_rad, pitch_rad))


def look_at(p_W_m: Sequence[float] | F64, target_W_m: Sequence[float] | F64) -> F64:
    """World to camera frame (3, 4) of a level camera at p, with the target in its middle."""
    x, y, z = np.asarray(target_W_m, np.float64) - np.asarray(p_W_m, np.float64)
    return look_along(p_W_m, math.atan2(y, x), math.atan2(z, math.hypot(x, y)))
