"""Driving trials and their rows: straight on, round and round, to a stop, uphill and across a slope."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np

from wcsim.chair_check.rig import FORWARD, NEUTRAL, Rig, plane_street
from wcsim.chair_check.row import Setup, Trial, Unfinished
from wcsim.config import PROFILE_SPEED_MPS
from wcsim.core.frames import rad
from wcsim.core.joystick import yaw_rate_limit
from wcsim.physics.wheelchair.drive_controller import stopping_distance_m
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec
from wcsim.types import Joystick, PlantState

_SLOPE_RAD: Final = rad(10.0)
_PULL_N: Final = 400.0
_ROAD_MPS: Final = PROFILE_SPEED_MPS["road"]
_KMH: Final = 1.0 / 3.6


def driving_trials(setup: Setup) -> Iterator[Trial]:
    """The rows of one plant."""
    yield Trial(
        name="straight_drift_10m",
        unit="m",
        bound="wcsim",
        low=0.0,
        high=0.05,
        method="largest distance from the straight line over 10 m at full stick from rest",
        source="bound of 0.05 m",
        measure=_straight_drift_m,
    )
    for name, speed in PROFILE_SPEED_MPS.items():
        yield Trial(
            name=f"cruise_{name}",
            unit="m/s",
            bound="stick",
            low=0.97 * speed,
            high=1.03 * speed,
            method=f"mean speed of 2 s straight ahead at full stick, set to {speed} m/s (ISO 7176-6)",
            source="requested speed, within 3 %",
            measure=_cruise_mps,
            speed_mps=speed,
        )
    diagonal = math.sqrt(0.5)  # of full stick: the corner is pulled to the unit circle
    turn_radps = setup.chair.yaw_rate_max_radps
    turns = (
        ("in_place", Joystick(-1.0, 0.0), yaw_rate_limit(0.0, turn_radps)),
        ("at_speed", Joystick(-1.0, 1.0), diagonal * yaw_rate_limit(diagonal * setup.chair.v_max_mps, turn_radps)),
    )
    for name, stick, rate in turns:
        yield Trial(
            name=f"turn_{name}",
            unit="rad/s",
            bound="stick",
            low=0.97 * rate,
            high=1.03 * rate,
            method="mean turn rate of 6 s, stick " + ("diagonal" if stick.y else "to the side"),
            source="requested turn rate, within 3 %",
            measure=partial(_turn_radps, stick=stick),
        )
    for kmh in (6, 10):
        yield _stopping(setup, kmh)
    yield from _slopes(setup)


def _stopping(setup: Setup, kmh: int) -> Trial:
    speed = kmh * _KMH
    way = stopping_distance_m(speed, setup.chair.decel_mps2, setup.chair.jerk_mps3)
    return Trial(
        name=f"stopping_{kmh}kmh",
        unit="m",
        bound="stick",
        low=0.9 * way,
        high=1.1 * way,
        method=f"stopping distance after releasing the stick at {kmh} km/h (ISO 7176-3)",
        source="jerk-limited v2/2a + v a/2j within 10 %",
        measure=_stopping_m,
        speed_mps=speed,
    )


def _slopes(setup: Setup) -> Iterator[Trial]:
    speed = setup.chair.v_max_mps
    yield Trial(
        name="climb_10deg",
        unit="m/s",
        bound="norm",
        low=0.97 * speed,
        high=1.03 * speed,
        method="steady speed straight up a slope of 10 degrees at full stick",
        source="rated slope (EN 12184 class C), speed held within 3 %",
        measure=partial(_climb_mps, slope_rad=_SLOPE_RAD),
    )
    spec = plant_spec(setup.chair)
    asked = min(_ROAD_MPS, spec.limits.speed_mps)
    top = min(_top_speed_mps(spec, _PULL_N), asked)
    yield Trial(
        name="pulling_400N",
        unit="m/s",
        bound="file",
        low=0.92 * top,
        high=1.02 * top,
        method=f"steady speed on level ground against a pull of {_PULL_N:g} N, full stick, set to {asked} m/s",
        source="where the declared torque curve of two motors meets the pull, minus the torque for steering",
        measure=partial(_pulling_mps, pull_N=_PULL_N),
        speed_mps=asked,
    )
    for name, ahead, left in (("up", _SLOPE_RAD, 0.0), ("down", -_SLOPE_RAD, 0.0), ("across", 0.0, _SLOPE_RAD)):
        yield Trial(
            name=f"parked_10deg_{name}",
            unit="m",
            bound="norm",
            low=0.0,
            high=0.02,
            method=f"distance rolled in 5 s with the stick released, facing {name} a slope of 10 degrees",
            source="held by the parking brake",
            measure=partial(_creep_m, ahead_rad=ahead, left_rad=left),
        )
    yield Trial(
        name="cross_slope_10deg",
        unit="m",
        bound="wcsim",
        low=0.0,
        high=0.1,
        method="drift downhill over 8 m straight across a slope of 10 degrees, stick held straight",
        source="less than one degree of drift",
        measure=partial(_cross_slope_drift_m, slope_rad=_SLOPE_RAD),
    )


def _top_speed_mps(spec: PlantSpec, pull_N: float) -> float:
    """Where the torque of two motors, falling with speed, is what the pull takes."""
    need_Nm = 0.5 * pull_N * spec.wheel.radius_m
    motor = spec.motor
    if need_Nm <= motor.least_torque_share * motor.stall_torque_Nm:
        return math.inf
    return max(0.0, motor.no_load_radps * (1.0 - need_Nm / motor.stall_torque_Nm)) * spec.wheel.radius_m


_START_S: Final = 4.0  # after these a chair drives steadily
_ROUND_S: Final = 6.0
_HEADING_RAD: Final = 0.3  # not along the edges of the ground
_STRAIGHT_M: Final = 10.0
_BACK_M: Final = 12.0
_ACROSS_M: Final = 8.0
_LOST_RAD: Final = 0.5  # off the heading that the stick was held for


def _straight_drift_m(setup: Setup) -> float:
    """How far beside the straight line it is after 10 m at full stick from rest."""
    with Rig(setup) as rig:
        rig.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        start = rig.chair.state().p_WB_m
        way = rig.drive(FORWARD, 30.0, lambda state: math.dist(state.p_WB_m, start) > _STRAIGHT_M).p_m - start
    aside = -math.sin(_HEADING_RAD) * way[:, 0] + math.cos(_HEADING_RAD) * way[:, 1]
    return float(np.abs(aside).max())


def _cruise_mps(setup: Setup) -> float:
    """Mean speed of two seconds straight ahead at full stick."""
    with Rig(setup) as rig:
        rig.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        rig.drive(FORWARD, _START_S + setup.chair.v_max_mps)
        return float(rig.drive(FORWARD, 2.0).speed_mps.mean())


def cruise_peak_mps2(setup: Setup) -> float:
    """The largest low-passed acceleration while it cruises straight on level ground."""
    with Rig(setup) as rig:
        rig.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        rig.drive(FORWARD, _START_S + setup.chair.v_max_mps)
        return rig.drive(FORWARD, 4.0).peak_mps2


def _turn_radps(setup: Setup, stick: Joystick) -> float:
    """Mean turn rate of six seconds, after the casters have come round."""
    with Rig(setup) as rig:
        rig.drive(stick, _ROUND_S)
        return float(np.mean([state.w_B_radps[2] for state in rig.drive(stick, 6.0).states]))


def _stopping_m(setup: Setup) -> float:
    """Way from the moment the stick is let go, at full speed, until it stands."""
    with Rig(setup) as rig:
        rig.place(-3.0 * _BACK_M)
        start = rig.drive(FORWARD, _START_S + setup.chair.v_max_mps).p_m[-1]
        end = rig.drive(NEUTRAL, 6.0).p_m[-1]
    return math.dist(start, end)


def _climb_mps(setup: Setup, slope_rad: float) -> float:
    """Speed straight up a slope at full stick, after it has become steady."""
    with Rig(setup, plane_street(ahead_rad=slope_rad)) as rig:
        rig.drive(FORWARD, _START_S + setup.chair.v_max_mps)
        return float(rig.drive(FORWARD, 1.0).speed_mps.mean())


def _pulling_mps(setup: Setup, pull_N: float) -> float:
    """Steady speed at full stick on level ground while something behind pulls back with a constant force."""
    with Rig(setup) as rig:
        rig.place(-2.0 * _BACK_M)
        rig.drive(FORWARD, _START_S + 2.0 * setup.chair.v_max_mps, pull_N=pull_N)
        return float(rig.drive(FORWARD, 1.0, pull_N=pull_N).speed_mps.mean())


def _creep_m(setup: Setup, ahead_rad: float, left_rad: float) -> float:
    """How far it moves in five seconds on a slope with the stick let go, after one second to settle."""
    with Rig(setup, plane_street(ahead_rad, left_rad)) as rig:
        start = rig.drive(NEUTRAL, 1.0).p_m[-1]
        end = rig.drive(NEUTRAL, 5.0).p_m[-1]
    return math.dist(start, end)


def _cross_slope_drift_m(setup: Setup, slope_rad: float) -> float | Unfinished:
    """How far downhill it is after 8 m straight ahead across a slope, the stick held straight, if it gets there."""

    def ends(state: PlantState) -> bool:
        return float(state.p_WB_m[0]) > _ACROSS_M or abs(state.yaw_rad) > _LOST_RAD

    with Rig(setup, plane_street(left_rad=slope_rad)) as rig:
        ride = rig.drive(FORWARD, 30.0, ends)
    aside_m = float(np.abs(ride.p_m[:, 1]).max()) / math.cos(slope_rad)
    far_m, turned_rad = float(ride.p_m[-1, 0]), ride.states[-1].yaw_rad
    if far_m > _ACROSS_M:
        return aside_m
    lost = "lost its heading" if abs(turned_rad) > _LOST_RAD else "stood still"
    return Unfinished(value=aside_m, what=f"{lost} after {far_m:.1f} m of {_ACROSS_M:g} m: motors too weak, or no grip")
