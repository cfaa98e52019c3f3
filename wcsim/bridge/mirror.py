"""How SUMO's actors become bodies: the pose of tick n, and the velocity that carries them to n + 1.

A mass-0 body with a velocity is integrated through the substeps by the engine itself; without one, a car that hits a
chair sinks half a metre into it before it is noticed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from wcsim import frames
from wcsim.physics.bodies import BodyMove
from wcsim.types import ActorKind, ActorState, StreetGrid

JUMP_MPS = 60.0  # faster than anything in a street: SUMO has teleported the actor, so its body does not sweep


def on_ground(actors: tuple[ActorState, ...], grid: StreetGrid) -> tuple[ActorState, ...]:
    """The same actors, standing on the ground that the wheels and cameras know (a pavement lies above SUMO's plane)."""
    if not actors:
        return ()
    z_W_m = grid.height_at(np.array([actor.p_W_m for actor in actors]))
    return tuple(
        replace(actor, p_W_m=np.array([actor.p_W_m[0], actor.p_W_m[1], z]))
        for actor, z in zip(actors, z_W_m, strict=True)
    )


def moves(before: Mapping[str, ActorState], after: tuple[ActorState, ...], dt_s: float) -> tuple[BodyMove, ...]:
    """What the bodies do during a tick that leads from `before` to `after`.

    An actor that has just come near starts where its present speed says it came from; one that jumped stands where it
    landed.
    """
    return tuple(_move(before.get(actor.id), actor, dt_s) for actor in after)


def _move(old: ActorState | None, new: ActorState, dt_s: float) -> BodyMove:
    start = old if old is not None else replace(new, p_W_m=new.p_W_m - dt_s * new.v_W_mps)
    v_W_mps = (new.p_W_m - start.p_W_m) / dt_s
    if float(v_W_mps @ v_W_mps) > JUMP_MPS**2:
        return BodyMove(actor=new, v_W_mps=np.zeros(3), yaw_rate_radps=0.0)
    # A person's body is round; turning it would only bend the way that the velocity leads.
    turned_rad = 0.0 if new.kind is ActorKind.PEDESTRIAN else frames.wrap(new.yaw_rad - start.yaw_rad)
    return BodyMove(actor=start, v_W_mps=v_W_mps, yaw_rate_radps=turned_rad / dt_s)
