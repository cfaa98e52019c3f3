"""Whether a wheel is about to meet the edge of a kerb, or somebody the chair; or nothing at all.

If one does, the physics takes finer steps. At 1.67 m/s a wheel is over a kerb of 20 mm within two
steps of 1/120 s, and what the chair feels comes out a third too small; a car of 8 m/s sinks 7 cm
into a chair instead of 5. Everywhere else on a street such steps do as well as finer ones
(docs/chair.md).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from wcsim.core.boxes import Box, box_from_actor, boxes_touch
from wcsim.core.jit import compile_exact_kernel
from wcsim.physics.wheelchair.rolling import Plane
from wcsim.types import U8, ActorState, Ground, PlantState
from wcsim.types.street import FLAT

SLOWER_MPS: Final = 0.5  # a wheel so slow climbs for many steps
# The raster has whole centimetres, and a ramp of 8 % rises one at most from cell to cell.
_RISE_CM: Final = 2
# The wheel is on the edge for so long; a caster that turns round stands elsewhere, too.
_BEHIND_M: Final = 0.15
_SPARE: Final = 1.25  # of the way of a tick
_STEP_M: Final = 0.08  # less than the raster's cells
_SLACK_M: Final = 0.1  # a body turns while it moves
_BENT_M: Final = 0.001  # by which a plane may miss the land


def meets_edge(
    plant: PlantState, wheels_m: Sequence[tuple[float, float, float]], ground: Ground, dt_s: float
) -> bool:
    """Whether a wheel (x, y, radius), as it moves, may touch a rise of the ground in a tick.

    Args:
        plant: The chair now.
        wheels_m: From `PlantSpec.wheels_m`.
        ground: The street from above.
        dt_s: A tick.
    """
    ahead_mps, left_mps, _ = plant.v_B_mps.tolist()
    turn_radps = float(plant.w_B_radps[2])
    raster = None
    cos, sin = math.cos(plant.yaw_rad), math.sin(plant.yaw_rad)
    x_W_m, y_W_m, _ = plant.p_WB_m.tolist()
    for x_m, y_m, radius_m in wheels_m:
        vx, vy = ahead_mps - turn_radps * y_m, left_mps + turn_radps * x_m
        speed_mps = math.hypot(vx, vy)
        if speed_mps < SLOWER_MPS:
            continue
        # Fetched only for a wheel that is fast enough: a chair that stands needs none.
        raster = raster or ground.around(plant.p_WB_m)
        west_m, south_m = raster.origin_W_m
        hub_x = x_W_m + cos * x_m - sin * y_m - west_m
        hub_y = y_W_m + sin * x_m + cos * y_m - south_m
        to_x, to_y = (cos * vx - sin * vy) / speed_mps, (sin * vx + cos * vy) / speed_mps
        reach_m = radius_m + _SPARE * speed_mps * dt_s + _BEHIND_M
        if _rises(raster.height_cm, raster.cell_m, hub_x, hub_y, to_x, to_y, reach_m):
            return True
    return False


def find_plane(plant: PlantState, reach: Box, ground: Ground) -> Plane | None:
    """The plane that all ground in reach of a chair is, with nothing solid on it, if there is one.

    Args:
        plant: The chair now.
        reach: The box around the ground that it may come to.
        ground: The street from above.
    """
    raster = ground.around(plant.p_WB_m)
    west_m, south_m = raster.origin_W_m
    x_m, y_m, cos, sin, long_m, wide_m = reach
    level_cm = _level(
        raster.height_cm,
        raster.clearance_dm,
        raster.cell_m,
        (x_m - west_m, y_m - south_m, cos, sin, long_m, wide_m),
    )
    if level_cm < 0:
        return None
    relief, level_m = raster.relief, 0.01 * level_cm
    if relief is FLAT:
        return Plane(level_m, 0.0, 0.0)
    # The land is triangles; the corners and the middle of the box lie on one, or on two in a line.
    signs = ((0, 0), (1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (-1, 0))
    at_m = np.array(
        [
            (a * long_m * cos - b * wide_m * sin, a * long_m * sin + b * wide_m * cos)
            for a, b in signs
        ]
    )
    land_m = relief.at(at_m + np.array([x_m, y_m]))
    (rise_x, rise_y), *_ = np.linalg.lstsq(at_m[1:], land_m[1:] - land_m[0], rcond=None)
    if np.abs(land_m - land_m[0] - at_m @ (rise_x, rise_y)).max() > _BENT_M:
        return None
    here_m = land_m[0] + rise_x * (plant.p_WB_m[0] - x_m) + rise_y * (plant.p_WB_m[1] - y_m)
    return Plane(level_m + float(here_m), float(rise_x), float(rise_y))


def meets_body(
    chairs: Sequence[ActorState],
    before: Mapping[str, ActorState],
    actors: Iterable[ActorState],
    dt_s: float,
) -> bool:
    """Whether somebody may touch one of the chairs on the way of this tick.

    Args:
        chairs: Them, as others see them.
        before: Everybody at the beginning of the tick, by id; who is missing has come at its speed.
        actors: Everybody at its end.
        dt_s: The tick.
    """
    boxes = [
        box_from_actor(chair, _SLACK_M + _SPARE * dt_s * math.hypot(*chair.v_W_mps[:2].tolist()))
        for chair in chairs
    ]
    for actor in actors:
        x_m, y_m, _ = actor.p_W_m.tolist()
        length_m, width_m, _ = actor.size_lwh_m
        old = before.get(actor.id)
        was_W_m = actor.p_W_m - dt_s * actor.v_W_mps if old is None else old.p_W_m
        was_x, was_y, _ = was_W_m.tolist()
        way_m = math.hypot(x_m - was_x, y_m - was_y)
        # A rough square first: few of the actors are anywhere near.
        near_m = 0.5 * length_m + width_m + way_m + 1.5
        for box in boxes:
            if abs(x_m - box[0]) < near_m and abs(y_m - box[1]) < near_m:
                cos, sin = math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)
                aside_m = abs((y_m - was_y) * cos - (x_m - was_x) * sin)
                # The box around all that the body sweeps in the tick. It is too large rather than
                # too small: fine steps are always right.
                half_m = 0.5 * (length_m + way_m), 0.5 * (width_m + aside_m)
                middle = 0.5 * (x_m + was_x), 0.5 * (y_m + was_y)
                if boxes_touch(*middle, cos, sin, *half_m, *box):
                    return True
    return False


@compile_exact_kernel
def _level(height_cm: U8, clearance_dm: U8, cell_m: float, reach: Box) -> int:
    """The height in cm of all cells in a box of the raster; -1 if it is not one, or not free."""
    x_m, y_m, cos, sin, long_m, wide_m = reach
    rows, cols = height_cm.shape
    level_cm = -1
    for i in range(int(2.0 * long_m / _STEP_M) + 2):
        for k in range(int(2.0 * wide_m / _STEP_M) + 2):
            along_m, aside_m = (
                min(i * _STEP_M, 2.0 * long_m) - long_m,
                min(k * _STEP_M, 2.0 * wide_m) - wide_m,
            )
            col = math.floor((x_m + cos * along_m - sin * aside_m) / cell_m)
            row = math.floor((y_m + sin * along_m + cos * aside_m) / cell_m)
            if not (0 <= row < rows and 0 <= col < cols) or clearance_dm[row, col] == 0:
                return -1
            here_cm = int(height_cm[row, col])
            if level_cm >= 0 and here_cm != level_cm:
                return -1
            level_cm = here_cm
    return level_cm


@compile_exact_kernel
def _rises(
    height_cm: U8, cell_m: float, x_m: float, y_m: float, to_x: float, to_y: float, reach_m: float
) -> bool:
    """Whether the ground rises by a kerb's edge from a little behind a place to `reach_m` ahead."""
    rows, cols = height_cm.shape
    last_cm = -1
    for step in range(int((reach_m + _BEHIND_M) / _STEP_M) + 1):
        along_m = step * _STEP_M - _BEHIND_M
        col = int((x_m + along_m * to_x) / cell_m)
        row = int((y_m + along_m * to_y) / cell_m)
        if not (0 <= row < rows and 0 <= col < cols):
            return False
        here_cm = int(height_cm[row, col])
        if last_cm >= 0 and here_cm - last_cm >= _RISE_CM:
            return True
        last_cm = here_cm
    return False
