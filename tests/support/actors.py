"""Vehicles and people for tests, made by hand."""

import math

import numpy as np

from wcsim.types import ActorKind, ActorState

CAR_LWH_M = (4.5, 1.8, 1.5)
_SIZES_LWH_M = {
    ActorKind.PEDESTRIAN: (0.5, 0.5, 1.7),
    ActorKind.BICYCLE: (1.8, 0.65, 1.7),
    ActorKind.WHEELCHAIR: (1.1, 0.62, 1.25),
}


def actor(
    kind: ActorKind = ActorKind.CAR,
    x: float = 0.0,
    y: float = 0.0,
    yaw: float = 0.0,
    speed: float = 0.0,
    name: str = "v:car",
    size: tuple[float, float, float] | None = None,
    piece: int = 0,
) -> ActorState:
    """An actor on level ground that moves along its heading, in metres, radians and m/s; as large as its kind is."""
    return ActorState(
        id=name,
        kind=kind,
        p_W_m=np.array([x, y, 0.0]),
        yaw_rad=yaw,
        pitch_rad=0.0,
        v_W_mps=speed * np.array([math.cos(yaw), math.sin(yaw), 0.0]),
        size_lwh_m=size or _SIZES_LWH_M.get(kind, CAR_LWH_M),
        piece=piece,
    )
