"""How SUMO's actors become bodies, and the guard that checks it.

A body has the pose of tick n, and the velocity to n + 1. A mass-0 body with a velocity is
integrated through the substeps by the engine itself; without one, a car that hits a chair would
sink half a metre into it before that is noticed.

`MirrorCheck` compares PyBullet's bodies after every tick with where SUMO (and the deflection) put
the actors. It fails loudly: a body that froze, a ghost that stayed, an update that was skipped
would otherwise teach a network that the street is not what it sees.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from wcsim.bridge.reaction.wide_turns import MOST_M
from wcsim.core import frames
from wcsim.errors import PhysicsError
from wcsim.physics.kinematic_bodies import UPRIGHT, BodyMove, BodyPool
from wcsim.types import F64, ActorKind, ActorState, Ground
from wcsim.types.street import FLAT

_BRIDGE_M = 2.0  # who is this much above the land is on a bridge
# SUMO moved the actor so much further than its speed: by a teleport or into another lane.
JUMP_M = 0.5
# Who ends a tick so near a chair, from its rim on, has a body; others are only seen.
BODY_REACH_M = 10.0
_REACH_TICK_S = 0.1  # the longest tick for which that is enough
_SPARE_MPS = 5.0  # of a longer one: a chair drives too, and who brakes was faster than at its end
_SLIP_MPS = 0.02  # a smaller difference between SUMO's speed and the way somebody went is none
# SUMO turns some on the spot, from one lane's direction to the next; no long body sweeps so.
_SNAP_RAD = 0.5

_TOLERANCE_M = 0.01
_TOLERANCE_RAD = 0.02
# That a vehicle is shown beside SUMO's place: as far as it may swing out.
_FURTHEST_M = MOST_M + _TOLERANCE_M
# One body in four is measured each tick, in turn; the set of bodies is compared every tick.
EVERY = 4


def on_ground(actors: tuple[ActorState, ...], grid: Ground) -> tuple[ActorState, ...]:
    """The same actors, on the ground of wheels and cameras: a pavement is above SUMO's plane.

    They lean as the land below them does, nose up or down; people stand upright. Who is on a bridge
    has SUMO's height and slope.
    """
    if not actors:
        return ()
    relief = grid.around(actors[0].p_W_m).relief
    found = []
    # Without hills one height for each actor will do, and no arrays are made.
    if relief is FLAT:
        for actor in actors:
            x, y, z = actor.p_W_m.tolist()
            height_m = grid.height_here(x, y)
            # Nothing new is made for who stands at the right height, as on every road.
            if height_m != z:
                actor = replace(actor, p_W_m=np.array((x, y, height_m)))
            found.append(actor)
        return tuple(found)
    half_m = [0.5 * a.size_lwh_m[0] * frames.forward_vector(a.yaw_rad, 0.0) for a in actors]
    half_W_m = np.array(half_m)
    here_W_m = np.array([actor.p_W_m for actor in actors])
    rise_m = relief.at(here_W_m + half_W_m) - relief.at(here_W_m - half_W_m)
    pitch_rad = np.arctan2(rise_m, 2.0 * np.hypot(half_W_m[:, 0], half_W_m[:, 1]))
    on_bridge = here_W_m[:, 2] - relief.at(here_W_m) > _BRIDGE_M
    z_W_m = np.where(on_bridge, here_W_m[:, 2], grid.height_at(here_W_m))
    there_W_m = np.column_stack([here_W_m[:, :2], z_W_m])
    for actor, p_W_m, high, pitch in zip(actors, there_W_m, on_bridge, pitch_rad, strict=True):
        if not high and actor.kind is not ActorKind.PEDESTRIAN:
            actor = replace(actor, pitch_rad=float(pitch))
        found.append(replace(actor, p_W_m=p_W_m))
    return tuple(found)


def walked(
    before: Mapping[str, ActorState], after: tuple[ActorState, ...], dt_s: float
) -> tuple[ActorState, ...]:
    """The same actors; people have the velocity that led them here, where SUMO's is another.

    SUMO's is that along the way: it knows nothing of a step aside or back, not even of its own from
    stripe to stripe. Who jumped has SUMO's velocity, and so has who is near only now.
    """
    found = []
    for new in after:
        old = before.get(new.id)
        if old is not None and new.kind is ActorKind.PEDESTRIAN:
            v_W_mps = (new.p_W_m - old.p_W_m) / dt_s
            # Up and down are the ground's.
            v_W_mps[2] = new.v_W_mps[2]
            off_mps = math.hypot(*(v_W_mps - new.v_W_mps).tolist())
            if _SLIP_MPS < off_mps <= JUMP_M / dt_s:
                new = replace(new, v_W_mps=v_W_mps)
        found.append(new)
    return tuple(found)


def in_reach(
    actors: tuple[ActorState, ...], places_W_m: F64, dt_s: float
) -> tuple[ActorState, ...]:
    """Those that may come to touch a chair at one of the places (n, 2) within a tick of `dt_s`.

    They need a body. A car of 30 m/s and a chair of 3 m/s come nearer by 3.3 m in a tick of 0.1 s;
    what it drives in the rest of a longer one is added, so that it has a body also where it ends
    that tick far behind the chair.
    """
    places, more_s = places_W_m.tolist(), max(0.0, dt_s - _REACH_TICK_S)
    found = []
    for actor in actors:
        x, y, _ = actor.p_W_m.tolist()
        near_m = BODY_REACH_M + 0.5 * actor.size_lwh_m[0]
        if more_s:
            near_m += more_s * (math.hypot(*actor.v_W_mps.tolist()) + _SPARE_MPS)
        # A square, not a circle: it is cheaper, and a body too many does no harm. So is a list.
        if any([abs(x - px) < near_m and abs(y - py) < near_m for px, py in places]):
            found.append(actor)
    return tuple(found)


def moves(
    before: Mapping[str, ActorState], after: tuple[ActorState, ...], dt_s: float
) -> tuple[BodyMove, ...]:
    """What the bodies do during a tick that leads from `before` to `after`.

    An actor that is near only now starts where its present speed puts it a tick ago; one that
    jumped stands where it landed.
    """
    return tuple(_body_move(before.get(actor.id), actor, dt_s) for actor in after)


def _body_move(old: ActorState | None, new: ActorState, dt_s: float) -> BodyMove:
    start = old if old is not None else replace(new, p_W_m=new.p_W_m - dt_s * new.v_W_mps)
    v_W_mps = (new.p_W_m - start.p_W_m) / dt_s
    # The faster end of the tick: who brakes hard was faster than it is now.
    speed_mps = max(math.hypot(*start.v_W_mps.tolist()), math.hypot(*new.v_W_mps.tolist()))
    # It jumped: with a velocity its body would sweep what lies between.
    if math.hypot(*v_W_mps.tolist()) > speed_mps + JUMP_M / dt_s:
        return BodyMove(actor=new, v_W_mps=np.zeros(3), yaw_rate_radps=0.0)
    # A person's body is round; turning it would only bend the way that the velocity leads.
    turned_rad = 0.0
    if new.kind is not ActorKind.PEDESTRIAN:
        turned_rad = frames.wrap_angle(new.yaw_rad - start.yaw_rad)
    # Turned at once, as SUMO did it: with a turn rate its ends would sweep through a chair.
    if abs(turned_rad) > _SNAP_RAD:
        start, turned_rad = replace(start, yaw_rad=new.yaw_rad), 0.0
    # A body has one pitch through a tick.
    if new.pitch_rad != start.pitch_rad:
        start = replace(start, pitch_rad=new.pitch_rad)
    return BodyMove(actor=start, v_W_mps=v_W_mps, yaw_rate_radps=turned_rad / dt_s, dt_s=dt_s)


class MirrorCheck:
    """Checks one body pool, tick after tick."""

    def __init__(self, pool: BodyPool) -> None:
        self._pool = pool
        self._placed = pool.placed
        self._turn = 0

    def check(self, actors: Sequence[ActorState]) -> None:
        """Compare the bodies with the actors of now; call it once a tick, after the substeps.

        Raises:
            PhysicsError: The pool was not updated since the last check, holds others than the
                actors, or a body is further than 1 cm from its actor, or turned by more than 0.02
                rad against it.
        """
        if self._pool.placed == self._placed:
            raise PhysicsError(
                "the mirror was not updated in this tick; "
                "expected one update a tick: call pool.place()"
            )
        self._placed = self._pool.placed
        # In turn, so that every body is measured within four ticks at a quarter of the cost.
        self._turn = (self._turn + 1) % EVERY
        _check_mirror(self._pool, actors, self._turn, EVERY)


def _check_mirror(
    pool: BodyPool, actors: Sequence[ActorState], first: int = 0, every: int = 1
) -> None:
    """Compare all bodies with the actors, and the places of each `every`-th one from `first` on.

    Raises:
        PhysicsError: They differ, a place by more than 1 cm, a heading by more than 0.02 rad; or a
            vehicle is further from SUMO's own place than any swings out.
    """
    names, bodies = {actor.id for actor in actors}, pool.names()
    if bodies != names:
        raise PhysicsError(
            f"the mirror holds {len(bodies)} bodies for {len(names)} actors: without an actor "
            f"{sorted(bodies - names)}, without a body {sorted(names - bodies)}; "
            "expected one body for each actor"
        )
    for actor in actors[first::every]:
        upright = actor.kind in UPRIGHT
        if not upright and not abs(actor.deflect_m) <= _FURTHEST_M:
            raise PhysicsError(
                f"vehicle {actor.id!r} is mirrored {actor.deflect_m:.3f} m beside SUMO's place; "
                f"expected at most {_FURTHEST_M} m: its swing-out is wrong"
            )
        x, y, z, yaw_rad = pool.pose(actor.id)
        px, py, pz = actor.p_W_m.tolist()
        error_m = math.hypot(x - px, y - py, z - pz)
        off_rad = yaw_rad - actor.yaw_rad
        askew = not upright and abs(frames.wrap_angle(off_rad)) > _TOLERANCE_RAD
        # Written so that a distance that is not a number fails, too.
        if askew or not error_m <= _TOLERANCE_M:
            raise PhysicsError(
                f"actor {actor.id!r} is at {actor.p_W_m.round(3)}, yaw {actor.yaw_rad:.3f}, "
                f"its body {error_m:.3f} m away at ({x:.3f}, {y:.3f}, {z:.3f}), yaw {yaw_rad:.3f}; "
                f"expected at most {_TOLERANCE_M} m and {_TOLERANCE_RAD} rad: "
                "the mirror missed an update"
            )
