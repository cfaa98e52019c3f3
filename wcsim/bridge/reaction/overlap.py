"""Does a vehicle's way touch a wheelchair, and where does it find room beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.bridge.reaction.swept_path import STEP_M
from wcsim.core.boxes import boxes_touch
from wcsim.core.jit import exact_kernel
from wcsim.types import F64, I32

ROOM_M = 0.6  # free width beside a vehicle's own that lets it pass
EDGE_M = 0.1  # of it, kept to the lane's edge
WIDEST_M = 1.0  # more than this is not left beside the wheelchair
LONGEST_LOOK_S = 3.0  # how far ahead others foresee where a chair will be


@dataclass(frozen=True, slots=True, kw_only=True)
class SweptOverlap:
    """Where a way meets a wheelchair, per side gap that was asked for; and the chair's place across the way."""

    at: tuple[int, ...]  # index of the first pose that touches, by gap; -1 where none does
    right_m: float  # the chair's right and left end, left of the vehicle's line
    left_m: float


@exact_kernel
def _touches(
    poses: F64, i: int, left_m: float, skew: float, long: float, wide: float, chair: F64, chair_x: float, chair_y: float
) -> bool:
    """Whether the body, so far left of pose i and skewed against it, touches the chair when that is there."""
    line_cos, line_sin = poses[i, 2], poses[i, 3]
    cos, sin = line_cos - skew * line_sin, line_sin + skew * line_cos
    size = math.sqrt(1.0 + skew * skew)
    cos, sin = cos / size, sin / size
    x = poses[i, 0] + long * (line_cos - cos) - line_sin * left_m
    y = poses[i, 1] + long * (line_sin - sin) + line_cos * left_m
    return boxes_touch(x, y, cos, sin, long, wide, chair_x, chair_y, chair[2], chair[3], chair[4], chair[5])


@exact_kernel
def _first_touches(
    poses: F64, first: int, last: int, long: float, wide: float, left_m: float, skew: float, gaps_m: F64, chair: F64,
    now: float, pose_s: float, sooner_s: float, out: I32,
) -> tuple[float, float]:  # fmt: skip
    """Fill `out` with the first pose that touches the chair with each gap; chair: x, y, cos, sin, halves, v_x, v_y.

    long, wide: half the body; now: index of its pose. Returns the chair's ends across the way.
    """
    out[:] = -1
    low, high = 0.0, 0.0
    moving = chair[6] ** 2 + chair[7] ** 2 > 0.01
    views = 4 if moving else 1
    missing = len(gaps_m)
    reach = long + wide + gaps_m[-1] + chair[4] + chair[5] + abs(left_m) + 2.0 * long * abs(skew)
    if moving:
        reach += LONGEST_LOOK_S * math.hypot(chair[6], chair[7])
    for i in range(first, last):
        cos, sin = poses[i, 2], poses[i, 3]
        if (poses[i, 0] - chair[0]) ** 2 + (poses[i, 1] - chair[1]) ** 2 > reach * reach:
            continue
        until_s = min(max(0.0, (i - now) * pose_s) + sooner_s, LONGEST_LOOK_S) if i > first else 0.0
        still = skew * math.exp(-0.5 * STEP_M * max(0.0, i - now) / long)  # what is left of the skew
        for view in range(views):
            ahead_s = until_s * view / 3.0
            cx, cy = chair[0] + chair[6] * ahead_s, chair[1] + chair[7] * ahead_s
            for j in range(len(gaps_m) - 1, -1, -1):
                if out[j] >= 0:
                    continue
                side = wide + gaps_m[j]
                if not _touches(poses, i, left_m, still, long, side, chair, cx, cy):
                    break  # nor with a smaller gap
                # Where it has to stop for a chair that comes across: before its body reaches that place at all.
                at = i
                while at > first and moving and _touches(poses, at - 1, left_m, still, long, side, chair, cx, cy):
                    at -= 1
                if at == first and i > first + 1:
                    continue  # its front has gone by that place: it leaves it free soonest by driving on
                out[j] = at
                missing -= 1
                if j == 1:
                    middle = (cy - poses[i, 1]) * cos - (cx - poses[i, 0]) * sin
                    turn = abs(chair[3] * cos - chair[2] * sin)
                    across = chair[4] * turn + chair[5] * abs(chair[2] * cos + chair[3] * sin)
                    low, high = middle - across, middle + across
        if missing == 0:
            break
    return low, high


def first_touches(
    poses: F64,
    span: tuple[int, int],
    body: tuple[float, float, float, float],
    gaps_m: F64,
    chair: F64,
    pace: tuple[float, float],
    sooner_s: float = 0.0,
) -> SweptOverlap:
    """Where the body on these poses first comes nearer to the chair, sideways, than each of the gaps.

    Args:
        poses: (n, 4) x, y, cos, sin of the body's middle along the way.
        span: The poses to look at, first and one past the last.
        body: Half its length and width, how far left of the poses its front runs, and its skew: the tangent of the
            angle by which it is turned against its pose now, as in a change of lanes; its tail comes in line again as
            it drives on.
        gaps_m: (g,) gaps kept to either side, rising, at least two; the chair's ends are those seen at the second.
        chair: (8,) x, y, cos, sin, half length, half width, velocity x and y.
        pace: Pose index of the body now, and seconds from pose to pose.
        sooner_s: A chair that comes across may be there this much sooner than it seems.
    """
    out = np.empty(len(gaps_m), np.int32)
    # plain numbers: an array of them costs more than the look
    low, high = _first_touches(poses, *span, *body, gaps_m, chair, *pace, sooner_s, out)
    return SweptOverlap(at=tuple(out.tolist()), right_m=low, left_m=high)


def room_beside(touch: SweptOverlap, width_m: float, lane_width_m: float) -> tuple[float, ...]:
    """Places of the vehicle's middle, left of the lane's, at which it passes the chair within its lane; nearest first.

    >>> room_beside(SweptOverlap(at=(9,), right_m=-1.6, left_m=-1.0), 0.6, 3.2)
    (0.3,)
    """
    edge_m = 0.5 * lane_width_m
    places = []
    left_room, right_room = edge_m - touch.left_m, touch.right_m + edge_m
    if left_room >= width_m + ROOM_M:
        gap_m = min(WIDEST_M, left_room - width_m - EDGE_M)
        places.append(touch.left_m + gap_m + 0.5 * width_m)
    if right_room >= width_m + ROOM_M:
        gap_m = min(WIDEST_M, right_room - width_m - EDGE_M)
        places.append(touch.right_m - gap_m - 0.5 * width_m)
    return tuple(sorted(places, key=abs))
