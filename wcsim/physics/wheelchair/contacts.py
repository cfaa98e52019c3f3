"""What a wheelchair touched during a tick, which of both moved, and which contacts cannot be.

Wheels, casters and anti-tips on ground or kerb are how a chair stands: the caller leaves them out.

PyBullet sometimes puts a wheel's contact point far off the wheel (bullet3 issue 2157). That is once
in a few kilometres, on the edge between two triangles of a flat floor. The closest-point search
then gives a point of the neighbour triangle, centimetres to metres beside the wheel. A turning
wheel seems to come down there fast, and the chair is thrown as if by a kerb. A force that large is
looked at here, and a step with such a contact is not taken: the chair coasts on for that step.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

from wcsim.core.frames import (
    Quat,
    Vec3,
    add_vectors,
    integrate_quaternion,
    matrix_from_quaternion,
    rotate_vector_inverse,
)
from wcsim.physics.bullet import Bullet
from wcsim.physics.engine import BodyTag, Role
from wcsim.types import Contact

Cause = Literal["own", "other"]
KEPT_S: Final = 1.0  # apart, until the cause is decided anew
MOST_IN_A_ROW: Final = 3
_STEEP: Final = 0.8  # vertical part of a normal above which one body lies on the other
_SLACK_M: Final = 0.02  # what a link moves in a step beside its body


class ContactPoint(NamedTuple):
    """Where a body touches a chair, and how the chair moved there before."""

    point_W_m: Vec3
    v_chair_W_mps: Vec3  # velocity of the chair's material at the point
    normal_to_chair: Vec3  # unit vector from the other body to the chair


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

    def is_ghost(self, point: tuple[Any, ...], body: int, tyre: Tyre, bullet: Bullet) -> bool:
        """Whether a contact point cannot have been on the wheel.

        PyBullet's fields of it: 3 link, 5 place on it, 7 normal. The point is where things were
        before the step, the link where it is now: the body's way in the step lies between.
        """
        now, _ = bullet.getBasePositionAndOrientation(body)
        state = bullet.getLinkState(body, point[3], computeForwardKinematics=1)
        hub, place = state[0], point[5]
        to_place = [place[k] + now[k] - self.p_W_m[k] - hub[k] for k in range(3)]
        rotation = matrix_from_quaternion(state[1])
        normal = rotate_vector_inverse(rotation, *point[7])
        return _off_tyre(rotate_vector_inverse(rotation, *to_place), normal, tyre)

    def coast(self, body: int, joints: Sequence[int], dt_s: float, bullet: Bullet) -> None:
        """Put the body where this motion carries it in a step, with the motion unchanged."""
        vx, vy, vz = self.v_W_mps
        p = add_vectors(self.p_W_m, (vx * dt_s, vy * dt_s, vz * dt_s))
        q = integrate_quaternion(self.q_WB, self.w_W_radps, dt_s)
        bullet.resetBasePositionAndOrientation(body, p, q)
        bullet.resetBaseVelocity(body, self.v_W_mps, self.w_W_radps)
        for joint, (place, rate, *_) in zip(joints, self.joints, strict=True):
            bullet.resetJointState(body, joint, place + rate * dt_s, rate)


class ContactLog:
    """Touches of one chair in the tick that runs, summed by other body and part.

    The cause is decided at the first touch, with the velocities before it. It stays until both have
    been apart for a second: a moment later a chair that was hit moves like the car that hit it, or
    whirls back against it.
    """

    def __init__(self, tick_s: float) -> None:
        """Nothing was touched yet; it is closed every `tick_s`."""
        self._apart_ticks = max(1, round(KEPT_S / tick_s))
        self._impulse_Ns: dict[tuple[int, str], float] = {}
        self._tags: dict[int, BodyTag] = {}
        self._cause: dict[int, Cause] = {}
        # By body and actor, with the ticks for which it stays.
        self._cause_before: dict[tuple[int, str], tuple[Cause, int]] = {}

    def add(
        self, body: int, part: str, impulse_Ns: float, tag: BodyTag, touch: ContactPoint
    ) -> None:
        """Count one contact point of a substep between another body and a part of the chair."""
        key = (body, part)
        self._impulse_Ns[key] = self._impulse_Ns.get(key, 0.0) + impulse_Ns
        if body not in self._tags:
            self._tags[body] = tag
            # By body and actor: a pooled body may be another actor's by now.
            before = self._cause_before.get((body, tag.actor_id))
            self._cause[body] = before[0] if before else _cause_of(tag, touch)

    def close(self) -> tuple[Contact, ...]:
        """The contacts of the tick by kind, actor and part; the log is ready for the next tick."""
        found = [
            Contact(
                kind=self._tags[body].kind,
                part=part,
                impulse_Ns=impulse,
                cause=self._cause[body],
                actor_id=self._tags[body].actor_id,
            )
            for (body, part), impulse in self._impulse_Ns.items()
        ]
        # What touched in this tick counts anew; for the others the time apart runs on.
        self._cause_before = {
            key: (cause, ticks - 1)
            for key, (cause, ticks) in self._cause_before.items()
            if ticks > 1
        }
        for body, tag in self._tags.items():
            self._cause_before[body, tag.actor_id] = self._cause[body], self._apart_ticks
        self._impulse_Ns.clear()
        self._tags.clear()
        self._cause.clear()
        # By name: PyBullet's order is that of the bodies' numbers, which depend on the pool.
        return tuple(sorted(found, key=lambda item: (item.kind, item.actor_id, item.part)))

    def forget(self, actor_id: str) -> None:
        """Forget an actor that has left for good; another one may get its name."""
        self._cause_before = {
            key: cause for key, cause in self._cause_before.items() if key[1] != actor_id
        }

    def clear(self) -> None:
        """Forget everything, earlier ticks too."""
        self.close()
        self._cause_before.clear()


def _cause_of(tag: BodyTag, touch: ContactPoint) -> Cause:
    """The chair's own, or the other's when that came towards it faster than it towards that.

    Where one lies on the other the normal says nothing of that; then the faster one came.

    Args:
        tag: The other body; what stands still is never the cause.
        touch: Where they touch, and the chair's velocity there before.
    """
    if tag.role not in (Role.ACTOR, Role.CHAIR):
        return "own"
    (px, py, _), (nx, ny, nz) = touch.point_W_m, touch.normal_to_chair
    vx = tag.v_W_mps[0] - tag.yaw_rate_radps * (py - tag.p_W_m[1])
    vy = tag.v_W_mps[1] + tag.yaw_rate_radps * (px - tag.p_W_m[0])
    cx, cy, cz = touch.v_chair_W_mps
    if abs(nz) > _STEEP:
        return "other" if math.hypot(vx, vy) > math.hypot(cx, cy) else "own"
    other = vx * nx + vy * ny + tag.v_W_mps[2] * nz
    own = -(cx * nx + cy * ny + cz * nz)
    # A tie is the chair's own: the other one did not come faster.
    return "other" if other > own else "own"


def _off_tyre(point_m: Vec3, normal: Vec3, tyre: Tyre) -> bool:
    """Whether nothing can touch a wheel at a point with a normal, in its frame (y along the axle).

    What pushes a cylinder inwards along a normal touches it where that normal, turned round, leads
    out of it.

    >>> tyre = Tyre(radius_m=0.1, half_width_m=0.025)
    >>> [_off_tyre((x, 0.02, -0.1), (0.0, 0.0, 1.0), tyre) for x in (0.0, 0.05)]
    [False, True]
    """
    x, y, z = point_m
    if abs(y) > tyre.half_width_m + _SLACK_M:
        return True
    radial = math.hypot(normal[0], normal[2])
    # It pushes on the side of the wheel, where any place will do.
    if radial < 0.5:
        return math.hypot(x, z) > tyre.radius_m + _SLACK_M
    reach = tyre.radius_m / radial
    return math.hypot(x + reach * normal[0], z + reach * normal[2]) > _SLACK_M
