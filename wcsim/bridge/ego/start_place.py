"""Where an episode may begin: a place that is clear of everything, in reach of a pavement."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from wcsim.core.frames import wrap_angle
from wcsim.errors import ConfigError
from wcsim.towns.walking.routes import Router
from wcsim.types import F64, ActorState, Ground, Outline, PlantState, Route, StartSpec

_START_REACH_M = 200.0  # a fixed start or goal lies within this of a pavement

_LOOK_AHEAD_M = 3.0

TakenNear = Callable[[F64, float], Sequence[ActorState]]


def check_in_town(start: StartSpec | None, router: Router) -> None:
    """Raise ConfigError for a fixed start from which there is no way anywhere."""
    for what, xy in () if start is None else (("start", start.p_W_m), ("goal", start.goal_W_m)):
        away_m = router.away_m(xy)
        if not away_m <= _START_REACH_M:
            raise ConfigError(
                f"{what} at {xy} m is {away_m:.0f} m from the nearest pavement; "
                f"expected one of the town's places, at most {_START_REACH_M:.0f} m away"
            )
    if start is not None and not math.isfinite(start.yaw_rad):
        raise ConfigError(f"start with a heading of {start.yaw_rad} rad; expected a finite number")


def heading_rad(route: Route, done_m: float, p_W_m: F64) -> float:
    """Where a way goes on, so far along it, as seen from a place (2,) or (3,)."""
    arc_m = min(done_m + _LOOK_AHEAD_M, float(route.arc_m[-1]))
    x_m, y_m = (float(np.interp(arc_m, route.arc_m, route.points_W_m[:, axis])) for axis in (0, 1))
    return math.atan2(y_m - float(p_W_m[1]), x_m - float(p_W_m[0]))


def bearing_rad(route: Route, done_m: float, plant: PlantState) -> float:
    """Where the way goes on from a chair's own heading, to the left; 0 straight ahead."""
    return wrap_angle(heading_rad(route, done_m, plant.p_WB_m) - plant.yaw_rad)


def is_clear(
    grid: Ground, outline: Outline, xy_W_m: F64, yaw_rad: float, clear_m: float, taken: TakenNear
) -> bool:
    """Whether a chair can start there: level ground, nothing solid near, nobody within clear_m.

    Nothing solid is within 0.2 m of its hull.
    """
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    middle_m, half_m, side_m = outline.middle_x_m, 0.5 * outline.length_m, 0.5 * outline.width_m
    footprint_B_m = [(middle_m + x * half_m, y * side_m) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    hull = xy_W_m + np.array(footprint_B_m) @ np.array([[cos, sin], [-sin, cos]])
    # Level to one step of the raster, which has whole centimetres.
    if float(np.ptp(grid.raised_at(hull))) > 0.011 or float(grid.clearance_at(hull).min()) < 0.2:
        return False
    middle = xy_W_m + middle_m * np.array([cos, sin])
    reach_m = clear_m + half_m
    return all(
        float(np.hypot(*(a.p_W_m[:2] - middle))) > reach_m + 0.5 * max(a.size_lwh_m[:2])
        for a in taken(middle, reach_m + 10.0)
    )
