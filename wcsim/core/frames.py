"""SUMO's frames against the world frame W. Degrees and front bumpers live here and nowhere else.

SUMO: heading in degrees clockwise from north; a vehicle's position is the middle of its FRONT bumper (SUMO
documentation, "TraCI/Vehicle Value Retrieval"), a person's is the middle of its front as well. W: recentred by the
town's integer origin.
"""

from __future__ import annotations

import math

import numpy as np

from wcsim.types import F64


def yaw_from_sumo(heading_deg: float) -> float:
    """SUMO's heading as yaw in (-pi, pi].

    >>> round(yaw_from_sumo(90.0), 6), round(yaw_from_sumo(0.0), 4), round(yaw_from_sumo(270.0), 4)
    (0.0, 1.5708, 3.1416)
    """
    return wrap(math.radians(90.0 - heading_deg))


def sumo_from_yaw(yaw_rad: float) -> float:
    """Yaw as SUMO's heading in [0, 360).

    >>> sumo_from_yaw(0.0)
    90.0
    """
    return (90.0 - math.degrees(yaw_rad)) % 360.0


def wrap(angle_rad: float) -> float:
    """The same angle in (-pi, pi].

    >>> round(wrap(3 * math.pi / 2), 4)
    -1.5708
    """
    turned = math.fmod(angle_rad, 2.0 * math.pi)
    if turned > math.pi:
        return turned - 2.0 * math.pi
    return turned + 2.0 * math.pi if turned <= -math.pi else turned


def centre_from_front(front_m: F64, yaw_rad: float, pitch_rad: float, length_m: float) -> F64:
    """Ground point below the middle of a box, from the middle of its front edge; (3,) to (3,), pitch is nose up.

    >>> centre_from_front(np.array([10.0, 0.0, 0.0]), 0.0, 0.0, 4.0).tolist()
    [8.0, 0.0, 0.0]
    """
    return front_m - 0.5 * length_m * forward(yaw_rad, pitch_rad)


def front_from_centre(centre_m: F64, yaw_rad: float, pitch_rad: float, length_m: float) -> F64:
    """The inverse of `centre_from_front`."""
    return centre_m + 0.5 * length_m * forward(yaw_rad, pitch_rad)


def forward(yaw_rad: float, pitch_rad: float) -> F64:
    """Unit vector (3,) in W of something that looks along yaw, nose up by pitch."""
    flat = math.cos(pitch_rad)
    return np.array([flat * math.cos(yaw_rad), flat * math.sin(yaw_rad), math.sin(pitch_rad)])


def world_from_net(p_net_m: F64, origin_m: tuple[float, float]) -> F64:
    """Net coordinates (..., 2 or 3) as W coordinates: the town's origin taken off x and y."""
    moved = np.array(p_net_m, dtype=np.float64)
    moved[..., :2] -= origin_m
    return moved


def net_from_world(p_W_m: F64, origin_m: tuple[float, float]) -> F64:
    """The inverse of `world_from_net`."""
    moved = np.array(p_W_m, dtype=np.float64)
    moved[..., :2] += origin_m
    return moved


def rad(angle_deg: float) -> float:
    """A configured angle (key `*_deg`) in radians."""
    return math.radians(angle_deg)


def deg(angle_rad: float) -> float:
    """An angle in degrees, for a file or a person."""
    return math.degrees(angle_rad)
