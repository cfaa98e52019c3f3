"""People on foot as the oracle predicts them: plain arrays in and out, compiled by numba.

They do not go on as they go. They stop dead behind others, step aside for a wheelchair, end that
step and walk back to their own line. So a chair must not run into a person who goes on, and must be
able to stop before it runs into one who does otherwise. A body is round. A person who walks into a
chair that does not come towards them is at fault, as the world counts it
(`physics/wheelchair/contacts.py`), and is none of the chair's doing.
"""

import math
from typing import Final

import numpy as np

from wcsim.core.constants import SIDESTEP_MPS
from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64

_PEOPLE_MARGIN_M: Final = 0.05
_APPROACH_MPS: Final = 0.05  # a chair that comes nearer more slowly than this runs into no person

# Columns of the table (n, 9) of people: place and heading in W, radius, speeds ahead and to the
# left, how far left of their own line they walk, and the margin, set at the start of a roll-out.
_X, _Y, _COS, _SIN, _RADIUS_M, _AHEAD_MPS, _LEFT_MPS, _ASIDE_M, _MARGIN = range(9)
# Entries of a chair's hull (3,) seen from above: its middle ahead of the drive axle, half its
# length and half its width.
MIDDLE, HALF_L, HALF_W = range(3)


@compile_exact_kernel
def set_people_margins(x: float, y: float, yaw: float, hull: F64, people: F64) -> None:
    """Set a small margin, except for those within it already: they would forbid every move."""
    for i in range(len(people)):
        gap_m = measure_gap_to_person(x, y, yaw, hull, people[i])
        people[i, _MARGIN] = 0.0 if gap_m <= _PEOPLE_MARGIN_M else _PEOPLE_MARGIN_M


@compile_exact_kernel
def measure_gap_to_person(x: float, y: float, yaw: float, hull: F64, person: F64) -> float:
    """Metres from a chair's footprint to a person now, negative in one another."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    dx, dy = person[_X] - x, person[_Y] - y
    ahead, left = dx * cos + dy * sin - hull[MIDDLE], dy * cos - dx * sin
    out_l = max(0.0, abs(ahead) - hull[HALF_L])
    out_w = max(0.0, abs(left) - hull[HALF_W])
    return math.hypot(out_l, out_w) - float(person[_RADIUS_M])


@compile_exact_kernel
def filter_reachable_people(
    x: float, y: float, way_m: float, within_s: float, hull: F64, people: F64
) -> F64:
    """The people that a chair can meet which drives at most `way_m` in `within_s`."""
    near = np.empty_like(people)
    many = 0
    for i in range(len(people)):
        if math.hypot(people[i, _X] - x, people[i, _Y] - y) < way_m + _reach_m(
            hull, people[i], within_s
        ):
            near[many] = people[i]
            many += 1
    return near[:many]


@compile_exact_kernel
def has_steady_person_collision(
    x: float, y: float, yaw: float, v: float, w: float, hull: F64, later_s: float, people: F64
) -> bool:
    """Whether the chair, there and as fast in `later_s`, runs into a person who goes on as now."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(len(people)):
        person = people[i]
        if _meets(
            x, y, cos, sin, v, w, hull, person, later_s, person[_AHEAD_MPS], person[_LEFT_MPS]
        ):
            return True
    return False


@compile_exact_kernel
def has_possible_person_collision(
    x: float, y: float, yaw: float, v: float, w: float, hull: F64, later_s: float, people: F64
) -> bool:
    """Whether it runs into a person who goes on, slows down or stops.

    Each of them may step on, end the step, or step back to the own line.
    """
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(len(people)):
        person = people[i]
        dx, dy, reach = person[_X] - x, person[_Y] - y, _reach_m(hull, person, later_s)
        if dx * dx + dy * dy > reach * reach:
            continue
        left_mps = person[_LEFT_MPS]
        # No person steps back beyond the own line.
        most_mps = min(SIDESTEP_MPS, abs(person[_ASIDE_M]) / later_s)
        back_mps = -math.copysign(most_mps, person[_ASIDE_M])
        # Standing, half as fast, as fast: three paces stand for all between them.
        for share in range(3):
            ahead_mps = 0.5 * share * person[_AHEAD_MPS]
            if (
                _meets(x, y, cos, sin, v, w, hull, person, later_s, ahead_mps, 0.0)
                or (
                    left_mps != 0.0
                    and _meets(x, y, cos, sin, v, w, hull, person, later_s, ahead_mps, left_mps)
                )
                or (
                    back_mps != 0.0
                    and _meets(x, y, cos, sin, v, w, hull, person, later_s, ahead_mps, back_mps)
                )
            ):
                return True
            # A person who stands has no slower pace to try.
            if person[_AHEAD_MPS] == 0.0:
                break
    return False


@compile_exact_kernel
def _reach_m(hull: F64, person: F64, later_s: float) -> float:
    """Metres from the drive axle, at most, to a person now who touches the chair in `later_s`."""
    most_mps = abs(person[_AHEAD_MPS]) + max(abs(person[_LEFT_MPS]), SIDESTEP_MPS)
    return float(
        abs(hull[MIDDLE])
        + hull[HALF_L]
        + hull[HALF_W]
        + person[_RADIUS_M]
        + _PEOPLE_MARGIN_M
        + later_s * most_mps
    )


@compile_exact_kernel
def _meets(
    x: float, y: float, cos: float, sin: float, v: float, w: float, hull: F64,
    person: F64, later_s: float, ahead_mps: float, left_mps: float,
) -> bool:  # fmt: skip
    """Whether a point of a chair touches a person who walks so fast, and comes towards them."""
    vx = ahead_mps * person[_COS] - left_mps * person[_SIN]
    vy = ahead_mps * person[_SIN] + left_mps * person[_COS]
    dx, dy = person[_X] + later_s * vx - x, person[_Y] + later_s * vy - y
    reach = person[_RADIUS_M] + person[_MARGIN]
    px, py = dx * cos + dy * sin, dy * cos - dx * sin
    qx = min(max(px, hull[MIDDLE] - hull[HALF_L]), hull[MIDDLE] + hull[HALF_L])
    qy = min(max(py, -hull[HALF_W]), hull[HALF_W])
    out_x, out_y = px - qx, py - qy
    gap2 = out_x * out_x + out_y * out_y
    # A person in the hull has walked into it before.
    if gap2 >= reach * reach or gap2 == 0.0:
        return False
    own = (v - w * qy) * out_x + w * qx * out_y
    away = (vx * cos + vy * sin) * out_x + (vy * cos - vx * sin) * out_y
    return bool(own > max(_APPROACH_MPS * math.sqrt(gap2), away))
