"""Mirror bodies: what SUMO moves, as bodies that a wheelchair can hit.

A mirror body has mass 0 and gets a pose and a velocity once a tick; PyBullet carries it through the
substeps. Pose without velocity lets a car sink half a metre into a chair before it is pushed out.
Bodies are pooled per kind and size, made when first needed, and parked below the street while no
actor needs them.

A body of mass 0 cannot be pushed. That is right for a car; a person would be a wall. So a person's
contact is soft: it gives way by some centimetres, and stops a chair over a tenth of a second.
"""

import math
from collections.abc import KeysView, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.core.frames import Vec3, matrix_from_quaternion, quaternion_from_ypr, rotate_vector
from wcsim.errors import PhysicsError
from wcsim.physics.bullet import pybullet
from wcsim.physics.engine import PARK_Z_M, BodyTag, Engine, Role
from wcsim.types import F64, ActorKind, ActorState

Bucket = tuple[ActorKind, int, int, int]
# Actors of almost one size share bodies, as bodies are never removed.
_BUCKET_M: Final = 0.05
# Below the middle of the anti-tips (0.07 m): nothing of a chair slides under a vehicle.
_CLEARANCE_M: Final = 0.05
UPRIGHT: Final = (ActorKind.PEDESTRIAN,)
_PARK_STEP_M: Final = 30.0
_FRICTION: Final = 0.5
# A person's body: 190 kg at walking pace sink in by 3 cm, and are hardly thrown back.
_SOFT_NPM: Final = 50_000.0
_SOFT_NSPM: Final = 5_000.0
_ZERO: Final[Vec3] = (0.0, 0.0, 0.0)
_LEVEL: Final = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyMove:
    """An actor's pose at the start of a tick, and the velocity that carries it to the next.

    PyBullet turns the velocity of a turning body along with it. With the tick's length in `dt_s`
    the first velocity makes the arc end where the straight way would have ended. Without it the end
    is up to 4 cm beside.
    """

    actor: ActorState
    v_W_mps: F64  # (3,) the whole way of the tick by its length
    yaw_rate_radps: float
    dt_s: float = 0.0


@dataclass(slots=True)
class _Body:
    """A pooled body; `middle_m` is the height of its middle above the actor's ground point."""

    body_id: int
    bucket: Bucket
    middle_m: float
    park_m: Vec3


class BodyPool:
    """All mirror bodies of one engine."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._used: dict[str, _Body] = {}
        self._free: dict[Bucket, list[_Body]] = {}
        self._made = 0
        self._placed = 0

    @property
    def placed(self) -> int:
        """How often the bodies were placed."""
        return self._placed

    @property
    def count(self) -> int:
        """Number of actors that have a body now."""
        return len(self._used)

    @property
    def made(self) -> int:
        """Number of bodies ever made, parked ones included."""
        return self._made

    def place(self, moves: Sequence[BodyMove]) -> None:
        """Give every listed actor a body with its pose and velocity, and park the other bodies.

        Raises:
            PhysicsError: An actor is listed twice, or its pose, velocity or size cannot be used.
        """
        # 1. By id: which pooled body an actor gets must not depend on the order of the moves.
        move_of = {move.actor.id: move for move in sorted(moves, key=lambda move: move.actor.id)}
        if len(move_of) != len(moves):
            raise PhysicsError(
                f"{len(moves)} moves for {len(move_of)} actors; expected one move for each actor"
            )
        buckets = {actor_id: _bucket(move) for actor_id, move in move_of.items()}

        # 2. Park before any is taken: a free body serves another actor in the same tick.
        unused = [key for key, body in self._used.items() if buckets.get(key) != body.bucket]
        for actor_id in unused:
            parked, bullet = self._used.pop(actor_id), self._engine.bullet
            bullet.resetBasePositionAndOrientation(parked.body_id, parked.park_m, _LEVEL)
            bullet.resetBaseVelocity(parked.body_id, _ZERO, _ZERO)
            self._free.setdefault(parked.bucket, []).append(parked)

        # 3. Move the bodies of the listed actors.
        for actor_id, move in move_of.items():
            body = self._used.get(actor_id)
            if body is None:
                bucket = buckets[actor_id]
                free = self._free.get(bucket)
                body = free.pop() if free else self._make(bucket)
                self._used[actor_id] = body
            self._move(body, move)
        self._placed += 1

    def names(self) -> KeysView[str]:
        """Ids of the actors that have a body now."""
        return self._used.keys()

    def pose(self, actor_id: str) -> tuple[float, float, float, float]:
        """Ground point x, y, z (m) and yaw (rad) of an actor's body as PyBullet has it.

        Raises:
            PhysicsError: The actor has no body.
        """
        body = self._body(actor_id)
        (x, y, z), q = self._engine.bullet.getBasePositionAndOrientation(body.body_id)
        qx, qy, qz, qw = q
        up_x, up_y = 2.0 * (qx * qz + qw * qy), 2.0 * (qy * qz - qw * qx)
        up_z = 1.0 - 2.0 * (qx * qx + qy * qy)
        h = body.middle_m
        yaw = math.atan2(2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qy * qy + qz * qz))
        return x - h * up_x, y - h * up_y, z - h * up_z, yaw

    def poses(self) -> dict[str, tuple[F64, float]]:
        """Ground point (3,) and yaw (rad) of every actor's body as PyBullet has them, by actor."""
        found = {}
        # By id: the order in which the bodies were taken must not show in a state.
        for actor_id in sorted(self._used):
            *ground, yaw = self.pose(actor_id)
            found[actor_id] = (np.array(ground), yaw)
        return found

    def body_of(self, actor_id: str) -> int:
        """PyBullet's id of an actor's body. Raises PhysicsError when it has none."""
        return self._body(actor_id).body_id

    def _body(self, actor_id: str) -> _Body:
        body = self._used.get(actor_id)
        if body is None:
            raise PhysicsError(
                f"actor {actor_id!r} has no body; expected one of the {self.count} placed last"
            )
        return body

    def _move(self, body: _Body, move: BodyMove) -> None:
        actor, bullet = move.actor, self._engine.bullet
        q = quaternion_from_ypr(actor.yaw_rad, actor.pitch_rad)
        ux, uy, uz = 0.0, 0.0, body.middle_m
        if actor.pitch_rad:
            ux, uy, uz = rotate_vector(matrix_from_quaternion(q), ux, uy, uz)
        x, y, z = actor.p_W_m.tolist()
        vx, vy, vz = move.v_W_mps.tolist()
        sx, sy = vx, vy
        if move.yaw_rate_radps and move.dt_s:
            turn_rad = move.yaw_rate_radps * move.dt_s
            # A middle that leans out over the ground point turns about it.
            if actor.pitch_rad:
                c, s = math.cos(turn_rad), math.sin(turn_rad)
                sx += (c * ux - s * uy - ux) / move.dt_s
                sy += (s * ux + c * uy - uy) / move.dt_s
            # The velocity at the start that leads to the same place as straight on. Before each
            # step PyBullet adds to the velocity what turns it, and makes it a little longer, as the
            # factor 1 + i step does. The way is a geometric series; without a turn it is 0 / 0.
            if abs(turn_rad) >= 1e-9:
                steps = round(move.dt_s / self._engine.step_s)
                step = 1j * turn_rad / steps
                series = (1.0 + step) ** (steps + 1) - (1.0 + step)
                start = complex(sx, sy) * step * steps / series
                sx, sy = start.real, start.imag
        bullet.resetBasePositionAndOrientation(body.body_id, (x + ux, y + uy, z + uz), q)
        bullet.resetBaseVelocity(body.body_id, (sx, sy, vz), (0.0, 0.0, move.yaw_rate_radps))
        tag = BodyTag(
            role=Role.ACTOR,
            kind=actor.kind.value,
            actor_id=actor.id,
            p_W_m=(x, y, z),
            v_W_mps=(vx, vy, vz),
            yaw_rate_radps=move.yaw_rate_radps,
        )
        self._engine.tag(body.body_id, tag)

    def _make(self, bucket: Bucket) -> _Body:
        kind, *steps = bucket
        length_m, width_m, height_m = (_BUCKET_M * number for number in steps)
        bullet = self._engine.bullet
        if kind in UPRIGHT:
            shape = bullet.createCollisionShape(
                pybullet.GEOM_CYLINDER, radius=0.5 * max(length_m, width_m), height=height_m
            )
            middle = 0.5 * height_m
        else:
            # Something flatter than the clearance still has a box of half its height.
            low = min(_CLEARANCE_M, 0.5 * height_m)
            half = (0.5 * length_m, 0.5 * width_m, 0.5 * (height_m - low))
            shape = bullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
            middle = 0.5 * (height_m + low)
        # Parked bodies must not overlap: each has its own place, away from parked chairs at y = 0.
        park = (_PARK_STEP_M * (self._made + 1), 500.0, PARK_Z_M)
        body = self._engine.add_body(shape, park, BodyTag(role=Role.ACTOR, kind=kind.value))
        bullet.changeDynamics(body, -1, lateralFriction=_FRICTION)
        if kind in UPRIGHT:
            bullet.changeDynamics(body, -1, contactStiffness=_SOFT_NPM, contactDamping=_SOFT_NSPM)
        self._made += 1
        return _Body(body_id=body, bucket=bucket, middle_m=middle, park_m=park)


def _bucket(move: BodyMove) -> Bucket:
    """Kind and size in steps of 5 cm, at least one each.

    Raises:
        PhysicsError: The move has numbers that cannot be used.
    """
    actor = move.actor
    x, y, z = actor.p_W_m.tolist()
    vx, vy, vz = move.v_W_mps.tolist()
    turn = actor.yaw_rad + actor.pitch_rad + move.yaw_rate_radps
    length, width, height = actor.size_lwh_m
    # The sum is finite only when each of them is.
    total = x + y + z + vx + vy + vz + turn + length + width + height
    if not math.isfinite(total) or min(length, width, height) <= 0.0:
        raise PhysicsError(
            f"actor {actor.id!r} has pose {actor.p_W_m}, yaw {actor.yaw_rad}, velocity "
            f"{move.v_W_mps}, size {actor.size_lwh_m}; expected finite numbers and a positive size"
        )
    long, wide, high = (max(1, round(side / _BUCKET_M)) for side in actor.size_lwh_m)
    return actor.kind, long, wide, high
