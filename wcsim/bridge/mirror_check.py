"""The guard of the mirror: after every tick PyBullet's bodies are where SUMO (and the deflection) put the actors.

It fails loudly: a body that froze, a ghost that stayed, an update that was skipped would otherwise teach a network
that the street is not what it sees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from wcsim.bridge.reaction.wide_turns import MOST_M
from wcsim.core import frames
from wcsim.errors import PhysicsError
from wcsim.physics.kinematic_bodies import UPRIGHT, BodyPool
from wcsim.types import ActorState

_TOLERANCE_M = 0.01
_TOLERANCE_RAD = 0.02
FURTHEST_M = MOST_M + _TOLERANCE_M  # that a vehicle is shown beside SUMO's place: as far as it may swing out
EVERY = 4  # one body in four is measured each tick, in turn; the set of bodies is compared every tick


class MirrorCheck:
    """Checks one body pool, tick after tick."""

    def __init__(self, pool: BodyPool) -> None:
        self._pool = pool
        self._placed = pool.placed
        self._turn = 0

    def check(self, actors: Sequence[ActorState]) -> None:
        """Compare the bodies with the actors of now; call it once a tick, after the substeps.

        Raises:
            PhysicsError: The pool was not updated since the last check, holds others than the actors, or a body is
                further than 1 cm from its actor, or turned by more than 0.02 rad against it.
        """
        if self._pool.placed == self._placed:
            raise PhysicsError("the mirror was not updated in this tick; expected one update a tick: call pool.place()")
        self._placed = self._pool.placed
        self._turn = (self._turn + 1) % EVERY
        check_mirror(self._pool, actors, self._turn, EVERY)


def check_mirror(pool: BodyPool, actors: Sequence[ActorState], first: int = 0, every: int = 1) -> None:
    """Compare the set of bodies with the actors, and the places of every `every`-th one from `first` on.

    Raises:
        PhysicsError: They differ, a place by more than 1 cm, a heading by more than 0.02 rad; or a vehicle is further
            from SUMO's own place than any swings out.
    """
    names, bodies = {actor.id for actor in actors}, pool.names()
    if bodies != names:
        raise PhysicsError(
            f"the mirror holds {len(bodies)} bodies for {len(names)} actors: without an actor "
            f"{sorted(bodies - names)}, without a body {sorted(names - bodies)}; expected one body for each actor"
        )
    for actor in actors[first::every]:
        if actor.kind not in UPRIGHT and not abs(actor.deflect_m) <= FURTHEST_M:
            raise PhysicsError(
                f"vehicle {actor.id!r} is mirrored {actor.deflect_m:.3f} m beside SUMO's place; expected at most "
                f"{FURTHEST_M} m: its swing-out is wrong"
            )
        x, y, z, yaw_rad = pool.pose(actor.id)
        px, py, pz = actor.p_W_m.tolist()
        error_m = math.hypot(x - px, y - py, z - pz)
        askew = actor.kind not in UPRIGHT and abs(frames.wrap(yaw_rad - actor.yaw_rad)) > _TOLERANCE_RAD
        if askew or not error_m <= _TOLERANCE_M:
            raise PhysicsError(
                f"actor {actor.id!r} is at {actor.p_W_m.round(3)}, yaw {actor.yaw_rad:.3f}, its body {error_m:.3f} m "
                f"away at ({x:.3f}, {y:.3f}, {z:.3f}), yaw {yaw_rad:.3f}; expected at most {_TOLERANCE_M} m and "
                f"{_TOLERANCE_RAD} rad: the mirror missed an update"
            )
