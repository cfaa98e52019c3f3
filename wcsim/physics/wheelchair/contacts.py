"""What a wheelchair touched during a tick, and who moved into whom.

Wheels, casters and anti-tips on ground or kerb are how a chair stands: the caller leaves them out before it comes here.
"""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple

from wcsim.physics.engine import BodyTag, Role
from wcsim.types import Contact

Vec3 = tuple[float, float, float]
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
        now = {(body, tag.actor_id): (self._cause[body], self._kept_ticks) for body, tag in self._tags.items()}
        self._cause_before = {**kept, **now}
        self._impulse_Ns.clear()
        self._tags.clear()
        self._cause.clear()
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
    return "other" if other > own else "own"
