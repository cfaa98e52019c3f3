"""Kerbs: what a chair climbs and what stops it, what it feels of them, and when it falls off one."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from wcsim.chair_check.row import Setup
from wcsim.chair_check.yard import FACE_X_M, FORWARD, NEUTRAL, Yard, step_street
from wcsim.physics.wheelchair.plant import PlantSpec
from wcsim.types import ClassId, Joystick, PlantState, StreetMesh

_TOUCHING_M: Final = 0.002
_LEVEL_M: Final = 0.005
_RUN_M: Final = 3.3  # to reach a steady speed before a kerb
_WALL_M: Final = 2.0
_RUNS: Final = 6
_LONGEST_STEP_S: Final = 1.0 / 120.0
_TIPPED: Final = 0.5  # upright part of the chair's z below which it lies on its side


def _front_m(spec: PlantSpec) -> float:
    """The foremost point of the foremost caster, trailing, ahead of the drive axle; the drive wheel's if it leads."""
    casters = [pair.swivel_x_m - pair.trail_m + pair.radius_m for pair in spec.casters]
    return max([spec.wheel.radius_m, *casters])


def _rear_m(spec: PlantSpec) -> float:
    """The rearmost wheel's axle, trailing, ahead of the drive axle (negative behind it)."""
    return min([0.0, *(pair.swivel_x_m - pair.trail_m for pair in spec.casters)])


def climbs(setup: Setup, rise_m: float, run_up_m: float) -> float:
    """1 when it comes up a kerb square on with all its wheels, 0 when it does not.

    Args:
        setup: The chair; it is told to drive at its full speed.
        rise_m: Height of the kerb.
        run_up_m: Way of the foremost wheel to the kerb, from rest; 0 to begin with the wheel at it.
    """
    with Yard(setup, step_street(rise_m)) as yard:
        spec = yard.chair.spec
        yard.place(FACE_X_M - _front_m(spec) - max(run_up_m, _TOUCHING_M))
        up_m = FACE_X_M + 0.3 - _rear_m(spec)
        yard.drive(FORWARD, 9.0, lambda state: float(state.p_WB_m[0]) > up_m)
        end = yard.drive(NEUTRAL, 2.5).states[-1].p_WB_m
    return float(end[0] > FACE_X_M and abs(end[2] - rise_m) < _LEVEL_M)


def kerb_peak_mps2(setup: Setup, rise_m: float) -> float:
    """The largest low-passed acceleration over a step up (or down) met square on at full speed, mean of six runs."""
    return _mean_peak_mps2(setup, step_street(rise_m))


def wall_peak_mps2(setup: Setup) -> float:
    """The largest low-passed acceleration as it drives into a wall at full speed, mean of six runs."""
    return _mean_peak_mps2(setup, step_street(_WALL_M, ClassId.BUILDING))


def _mean_peak_mps2(setup: Setup, street: StreetMesh) -> float:
    """Mean over runs whose starts lie a fraction of a step's way apart.

    Where within a step a wheel meets an edge is chance, and moves a single peak by up to a fifth.
    """
    with Yard(setup, street) as yard:
        spec, speed = yard.chair.spec, setup.chair.v_max_mps
        start_m, beyond_m = FACE_X_M - _front_m(spec) - _RUN_M, FACE_X_M + 0.8 - _rear_m(spec)
        peaks = []
        for run in range(_RUNS):
            yard.place(start_m - run / _RUNS * speed * _LONGEST_STEP_S)
            seconds = 3.0 + (beyond_m - start_m) / speed
            peaks.append(yard.drive(FORWARD, seconds, lambda state: float(state.p_WB_m[0]) > beyond_m).peak_mps2)
    return float(np.mean(peaks))


def driving_peak_mps2(setup: Setup) -> float:
    """The largest low-passed acceleration of ordinary driving: off, straight, full turn, to a stop."""
    with Yard(setup) as yard:
        yard.drive(NEUTRAL, 1.0)  # it was put down from a millimetre
        drives = [yard.drive(FORWARD, 4.0), yard.drive(Joystick(-1.0, 1.0), 3.0), yard.drive(NEUTRAL, 3.0)]
    return max(ride.peak_mps2 for ride in drives)


def tips_off(setup: Setup, drop_m: float, approach_rad: float) -> float:
    """1 when it falls on its side as it drives off a kerb, 0 when it stays upright.

    Args:
        setup: The chair.
        drop_m: Height of the kerb.
        approach_rad: Angle between its way and the kerb's edge.
    """
    heading = 0.5 * math.pi - approach_rad
    with Yard(setup, step_street(-drop_m)) as yard:
        outline = yard.chair.spec.outline
        ahead, aside = outline.middle_x_m + 0.5 * outline.length_m, 0.5 * outline.width_m
        gap = 0.1 + ahead * math.cos(heading) + aside * math.sin(heading)  # of the corner that comes first
        away = 0.5 + setup.chair.v_max_mps  # to reach full speed before the edge
        x = FACE_X_M - gap - away * math.cos(heading)
        yard.place(x, -away * math.sin(heading), heading)
        ride = yard.drive(FORWARD, 4.0 + (away + 1.0 / math.sin(approach_rad)) / setup.chair.v_max_mps, _lies)
    return float(_lies(ride.states[-1]))


def _lies(state: PlantState) -> bool:
    return bool(np.cos(state.roll_rad) * np.cos(state.pitch_rad) < _TIPPED)
