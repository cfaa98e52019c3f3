"""Boxes on the ground seen from above: whether two touch, and how far a point is from one.

A box is its middle, the cosine and sine of its heading, half its length and half its width.
"""

import math

from wcsim.core.jit import compile_exact_kernel
from wcsim.types import ActorState

# x, y, cos, sin of the heading, half length, half width
Box = tuple[float, float, float, float, float, float]


@compile_exact_kernel
def boxes_touch(
    ax: float, ay: float, a_cos: float, a_sin: float, a_long: float, a_wide: float,
    bx: float, by: float, b_cos: float, b_sin: float, b_long: float, b_wide: float,
) -> bool:  # fmt: skip
    """Whether two boxes overlap (separating axes)."""
    dx, dy = bx - ax, by - ay
    if dx * dx + dy * dy > (a_long + a_wide + b_long + b_wide) ** 2:
        return False
    cos = abs(a_cos * b_cos + a_sin * b_sin)
    sin = abs(a_cos * b_sin - a_sin * b_cos)
    return (
        abs(dx * a_cos + dy * a_sin) < a_long + b_long * cos + b_wide * sin
        and abs(dy * a_cos - dx * a_sin) < a_wide + b_long * sin + b_wide * cos
        and abs(dx * b_cos + dy * b_sin) < b_long + a_long * cos + a_wide * sin
        and abs(dy * b_cos - dx * b_sin) < b_wide + a_long * sin + a_wide * cos
    )


@compile_exact_kernel
def gap_to_box(
    px: float, py: float, x: float, y: float, cos: float, sin: float, long: float, wide: float
) -> float:
    """Distance in metres from a point to a box; inside it, minus the way out."""
    dx, dy = px - x, py - y
    beyond = abs(dx * cos + dy * sin) - long
    aside = abs(dy * cos - dx * sin) - wide
    if beyond <= 0.0 and aside <= 0.0:
        return max(beyond, aside)
    return math.hypot(max(beyond, 0.0), max(aside, 0.0))


def box_from_actor(actor: ActorState, more_m: float = 0.0) -> Box:
    """An actor's box on the ground, larger by `more_m` on every side."""
    x, y, _ = actor.p_W_m.tolist()
    length_m, width_m, _ = actor.size_lwh_m
    cos, sin = math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)
    return x, y, cos, sin, 0.5 * length_m + more_m, 0.5 * width_m + more_m
