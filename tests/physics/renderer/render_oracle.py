"""Random actors for the sample street, and a camera to look at them."""

import math

import numpy as np

from wcsim.physics.renderer.base import Pinhole
from wcsim.types import ActorKind, ActorState

CAMERA = Pinhole(width_px=320, height_px=240, focal_px=168.6, near_m=0.1, range_m=40.0)

SIZES = {
    ActorKind.CAR: (4.6, 1.8, 1.5),
    ActorKind.TRUCK: (7.1, 2.4, 2.4),
    ActorKind.BUS: (12.0, 2.5, 3.4),
    ActorKind.TRAM: (22.0, 2.4, 3.2),
    ActorKind.MOTORCYCLE: (2.2, 0.9, 1.5),
    ActorKind.BICYCLE: (1.6, 0.65, 1.7),
    ActorKind.SCOOTER: (1.2, 0.5, 1.7),
    ActorKind.PEDESTRIAN: (0.215, 0.478, 1.719),
    ActorKind.WHEELCHAIR: (1.1, 0.62, 1.25),
    ActorKind.OTHER: (1.0, 0.7, 1.2),
}


def actor(kind, x, y, z=0.0, yaw=0.0, pitch=0.0, speed=1.3, size=None, number=0):
    return ActorState(
        id=f"{kind.value}{number}",
        kind=kind,
        p_W_m=np.array([x, y, z]),
        yaw_rad=yaw,
        pitch_rad=pitch,
        v_W_mps=speed * np.array([math.cos(yaw), math.sin(yaw), 0.0]),
        size_lwh_m=size or SIZES[kind],
    )


def crowd(seed, count=60):
    """Random actors of every kind on the sample street, turned and tilted at random."""
    rng = np.random.default_rng(seed)
    kinds = list(ActorKind)
    out = []
    for i in range(count):
        kind = kinds[i % len(kinds)] if i < 2 * len(kinds) else ActorKind.PEDESTRIAN
        x, y = rng.uniform(-5, 70), rng.uniform(-7, 7)
        yaw, pitch = rng.uniform(-math.pi, math.pi), rng.uniform(-0.1, 0.1)
        out.append(actor(kind, x, y, 0.12, yaw, pitch, number=i))
    return tuple(out)
