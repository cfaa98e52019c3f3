"""What is near a chair as rows of numbers, from the world's truth: the observation `state`.

No real chair has it. The blocks of rows are in `supervisor/observation.py`, their meaning in
docs/faces.md. All is in the frame B.
"""

import math
from collections.abc import Sequence

import numpy as np

from wcsim.bridge.reaction.commands import ROADWAY
from wcsim.core.boxes import box_from_actor, gap_to_box
from wcsim.core.constants import KERB_STEP_CM, OTHER_LEVEL_M
from wcsim.core.jit import compile_exact_kernel
from wcsim.supervisor.observation import (
    MOST_OTHERS,
    OTHERS_REACH_M,
    OTHERS_ROW,
    SECTORS,
    SOLID_REACH_M,
    SOLID_ROW,
    STATE_SHAPE,
    WAY_AHEAD_M,
    WAY_ROW,
)
from wcsim.types import F64, U8, ActorKind, ActorState, Ground, Joystick, PlantState, Route

OWN, WAY, WAY_ON_ROAD, SOLID, STEP_UP, STEP_DOWN = range(1, 7)
_FIRST_KIND = 7  # of road users: those of `ActorKind`, in its order
_KINDS = {kind: _FIRST_KIND + place for place, kind in enumerate(ActorKind)}
_ROAD_CLASSES = tuple(int(one) for one in ROADWAY)

_Pose = tuple[float, float, float, float]  # x, y, cosine and sine of the heading, in W


def near_rows(
    plant: PlantState,
    stick: Joystick,
    route: Route,
    progress_m: float,
    ground: Ground,
    others: Sequence[ActorState],
) -> F64:
    """The rows (STATE_SHAPE) in metres, metres a second and radians; zeros where there is nothing.

    Args:
        plant: The chair.
        stick: Of its user.
        route: To the destination.
        progress_m: How far along it the chair is.
        ground: The street from above.
        others: Who moves around it, this chair not among them.
    """
    rows = np.zeros(STATE_SHAPE)
    x, y, _ = plant.p_WB_m.tolist()
    pose = x, y, math.cos(plant.yaw_rad), math.sin(plant.yaw_rad)
    to_go_m = float(route.arc_m[-1]) - progress_m
    velocity = *plant.v_B_mps[:2], plant.w_B_radps[2]
    rows[0] = [OWN, stick.x, stick.y, *velocity, plant.roll_rad, plant.pitch_rad, to_go_m]
    grid = ground.around(plant.p_WB_m)
    origin_m = np.array(grid.origin_W_m, np.float64)
    way, solid = rows[WAY_ROW:SOLID_ROW], rows[SOLID_ROW:OTHERS_ROW]
    _way(way, pose, progress_m, route.arc_m, route.points_W_m)
    _find_road(way, pose, grid.ground_class, origin_m, grid.cell_m)
    _standing(solid, pose, grid.height_cm, grid.clearance_dm, origin_m, grid.cell_m)
    seen = _road_users(plant, pose, others)
    rows[OTHERS_ROW : OTHERS_ROW + len(seen)] = np.array(seen).reshape(-1, STATE_SHAPE[1])
    return rows


@compile_exact_kernel
def _way(rows: F64, pose: _Pose, progress_m: float, arc_m: F64, points_W_m: F64) -> None:
    """Points of the route ahead with their headings; past its end the destination repeats."""
    x, y, cos, sin = pose
    piece = 0
    for k in range(len(rows)):
        at_m = min(progress_m + WAY_AHEAD_M[k], arc_m[-1])
        while piece < len(arc_m) - 2 and arc_m[piece + 1] < at_m:
            piece += 1
        last = min(piece + 1, len(arc_m) - 1)
        along_x, along_y = points_W_m[last] - points_W_m[piece]
        long = max(math.hypot(along_x, along_y), 1e-9)
        share = (at_m - arc_m[piece]) / max(arc_m[last] - arc_m[piece], 1e-9)
        dx = points_W_m[piece, 0] + share * along_x - x
        dy = points_W_m[piece, 1] + share * along_y - y
        rows[k, 0] = WAY
        rows[k, 1], rows[k, 2] = dx * cos + dy * sin, dy * cos - dx * sin
        rows[k, 5] = (along_x * cos + along_y * sin) / long
        rows[k, 6] = (along_y * cos - along_x * sin) / long


@compile_exact_kernel
def _find_road(rows: F64, pose: _Pose, ground_class: U8, origin_m: F64, cell_m: float) -> None:
    """Mark the points of the way that are on a carriageway."""
    x, y, cos, sin = pose
    high, wide = ground_class.shape
    for k in range(len(rows)):
        ahead, left = rows[k, 1], rows[k, 2]
        col = math.floor((x + ahead * cos - left * sin - origin_m[0]) / cell_m)
        row = math.floor((y + ahead * sin + left * cos - origin_m[1]) / cell_m)
        here = ground_class[min(max(row, 0), high - 1), min(max(col, 0), wide - 1)]
        for kind in _ROAD_CLASSES:
            if here == kind:
                rows[k, 0] = WAY_ON_ROAD


def _road_users(
    plant: PlantState, pose: _Pose, others: Sequence[ActorState]
) -> list[tuple[float, ...]]:
    """The nearest on the chair's level, by the gap to their boxes, ties in the given order."""
    x, y, cos, sin = pose
    z = float(plant.p_WB_m[2])
    seen = []
    for actor in others:
        ax, ay, az = actor.p_W_m.tolist()
        # A cheap look first: most are far, and a box costs more.
        if max(abs(ax - x), abs(ay - y)) > 2 * OTHERS_REACH_M or abs(az - z) > OTHER_LEVEL_M:
            continue
        box = box_from_actor(actor)
        gap_m = gap_to_box(x, y, *box)
        if gap_m > OTHERS_REACH_M:
            continue
        dx, dy, (vx, vy, _) = ax - x, ay - y, actor.v_W_mps.tolist()
        length_m, width_m, _ = actor.size_lwh_m
        row = (
            *(float(_KINDS[actor.kind]), dx * cos + dy * sin, dy * cos - dx * sin),
            *(vx * cos + vy * sin, vy * cos - vx * sin),
            *(box[2] * cos + box[3] * sin, box[3] * cos - box[2] * sin, length_m, width_m),
        )
        seen.append((gap_m, row))
    return [row for _, row in sorted(seen, key=lambda item: item[0])[:MOST_OTHERS]]


@compile_exact_kernel
def _standing(
    rows: F64, pose: _Pose, height_cm: U8, clearance_dm: U8, origin_m: F64, cell_m: float
) -> None:
    """The nearest solid cell and nearest kerb edge in each sector, each kind from near to far."""
    x, y, cos, sin = pose
    # Squared distance, kind, x and y in B.
    found = np.full((2, SECTORS, 4), SOLID_REACH_M * SOLID_REACH_M)
    high, wide = height_cm.shape
    r0, r1 = _span(y - origin_m[1], cell_m, high)
    c0, c1 = _span(x - origin_m[0], cell_m, wide)
    for r in range(r0, r1):
        for c in range(c0, c1):
            dx, dy = origin_m[0] + (c + 0.5) * cell_m - x, origin_m[1] + (r + 0.5) * cell_m - y
            if clearance_dm[r, c] == 0:
                _put_nearer(found[0], SOLID, dx, dy, cos, sin)
            here = np.int64(height_cm[r, c])
            # The next cell to the right, and the one above: an edge lies between two.
            for k in range(2):
                if r + k >= high or c + 1 - k >= wide:
                    continue
                there = np.int64(height_cm[r + k, c + 1 - k])
                if abs(there - here) > KERB_STEP_CM:
                    ex, ey = dx + 0.5 * cell_m * (1 - k), dy + 0.5 * cell_m * k
                    # Up or down as the chair would meet it: the cell on its side comes first.
                    beyond = ey > 0.0 if k else ex > 0.0
                    kind = STEP_UP if (there > here) == beyond else STEP_DOWN
                    _put_nearer(found[1], kind, ex, ey, cos, sin)
    for block in range(2):
        # Stable: things as far away stay in the order of the sectors.
        order = np.argsort(found[block, :, 0], kind="mergesort")
        for k in range(SECTORS):
            one = found[block, order[k]]
            if one[0] < SOLID_REACH_M * SOLID_REACH_M:
                rows[block * SECTORS + k, :3] = one[1:]


@compile_exact_kernel
def _span(from_m: float, cell_m: float, cells: int) -> tuple[int, int]:
    """The cells of one axis within reach, the last one excluded."""
    first = max(0, math.floor((from_m - SOLID_REACH_M) / cell_m))
    return first, min(cells, math.floor((from_m + SOLID_REACH_M) / cell_m) + 1)


@compile_exact_kernel
def _put_nearer(found: F64, kind: int, dx: float, dy: float, cos: float, sin: float) -> None:
    """Put a place into its sector if it is nearer than what is there; at a tie the first stays."""
    far2 = dx * dx + dy * dy
    if far2 >= SOLID_REACH_M * SOLID_REACH_M:
        return
    ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
    turned_rad = math.atan2(left, ahead) + math.pi
    sector = min(int(turned_rad * (SECTORS / (2.0 * math.pi))), SECTORS - 1)
    if far2 < found[sector, 0]:
        found[sector, 0], found[sector, 1] = far2, kind
        found[sector, 2], found[sector, 3] = ahead, left
