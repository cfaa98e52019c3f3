"""Actors and users for the tests of this package."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tests.support import actors
from tests.support.samples import USUAL_OUTLINE
from wcsim.config import ChairConfig
from wcsim.core.seeding import make_rng
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.types import ActorKind, ActorState, Route, SignalState, Street, UserView
from wcsim.users.profiles import find_builtin_profile
from wcsim.users.user import SimulatedUser

USUAL_RIMS_M = np.array(plant_spec(ChairConfig()).rims_m())
USUAL_WHEELS_M = np.column_stack([plant_spec(ChairConfig()).stand_m(), plant_spec(ChairConfig()).trails_m()])


def actor(kind: ActorKind, x: float, y: float, yaw: float = 0.0, v: float = 0.0, name: str = "a") -> ActorState:
    return actors.actor(kind, x, y, yaw, v, name)


walker = partial(actor, ActorKind.PEDESTRIAN)
car = partial(actor, ActorKind.CAR)


def make_user(name: str = "competent", seed: int = 0, street: Street | None = None, **changes: float) -> SimulatedUser:
    exact = replace(find_builtin_profile(name), **changes)
    return SimulatedUser(exact, make_rng(seed, "user"), ChairConfig(), USUAL_OUTLINE, street)


def user_view(
    route: Route,
    time_s: float = 0.0,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    speed_mps: float = 1.0,
    actors: Sequence[ActorState] = (),
    signals: Sequence[SignalState] = (),
    obstacles: Sequence[tuple[float, float, float]] | np.ndarray = (),
) -> UserView:
    """A view from a pose (x, y, yaw); obstacles are (x, y, radius), numbered in their order."""
    x, y, yaw = pose
    return UserView(
        time_s=time_s,
        p_W_m=np.array([x, y, 0.0]),
        yaw_rad=yaw,
        speed_mps=speed_mps,
        route=route,
        actors=tuple(actors),
        signals=tuple(signals),
        obstacles_W_m=np.c_[np.array(obstacles, float).reshape(-1, 3), np.arange(len(obstacles))],
    )
