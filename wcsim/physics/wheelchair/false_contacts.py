"""Contacts that cannot be: PyBullet sometimes puts a wheel's contact point far off the wheel.

Rolling over the edge between two triangles of a flat floor, its closest-point search now and then (once in a few
kilometres) answers with a point of the neighbour triangle that lies centimetres to metres beside the wheel (bullet3
issue 2157). A turning wheel seems to come down there fast, and the chair is thrown as if by a kerb. A force that large
is looked at here, and a step with such a contact is not taken: the chair coasts on as it was for that step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from wcsim.core.rotations import Quat, Vec3, added, matrix, rotate_back, turned
from wcsim.physics.bullet import pybullet

SUSPECT_N: Final = 2000.0  # a wheel carries less than 1000 N; below this a ghost does no harm
_SLACK_M: Final = 0.02  # what a link moves in a step beside its body
MOST_IN_A_ROW: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Tyre:
    """A wheel's cylinder; its link's inertial frame has y along the axle."""

    radius_m: float
    half_width_m: float


class Motion(NamedTuple):
    """How a body moved before a step."""

    p_W_m: Vec3
    q_WB: Quat
    v_W_mps: Vec3
    w_W_radps: Vec3
    joints: Sequence[tuple[Any, ...]]  # of each that moves, first its position and its velocity


def off_tyre(point_m: Vec3, normal: Vec3, tyre: Tyre) -> bool:
    """Whether something cannot touch a wheel at a point with a normal, both in the wheel's frame (y along the axle).

    What pushes a cylinder inwards along a normal touches it where that normal, turned round, leads out of it.

    >>> tyre = Tyre(radius_m=0.1, half_width_m=0.025)
    >>> off_tyre((0.0, 0.02, -0.1), (0.0, 0.0, 1.0), tyre), off_tyre((0.05, 0.02, -0.1), (0.0, 0.0, 1.0), tyre)
    (False, True)
    """
    x, y, z = point_m
    if abs(y) > tyre.half_width_m + _SLACK_M:
        return True
    radial = math.hypot(normal[0], normal[2])
    if radial < 0.5:  # it pushes on the side of the wheel, where any place will do
        return math.hypot(x, z) > tyre.radius_m + _SLACK_M
    reach = tyre.radius_m / radial
    return math.hypot(x + reach * normal[0], z + reach * normal[2]) > _SLACK_M


def is_ghost(point: tuple[Any, ...], body: int, tyre: Tyre, before: Motion, client: int) -> bool:
    """Whether a contact point of PyBullet (3 link, 5 place on it, 7 normal) cannot have been on the wheel.

    The point is where things were before the step, the link where it is now: the body's way in the step lies between.
    """
    now, _ = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    state = pybullet.getLinkState(body, point[3], computeForwardKinematics=1, physicsClientId=client)
    hub, was, place = state[0], before.p_W_m, point[5]
    to_place = [place[k] + now[k] - was[k] - hub[k] for k in range(3)]
    rotation = matrix(state[1])
    return off_tyre(rotate_back(rotation, *to_place), rotate_back(rotation, *point[7]), tyre)


def coast(body: int, joints: Sequence[int], before: Motion, dt_s: float, client: int) -> None:
    """Put a body where its motion before the step carries it, with that motion unchanged."""
    vx, vy, vz = before.v_W_mps
    p = added(before.p_W_m, (vx * dt_s, vy * dt_s, vz * dt_s))
    pybullet.resetBasePositionAndOrientation(
        body, p, turned(before.q_WB, before.w_W_radps, dt_s), physicsClientId=client
    )
    pybullet.resetBaseVelocity(body, before.v_W_mps, before.w_W_radps, physicsClientId=client)
    for joint, (place, rate, *_) in zip(joints, before.joints, strict=True):
        pybullet.resetJointState(body, joint, place + rate * dt_s, rate, physicsClientId=client)
