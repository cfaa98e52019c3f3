"""Actors and users for the tests of this package."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tests.support.samples import USUAL_OUTLINE
from wcsim.config import ChairConfig
from wcsim.core.seeding import generator
from wcsim.types import ActorKind, ActorState, Street
from wcsim.users.profiles import profile
from wcsim.users.user import SimulatedUser

SIZES = {
    ActorKind.PEDESTRIAN: (0.5, 0.5, 1.7),
    ActorKind.BICYCLE: (1.8, 0.65, 1.7),
    ActorKind.CAR: (4.5, 1.8, 1.5),
    ActorKind.WHEELCHAIR: (1.1, 0.62, 1.25),
}

USUAL_WHEELS_M = np.array([(0.0, 0.27), (0.0, -0.27), (0.44, 0.25), (0.44, -0.25)])


def actor(kind: ActorKind, x: float, y: float, yaw: float = 0.0, v: float = 0.0, name: str = "a") -> ActorState:
    return ActorState(
        id=name,
        kind=kind,
        p_W_m=np.array([x, y, 0.0]),
        yaw_rad=yaw,
        pitch_rad=0.0,
        v_W_mps=v * np.array([math.cos(yaw), math.sin(yaw), 0.0]),
        size_lwh_m=SIZES[kind],
    )


def make_user(name: str = "competent", seed: int = 0, street: Street | None = None, **changes: float) -> SimulatedUser:
    exact = replace(profile(name), **changes)
    return SimulatedUser(exact, generator(seed, "user"), ChairConfig(), USUAL_OUTLINE, street)
