"""What a chair touched, as points, and whether a depth picture shows them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wcsim.physics.engine import role_of_class
from wcsim.physics.renderer.base import Pinhole
from wcsim.types import F32, F64, ActorState, ClassId, ComparesArrays, Outline, PlantState, Street, StreetMesh

_AGREES_M, _AGREES_SHARE = 0.1, 0.05  # a depth agrees within so much and so much of it: noise, and a pixel's size
BODY_M = 0.2  # more for actors, whose body is smaller than its box
SPACING_M = 0.5
_HEIGHTS = (0.2, 0.5, 0.8)  # shares of an actor's
_BELOW_M = 0.3  # a kerb that a chair falls from or rams lies lower than its top
_REACHES_M = (0.15, 0.4)  # around the chair's box: it has moved on a little since it touched


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight(ComparesArrays):
    """One depth picture and where it was taken."""

    depth_m: F32  # (H, W)
    T_CW: F64  # (3, 4)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Touched(ComparesArrays):
    """The part of the street that a chair touched."""

    points_W_m: F64  # (n, 3)
    name: str  # ClassId of what is nearest to the chair's box, "" when nothing was found


def in_picture(points_W_m: F64, sight: Sight, camera: Pinhole, more_m: float = 0.0) -> bool:
    """Whether a point (n, 3) lies in the frustum and the depth there agrees, within `more_m` more than usual."""
    points_C_m = points_W_m @ sight.T_CW[:, :3].T + sight.T_CW[:, 3]
    z_m = points_C_m[:, 2]
    ahead = (z_m > camera.near_m) & (z_m < camera.range_m)
    points_C_m, z_m = points_C_m[ahead], z_m[ahead]
    size = np.array([camera.width_px, camera.height_px])
    pixels = np.floor(camera.focal_px * points_C_m[:, :2] / z_m[:, None] + 0.5 * size).astype(np.intp)
    inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
    pixels, z_m = pixels[inside], z_m[inside]
    gap_m = np.abs(sight.depth_m[pixels[:, 1], pixels[:, 0]] - z_m)
    return bool((gap_m <= _AGREES_M + _AGREES_SHARE * z_m + more_m).any())


def actor_points(actor: ActorState) -> F64:
    """Points (n, 3) all around an actor's box and along its middle, where a rider sits, at a few heights."""
    length_m, width_m, height_m = actor.size_lwh_m
    along = np.linspace(-0.5, 0.5, 1 + max(1, math.ceil(length_m / SPACING_M))) * length_m
    across = np.linspace(-0.5, 0.5, 1 + max(1, math.ceil(width_m / SPACING_M))) * width_m
    sides = [(x, side * width_m) for x in along for side in (-0.5, 0.0, 0.5)]
    ends = [(end * length_m, y) for y in across for end in (-0.5, 0.5)]
    cos, sin = math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)
    flat = np.array(sides + ends) @ np.array([[cos, sin], [-sin, cos]])
    layers = [np.column_stack([flat, np.full(len(flat), share * height_m)]) for share in _HEIGHTS]
    return np.asarray(np.concatenate(layers) + actor.p_W_m, np.float64)


def street_points(street: Street, kind: str, plant: PlantState, outline: Outline) -> Touched:
    """What of the street lies around a chair's box.

    Args:
        street: The town's.
        kind: As in `Contact.kind`: "ground", "kerb", "building" or "static".
        plant: The chair when it had touched it.
        outline: Its box.
    """
    for reach_m in _REACHES_M:
        found = [item for key in street.tiles.near(plant.p_WB_m[None, :2], 3.0) for item in
                 _faces_near(street.tiles.mesh(key), kind, plant, outline, reach_m)]  # fmt: skip
        if found:
            nearest = min(found, key=lambda item: item[0])
            return Touched(points_W_m=np.concatenate([points for _, points, _ in found]), name=nearest[2])
    return Touched(points_W_m=np.zeros((0, 3)), name="")


def _faces_near(
    mesh: StreetMesh, kind: str, plant: PlantState, outline: Outline, reach_m: float
) -> Iterator[tuple[float, F64, str]]:
    """The faces of a kind around a chair's box: distance from its middle, points in W of what lies there, class."""
    cos, sin = math.cos(plant.yaw_rad), math.sin(plant.yaw_rad)
    to_box = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    middle_W_m = plant.p_WB_m + outline.middle_x_m * to_box[:, 0]
    half_m = np.array([0.5 * outline.length_m + reach_m, 0.5 * outline.width_m + reach_m, 0.0])
    low_m, high_m = -half_m, half_m.copy()
    low_m[2], high_m[2] = -_BELOW_M, outline.height_m
    wanted = np.array([role_of_class(number).value == kind for number in range(256)])[mesh.face_class]
    corners = mesh.vertices_W_m[mesh.faces[wanted]].astype(np.float64)
    corners = (corners - middle_W_m) @ to_box
    near = ((corners.max(axis=1) >= low_m) & (corners.min(axis=1) <= high_m)).all(axis=1)
    for corner, number in zip(corners[near], mesh.face_class[wanted][near].tolist(), strict=True):
        part = clipped(corner, low_m, high_m)
        if len(part):
            points = np.concatenate([part, 0.5 * (part + np.roll(part, 1, axis=0)), part.mean(axis=0)[None]])
            distance_m = float(np.hypot(points[:, 0], points[:, 1]).min())
            yield distance_m, points @ to_box.T + middle_W_m, ClassId(number).name


def clipped(polygon: F64, low: F64, high: F64) -> F64:
    """The part of a flat convex polygon (n, 3) inside a box, as a polygon (m, 3), m = 0 when there is none."""
    for axis in range(3):
        for sign, bound in ((1.0, low[axis]), (-1.0, high[axis])):
            inside = sign * (polygon[:, axis] - bound)
            kept: list[F64] = []
            for i in range(len(polygon)):
                a, b = inside[i - 1], inside[i]
                if a * b < 0.0:
                    kept.append(polygon[i - 1] + a / (a - b) * (polygon[i] - polygon[i - 1]))
                if b >= 0.0:
                    kept.append(polygon[i])
            polygon = np.array(kept).reshape(-1, 3)
    return polygon
