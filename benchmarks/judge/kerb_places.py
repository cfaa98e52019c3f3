"""Where a chair is put although it does not belong there: before a kerb, from below and from above, and anywhere."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.agents.perception.ego_motion import body_to_odometric
from wcsim.core.frames import deg2rad
from wcsim.types import F64, ClassId, Joystick, StartSpec, Street
from wcsim.types.street import join_meshes

HALF_CHAIR_M: Final = 1.0  # kept clear of walls, however the chair stands
UPRIGHT: Final = 0.2  # vertical part of a kerb face's normal, at most
REACH_M: Final = 150.0  # so far around the first place kerbs are looked for
BELOW_M: Final = 4.5  # from the kerb to the drive axle: on the road, ahead
BEHIND_M: Final = 2.0  # and backwards
ABOVE_M: Final = 2.2  # on the pavement
_STEP_M: Final = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class KerbCase:
    """How a chair is set before a kerb and which way its stick is held."""

    below: bool = True  # on the road, else on the pavement
    backwards: bool = False
    angle_deg: float = 0.0  # between its way and the kerb's normal

    @property
    def stick(self) -> Joystick:
        """Held all the way."""
        return Joystick(0.0, -1.0 if self.backwards else 1.0)

    @property
    def far_m(self) -> float:
        """From the kerb to its axle, along its way."""
        if self.backwards:
            return BEHIND_M
        return BELOW_M if self.below else ABOVE_M


def kerb_starts(street: Street, case: KerbCase, near_W_m: F64, rng: np.random.Generator) -> Iterator[StartSpec]:
    """Starts before kerbs around a place (2,), in an order that is drawn; straight kerbs with free ground before them.

    On the road all is carriageway as far as a metre behind the chair; on the pavement nothing solid is near.
    """
    tiles = street.tiles
    mesh = join_meshes([tiles.mesh(key) for key in tiles.near(np.array([[*near_W_m, 0.0]]), REACH_M)])
    corners_W_m = mesh.vertices_W_m[mesh.faces[mesh.face_class == ClassId.KERB]].astype(np.float64)
    normals = np.cross(corners_W_m[:, 1] - corners_W_m[:, 0], corners_W_m[:, 2] - corners_W_m[:, 0])
    upright = np.abs(normals[:, 2]) < UPRIGHT * np.linalg.norm(normals, axis=1)
    feet, out = corners_W_m[upright].mean(axis=1)[:, :2], normals[upright][:, :2]
    out /= np.linalg.norm(out, axis=1)[:, None]
    for number in rng.permutation(len(feet)):
        away = out[number] if case.below else -out[number]  # from the kerb to the chair
        turn = deg2rad(case.angle_deg) * (1.0 if rng.random() < 0.5 else -1.0)
        way = -body_to_odometric(away[None], np.array([0.0, 0.0, turn]))[0]
        place = feet[number] - case.far_m * way
        if math.dist(feet[number], near_W_m) < REACH_M and _is_free(street, feet[number], away, way, case):
            heading = -way if case.backwards else way
            yield facing(place, math.atan2(heading[1], heading[0]), near_W_m)


def _is_free(street: Street, foot_W_m: F64, away: F64, way: F64, case: KerbCase) -> bool:
    grid = street.grid
    here = foot_W_m - np.arange(_STEP_M, case.far_m + 1.5, _STEP_M)[:, None] * way
    over = foot_W_m - np.array([0.3, 0.6, 1.0])[:, None] * away
    along = np.array([-away[1], away[0]])
    # Straight for half a metre each way, else the angle is none.
    sides = foot_W_m + np.array([-0.5, 0.5])[:, None] * along
    low, high = (here, over) if case.below else (over, here)
    kinds = set(grid.class_at(low).tolist())
    step_m = grid.raised_at(high).min() - grid.raised_at(low).max()
    straight = grid.raised_at(sides - 0.25 * away).std() + grid.raised_at(sides + 0.25 * away).std() < 0.01
    clear = (grid.clearance_at(here) > HALF_CHAIR_M).all() and (grid.clearance_at(over) > 0.8).all()
    return bool(kinds == {int(ClassId.ROAD)} and step_m > 0.05 and straight and clear)


def anywhere(street: Street, rng: np.random.Generator, near_W_m: F64) -> Iterator[StartSpec]:
    """Starts on any ground around a place (2,), facing anywhere, with nothing solid within reach of the hull."""
    while True:
        place = near_W_m + rng.uniform(-REACH_M, REACH_M, 2)
        solid = street.grid.clearance_at(place) < HALF_CHAIR_M
        if not solid and street.grid.class_at(place) != ClassId.VOID:
            yield facing(place, float(rng.uniform(-math.pi, math.pi)), near_W_m)


def facing(place_W_m: F64, yaw_rad: float, goal_W_m: F64) -> StartSpec:
    """A start at a place (2,), for a goal (2,)."""
    (x, y), (to_x, to_y) = place_W_m.tolist(), goal_W_m[:2].tolist()
    return StartSpec(p_W_m=(x, y), yaw_rad=yaw_rad, goal_W_m=(to_x, to_y))
