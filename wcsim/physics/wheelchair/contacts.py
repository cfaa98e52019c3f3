"""What a wheelchair touched during a tick, who moved into whom, and which contacts cannot be.

Wheels, casters and anti-tips on ground or kerb are how a chair stands: the caller leaves them out before it comes here.

PyBullet sometimes puts a wheel's contact point far off the wheel. Rolling over the edge between two triangles of a flat
floor, its closest-point search now and then (once in a few kilometres) answers with a point of the neighbour triangle
that lies centimetres to metres beside the wheel (bullet3 issue 2157). A turning wheel seems to come down there fast,
and the chair is thrown as if by a kerb. A force that large is looked at here, and a step with such a contact is not
taken: the chair coasts on as it was for that step.
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
KEPT_S: Final = 1.0  # apart, until who came into whom is decided anew
_STEEP: Final = 0.8  # vertical part of a normal above which one body lies on the other
_MOVING: Final = (Role.ACTOR, Role.CHAIR)


class ContactPoint(NamedTuple):
    """Where a body touches a chair, and how the chair moved there before."""

    point_W_m: Vec3
    v_chair_W_mps: Vec3  # velocity of the chair's material at the point
    normal_to_chair: Vec3  # unit vector from the other body to the chair


class ContactLog:
    """Touches of one chair in the tick that runs, summed by other body and part.

    The cause is decided at the first touch, with the velocities before it, and kept until they have been apart for a
    second: a moment later a chair that was hit moves like the car that hit it, or whirls back against it.
    """

    def __init__(self, tick_s: float) -> None:
        """Nothing was touched yet; it is closed every `tick_s`."""
        self._kept_ticks = max(1, round(KEPT_S / tick_s))
        self._impulse_Ns: dict[tuple[int, str], float] = {}
        self._tags: dict[int, BodyTag] = {}
        self._cause: dict[int, Cause] = {}
        self._cause_before: dict[tuple[int, str], tuple[Cause, int]] = {}  # and the ticks for which it is kept

    def add(self, body: int, part: str, impulse_Ns: float, tag: BodyTag, touch: ContactPoint) -> None:
        """Count one contact point of one substep: another body, the chair's part, its normal impulse."""
        key = (body, part)
        self._impulse_Ns[key] = self._impulse_Ns.get(key, 0.0) + impulse_Ns
        if body not in self._tags:
            self._tags[body] = tag
            # By body and actor: a pooled body may be another actor's by now.
            before = self._cause_before.get((body, tag.actor_id))
            self._cause[body] = before[0] if before else _cause_of(tag, touch)

    def close(self) -> tuple[Contact, ...]:
        """The contacts of the tick, sorted by kind, actor and part; the log is ready for the next tick."""
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
        kept = {key: (cause, ticks - 1) for key, (cause, ticks) in self._cause_before.items() if ticks > 1}
        # Whoever touched in this tick counts anew; for the others the time apart runs on.
        now = {(body, tag.actor_id): (self._cause[body], self._kept_ticks) for body, tag in self._tags.items()}
        self._cause_before = {**kept, **now}
        self._impulse_Ns.clear()
        self._tags.clear()
        self._cause.clear()
        # By name: PyBullet lists contacts by the numbers of bodies, and these depend on which pooled body came first.
        return tuple(sorted(found, key=lambda item: (item.kind, item.actor_id, item.part)))

    def forget(self, actor_id: str) -> None:
        """Forget an actor that has left for good; another one of its name may come."""
        self._cause_before = {key: kept for key, kept in self._cause_before.items() if key[1] != actor_id}

    def clear(self) -> None:
        """Forget everything, earlier ticks too."""
        self.close()
        self._cause_before.clear()


def _cause_of(tag: BodyTag, touch: ContactPoint) -> Cause:
    """Who moved into whom: "other" when the body comes towards the chair faster than the chair towards it.

    Where one lies on the other the normal says nothing of who came; then the faster one did.

    Args:
        tag: The other body; what stands still is never the cause.
        touch: Where they touch, and the chair's velocity there before.
    """
    if tag.role not in _MOVING:
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

    def is_ghost(self, point: tuple[Any, ...], body: int, tyre: Tyre, bullet: Bullet) -> bool:
        """Whether a contact point of PyBullet (3 link, 5 place on it, 7 normal) cannot have been on the wheel.

        The point is where things were before the step, the link where it is now: the body's way in the step lies
        between.
        """
        now, _ = bullet.getBasePositionAndOrientation(body)
        state = bullet.getLinkState(body, point[3], computeForwardKinematics=1)
        hub, place = state[0], point[5]
        to_place = [place[k] + now[k] - self.p_W_m[k] - hub[k] for k in range(3)]
        rotation = matrix_from_quaternion(state[1])
        return _off_tyre(rotate_vector_inverse(rotation, *to_place), rotate_vector_inverse(rotation, *point[7]), tyre)

    def coast(self, body: int, joints: Sequence[int], dt_s: float, bullet: Bullet) -> None:
        """Put the body where this motion carries it in a step, with the motion unchanged."""
        vx, vy, vz = self.v_W_mps
        p = add_vectors(self.p_W_m, (vx * dt_s, vy * dt_s, vz * dt_s))
        bullet.resetBasePositionAndOrientation(body, p, integrate_quaternion(self.q_WB, self.w_W_radps, dt_s))
        bullet.resetBaseVelocity(body, self.v_W_mps, self.w_W_radps)
        for joint, (place, rate, *_) in zip(joints, self.joints, strict=True):
            bullet.resetJointState(body, joint, place + rate * dt_s, rate)


def _off_tyre(point_m: Vec3, normal: Vec3, tyre: Tyre) -> bool:
    """Whether something cannot touch a wheel at a point with a normal, both in the wheel's frame (y along the axle).

    What pushes a cylinder inwards along a normal touches it where that normal, turned round, leads out of it.

    >>> tyre = Tyre(radius_m=0.1, half_width_m=0.025)
    >>> _off_tyre((0.0, 0.02, -0.1), (0.0, 0.0, 1.0), tyre), _off_tyre((0.05, 0.02, -0.1), (0.0, 0.0, 1.0), tyre)
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
