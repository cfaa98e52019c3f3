"""Driving trials: straight on, round and round, to a stop, uphill and across a slope."""

import math
from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np

from wcsim.chair_check.rig import FORWARD, NEUTRAL, ChairTestRig
from wcsim.chair_check.row import TrialSetup, TrialSpec, UnfinishedMeasurement, make_trial_spec
from wcsim.config import PROFILE_SPEED_MPS
from wcsim.core.frames import deg2rad
from wcsim.core.joystick import compute_yaw_rate_limit
from wcsim.physics.wheelchair.drive_controller import stopping_distance_m
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec
from wcsim.types import Joystick, PlantState

_SLOPE_RAD: Final = deg2rad(10.0)
_PULL_N: Final = 400.0
_ROAD_MPS: Final = PROFILE_SPEED_MPS["road"]
_KMH: Final = 1.0 / 3.6
_START_S: Final = 4.0  # after these a chair drives steadily
_ROUND_S: Final = 6.0
_HEADING_RAD: Final = 0.3  # not along the edges of the ground
_STRAIGHT_M: Final = 10.0
_BACK_M: Final = 12.0
_ACROSS_M: Final = 8.0
_LOST_RAD: Final = 0.5  # off the heading that the stick was held for


def make_driving_trials(setup: TrialSetup) -> Iterator[TrialSpec]:
    """The rows of one plant."""
    yield make_trial_spec("straight_drift_10m", _straight_drift_m)
    for name, speed in PROFILE_SPEED_MPS.items():
        yield make_trial_spec(
            "cruise_{profile}", _cruise_mps, speed, speed_mps=speed, profile=name, speed=speed
        )
    # Of full stick: the corner is pulled to the unit circle.
    diagonal = math.sqrt(0.5)
    most = partial(
        compute_yaw_rate_limit,
        yaw_max_radps=setup.chair.yaw_rate_max_radps,
        slowdown_s_per_m=setup.chair.yaw_slowdown_s_per_m,
    )
    turns = (
        ("in_place", Joystick(-1.0, 0.0), most(0.0)),
        ("at_speed", Joystick(-1.0, 1.0), diagonal * most(diagonal * setup.chair.v_max_mps)),
    )
    for name, stick, rate in turns:
        towards = "diagonal" if stick.y else "to the side"
        yield make_trial_spec(
            "turn_{way}", partial(_turn_radps, stick=stick), rate, way=name, stick=towards
        )
    for kmh in (6, 10):
        speed = kmh * _KMH
        way_m = stopping_distance_m(speed, setup.chair.decel_mps2, setup.chair.jerk_mps3)
        yield make_trial_spec("stopping_{kmh}kmh", _stopping_m, way_m, speed_mps=speed, kmh=kmh)
    yield from _slopes(setup)


def _slopes(setup: TrialSetup) -> Iterator[TrialSpec]:
    yield make_trial_spec(
        "climb_10deg", partial(_climb_mps, slope_rad=_SLOPE_RAD), setup.chair.v_max_mps
    )
    spec = plant_spec(setup.chair)
    top_mps = min(_ROAD_MPS, spec.limits.speed_mps)
    top = min(_top_speed_mps(spec, _PULL_N), top_mps)
    pulling = partial(_pulling_mps, pull_N=_PULL_N)
    yield make_trial_spec(
        "pulling_400N", pulling, top, speed_mps=top_mps, pull=_PULL_N, asked=top_mps
    )
    for facing, ahead, left in (
        ("up", _SLOPE_RAD, 0.0),
        ("down", -_SLOPE_RAD, 0.0),
        ("across", 0.0, _SLOPE_RAD),
    ):
        yield make_trial_spec(
            "parked_10deg_{facing}",
            partial(_creep_m, ahead_rad=ahead, left_rad=left),
            facing=facing,
        )
    yield make_trial_spec("cross_slope_10deg", partial(_cross_slope_drift_m, slope_rad=_SLOPE_RAD))


def _top_speed_mps(spec: PlantSpec, pull_N: float) -> float:
    """Where the torque of two motors, falling with speed, is what the pull takes."""
    need_Nm = 0.5 * pull_N * spec.wheel.radius_m
    motor = spec.motor
    if need_Nm <= motor.least_torque_share * motor.stall_torque_Nm:
        return math.inf
    return (
        max(0.0, motor.no_load_radps * (1.0 - need_Nm / motor.stall_torque_Nm))
        * spec.wheel.radius_m
    )


def _straight_drift_m(setup: TrialSetup) -> float:
    """How far beside the straight line it is after 10 m at full stick from rest."""
    with ChairTestRig(setup) as rig:
        rig.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        start = rig.chair.state().p_WB_m
        way = (
            rig.drive(FORWARD, 30.0, lambda state: math.dist(state.p_WB_m, start) > _STRAIGHT_M).p_m
            - start
        )
    aside = -math.sin(_HEADING_RAD) * way[:, 0] + math.cos(_HEADING_RAD) * way[:, 1]
    return float(np.abs(aside).max())


def _cruise_mps(setup: TrialSetup) -> float:
    """Mean speed of two seconds straight ahead at full stick."""
    with ChairTestRig(setup) as rig:
        rig.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        rig.drive(FORWARD, _START_S + setup.chair.v_max_mps)
        return float(rig.drive(FORWARD, 2.0).speed_mps.mean())


def measure_cruise_peak_accel_mps2(setup: TrialSetup) -> float:
    """The largest low-passed acceleration while it cruises straight on level ground."""
    with ChairTestRig(setup) as rig:
        rig.place(-_BACK_M, yaw_rad=_HEADING_RAD)
        rig.drive(FORWARD, _START_S + setup.chair.v_max_mps)
        return rig.drive(FORWARD, 4.0).peak_mps2


def _turn_radps(setup: TrialSetup, stick: Joystick) -> float:
    """Mean turn rate of six seconds, after the casters have come round."""
    with ChairTestRig(setup) as rig:
        rig.drive(stick, _ROUND_S)
        return float(np.mean([state.w_B_radps[2] for state in rig.drive(stick, 6.0).states]))


def _stopping_m(setup: TrialSetup) -> float:
    """Way from the moment the stick is let go, at full speed, until it stands."""
    with ChairTestRig(setup) as rig:
        rig.place(-3.0 * _BACK_M)
        start = rig.drive(FORWARD, _START_S + setup.chair.v_max_mps).p_m[-1]
        end = rig.drive(NEUTRAL, 6.0).p_m[-1]
    return math.dist(start, end)


def _climb_mps(setup: TrialSetup, slope_rad: float) -> float:
    """Speed straight up a slope at full stick, after it has become steady."""
    with ChairTestRig(setup, slope_rad=(slope_rad, 0.0)) as rig:
        rig.drive(FORWARD, _START_S + setup.chair.v_max_mps)
        return float(rig.drive(FORWARD, 1.0).speed_mps.mean())


def _pulling_mps(setup: TrialSetup, pull_N: float) -> float:
    """Steady speed at full stick on level ground against a constant pull from behind."""
    with ChairTestRig(setup) as rig:
        rig.place(-2.0 * _BACK_M)
        rig.drive(FORWARD, _START_S + 2.0 * setup.chair.v_max_mps, pull_N=pull_N)
        return float(rig.drive(FORWARD, 1.0, pull_N=pull_N).speed_mps.mean())


def _creep_m(setup: TrialSetup, ahead_rad: float, left_rad: float) -> float:
    """How far it moves in five seconds on a slope without stick, after one second to settle."""
    with ChairTestRig(setup, slope_rad=(ahead_rad, left_rad)) as rig:
        start = rig.drive(NEUTRAL, 1.0).p_m[-1]
        end = rig.drive(NEUTRAL, 5.0).p_m[-1]
    return math.dist(start, end)


def _cross_slope_drift_m(setup: TrialSetup, slope_rad: float) -> float | UnfinishedMeasurement:
    """How far downhill it is after 8 m across a slope with a straight stick, if it gets there."""

    def ends(state: PlantState) -> bool:
        return float(state.p_WB_m[0]) > _ACROSS_M or abs(state.yaw_rad) > _LOST_RAD

    with ChairTestRig(setup, slope_rad=(0.0, slope_rad)) as rig:
        ride = rig.drive(FORWARD, 30.0, ends)
    aside_m = float(np.abs(ride.p_m[:, 1]).max()) / math.cos(slope_rad)
    far_m, turned_rad = float(ride.p_m[-1, 0]), ride.states[-1].yaw_rad
    if far_m > _ACROSS_M:
        return aside_m
    lost = "lost its heading" if abs(turned_rad) > _LOST_RAD else "stood still"
    return UnfinishedMeasurement(
        value=aside_m,
        what=f"{lost} after {far_m:.1f} m of {_ACROSS_M:g} m: motors too weak, or no grip",
    )
