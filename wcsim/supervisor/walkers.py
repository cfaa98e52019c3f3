"""People on foot as the oracle reckons with them: plain arrays in and out, compiled by numba.

They do not go on as they go. They stop dead behind others, step aside for a wheelchair, end that step and walk back to
their own line. So a chair must not run into somebody who goes on, and must be able to stop before it runs into somebody
who does otherwise. A body is round. Who walks into a chair that does not come towards it is at fault, as the world
counts it (`physics/wheelchair/contacts.py`), and is none of the chair's doing.
"""

from __future__ import annotations

import math

import numpy as np

from wcsim.core.constants import SIDESTEP_MPS
from wcsim.core.jit import exact_kernel
from wcsim.types import F64

MARGIN_M = 0.05
HARDLY_MPS = 0.05  # a chair that comes nearer more slowly than this runs into nobody

# columns of the table (n, 9): where, the heading, the radius, the speeds ahead and to the left of it, how far left of
# their own line they walk, and the margin, set at the start of a roll-out
PX, PY, PCOS, PSIN, PRADIUS, PAHEAD_MPS, PLEFT_MPS, PASIDE_M, PMARGIN = range(9)
# entries of a chair's hull (3,) seen from above: its middle ahead of the drive axle, half its length and half its width
MIDDLE, HALF_L, HALF_W = range(3)


@exact_kernel
def set_people_margins(x: float, y: float, yaw: float, hull: F64, people: F64) -> None:
    """Everybody gets a small margin, except those who stand within it already: they would forbid every move."""
    for i in range(len(people)):
        gap_m = person_gap(x, y, yaw, hull, people[i])
        people[i, PMARGIN] = 0.0 if gap_m <= MARGIN_M else MARGIN_M


@exact_kernel
def person_gap(x: float, y: float, yaw: float, hull: F64, person: F64) -> float:
    """Distance in metres from a chair's footprint to a person now, negative in one another."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    dx, dy = person[PX] - x, person[PY] - y
    ahead, left = dx * cos + dy * sin - hull[MIDDLE], dy * cos - dx * sin
    out_l = max(0.0, abs(ahead) - hull[HALF_L])
    out_w = max(0.0, abs(left) - hull[HALF_W])
    return math.hypot(out_l, out_w) - float(person[PRADIUS])


@exact_kernel
def near_people(x: float, y: float, way_m: float, within_s: float, hull: F64, people: F64) -> F64:
    """Those of the people whom a chair can meet that drives `way_m` at most in so many seconds."""
    near = np.empty_like(people)
    many = 0
    for i in range(len(people)):
        if math.hypot(people[i, PX] - x, people[i, PY] - y) < way_m + _reach_m(
            hull, people[i], within_s
        ):
            near[many] = people[i]
            many += 1
    return near[:many]


@exact_kernel
def runs_into_going_on(
    x: float, y: float, yaw: float, v: float, w: float, hull: F64, later_s: float, people: F64
) -> bool:
    """Whether the chair, there and as fast in `later_s`, runs into somebody who goes on as now."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(len(people)):
        one = people[i]
        if _meets(x, y, cos, sin, v, w, hull, one, later_s, one[PAHEAD_MPS], one[PLEFT_MPS]):
            return True
    return False


@exact_kernel
def runs_into_any_way(
    x: float, y: float, yaw: float, v: float, w: float, hull: F64, later_s: float, people: F64
) -> bool:
    """The same of somebody who goes on, slows down or stops, and steps on, ends it or steps back to the own line."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(len(people)):
        one = people[i]
        dx, dy, reach = one[PX] - x, one[PY] - y, _reach_m(hull, one, later_s)
        if dx * dx + dy * dy > reach * reach:
            continue
        left_mps = one[PLEFT_MPS]
        # Nobody steps back beyond the own line.
        most_mps = min(SIDESTEP_MPS, abs(one[PASIDE_M]) / later_s)
        back_mps = -math.copysign(most_mps, one[PASIDE_M])
        # Standing, half as fast, as fast: three paces stand for all between them.
        for share in range(3):
            ahead_mps = 0.5 * share * one[PAHEAD_MPS]
            if (
                _meets(x, y, cos, sin, v, w, hull, one, later_s, ahead_mps, 0.0)
                or (
                    left_mps != 0.0
                    and _meets(x, y, cos, sin, v, w, hull, one, later_s, ahead_mps, left_mps)
                )
                or (
                    back_mps != 0.0
                    and _meets(x, y, cos, sin, v, w, hull, one, later_s, ahead_mps, back_mps)
                )
            ):
                return True
            # A person who stands has no slower pace to try.
            if one[PAHEAD_MPS] == 0.0:
                break
    return False


@exact_kernel
def _reach_m(hull: F64, person: F64, later_s: float) -> float:
    """How far from the drive axle somebody may be now who touches the chair in so many seconds, at most."""
    most_mps = abs(person[PAHEAD_MPS]) + max(abs(person[PLEFT_MPS]), SIDESTEP_MPS)
    return float(
        abs(hull[MIDDLE])
        + hull[HALF_L]
        + hull[HALF_W]
        + person[PRADIUS]
        + MARGIN_M
        + later_s * most_mps
    )


@exact_kernel
def _meets(
    x: float,
    y: float,
    cos: float,
    sin: float,
    v: float,
    w: float,
    hull: F64,
    person: F64,
    later_s: float,
    ahead_mps: float,
    left_mps: float,
) -> bool:
    """Whether a chair touches a person who has walked so fast, with a point of its own that comes towards them."""
    vx = ahead_mps * person[PCOS] - left_mps * person[PSIN]
    vy = ahead_mps * person[PSIN] + left_mps * person[PCOS]
    dx, dy = person[PX] + later_s * vx - x, person[PY] + later_s * vy - y
    reach = person[PRADIUS] + person[PMARGIN]
    px, py = dx * cos + dy * sin, dy * cos - dx * sin
    qx = min(max(px, hull[MIDDLE] - hull[HALF_L]), hull[MIDDLE] + hull[HALF_L])
    qy = min(max(py, -hull[HALF_W]), hull[HALF_W])
    out_x, out_y = px - qx, py - qy
    gap2 = out_x * out_x + out_y * out_y
    if gap2 >= reach * reach or gap2 == 0.0:  # who is in the hull has walked into it before
        return False
    own = (v - w * qy) * out_x + w * qx * out_y
    away = (vx * cos + vy * sin) * out_x + (vy * cos - vx * sin) * out_y
    return bool(own > max(HARDLY_MPS * math.sqrt(gap2), away))
