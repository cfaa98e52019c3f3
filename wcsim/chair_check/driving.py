"""Driving trials: straight on, round and round, to a stop, uphill and across a slope."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from wcsim.chair_check.row import Setup, Unfinished
from wcsim.chair_check.yard import FORWARD, NEUTRAL, Yard, plane_street
from wcsim.types import Joystick, PlantState

START_S: Final = 4.0  # after these a chair drives steadily
_ROUND_S: Final = 6.0
_HEADING_RAD: Final = 0.3  # not along the edges of the ground
_STRAIGHT_M: Final = 10.0
_BACK_M: Final = 12.0
_ACROSS_M: Final = 8.0
_LOST_RAD: Final = 0.5  # off the heading that the stick was held for


def straight_drift_m(setup: Setup) -> float:
    """How far beside the straight line it is after 10 m at full stick from rest."""
    with Yard(setup) as yard:
        yard.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        start = yard.chair.state().p_WB_m
        way = yard.drive(FORWARD, 30.0, lambda state: math.dist(state.p_WB_m, start) > _STRAIGHT_M).p_m - start
    aside = -math.sin(_HEADING_RAD) * way[:, 0] + math.cos(_HEADING_RAD) * way[:, 1]
    return float(np.abs(aside).max())


def cruise_mps(setup: Setup) -> float:
    """Mean speed of two seconds straight ahead at full stick."""
    with Yard(setup) as yard:
        yard.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        yard.drive(FORWARD, START_S + setup.chair.v_max_mps)
        return float(yard.drive(FORWARD, 2.0).speed_mps.mean())


def cruise_peak_mps2(setup: Setup) -> float:
    """The largest low-passed acceleration while it cruises straight on level ground."""
    with Yard(setup) as yard:
        yard.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        yard.drive(FORWARD, START_S + setup.chair.v_max_mps)
        return yard.drive(FORWARD, 4.0).peak_mps2


def turn_radps(setup: Setup, stick: Joystick) -> float:
    """Mean turn rate of six seconds, after the casters have come round."""
    with Yard(setup) as yard:
        yard.drive(stick, _ROUND_S)
        return float(np.mean([state.w_B_radps[2] for state in yard.drive(stick, 6.0).states]))


def stopping_m(setup: Setup) -> float:
    """Way from the moment the stick is let go, at full speed, until it stands."""
    with Yard(setup) as yard:
        yard.place(-3.0 * _BACK_M)
        start = yard.drive(FORWARD, START_S + setup.chair.v_max_mps).p_m[-1]
        end = yard.drive(NEUTRAL, 6.0).p_m[-1]
    return math.dist(start, end)


def climb_mps(setup: Setup, slope_rad: float) -> float:
    """Speed straight up a slope at full stick, after it has become steady."""
    with Yard(setup, plane_street(ahead_rad=slope_rad)) as yard:
        yard.drive(FORWARD, START_S + setup.chair.v_max_mps)
        return float(yard.drive(FORWARD, 1.0).speed_mps.mean())


def pulling_mps(setup: Setup, pull_N: float) -> float:
    """Steady speed at full stick on level ground while something behind pulls back with a constant force."""
    with Yard(setup) as yard:
        yard.place(-2.0 * _BACK_M)
        yard.drive(FORWARD, START_S + 2.0 * setup.chair.v_max_mps, pull_N=pull_N)
        return float(yard.drive(FORWARD, 1.0, pull_N=pull_N).speed_mps.mean())


def creep_m(setup: Setup, ahead_rad: float, left_rad: float) -> float:
    """How far it moves in five seconds on a slope with the stick let go, after one second to settle."""
    with Yard(setup, plane_street(ahead_rad, left_rad)) as yard:
        start = yard.drive(NEUTRAL, 1.0).p_m[-1]
        end = yard.drive(NEUTRAL, 5.0).p_m[-1]
    return math.dist(start, end)


def cross_slope_drift_m(setup: Setup, slope_rad: float) -> float | Unfinished:
    """How far downhill it is after 8 m straight ahead across a slope, the stick held straight, if it gets there."""

    def ends(state: PlantState) -> bool:
        return float(state.p_WB_m[0]) > _ACROSS_M or abs(state.yaw_rad) > _LOST_RAD

    with Yard(setup, plane_street(left_rad=slope_rad)) as yard:
        ride = yard.drive(FORWARD, 30.0, ends)
    aside_m = float(np.abs(ride.p_m[:, 1]).max()) / math.cos(slope_rad)
    far_m, turned_rad = float(ride.p_m[-1, 0]), ride.states[-1].yaw_rad
    if far_m > _ACROSS_M:
        return aside_m
    lost = "lost its heading" if abs(turned_rad) > _LOST_RAD else "stood still"
    return Unfinished(value=aside_m, what=f"{lost} after {far_m:.1f} m of {_ACROSS_M:g} m: motors too weak, or no grip")
