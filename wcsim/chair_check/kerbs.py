"""Kerbs and ramps: what a chair climbs and what stops it, what it feels, and when it falls off one.

A twisted ramp is as a kerb lowered at a corner has it: what the wheels carry on it, how the chair
stops and turns.
"""

import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np

from wcsim.chair_check import driving
from wcsim.chair_check.rig import (
    FACE_X_M,
    FORWARD,
    NEUTRAL,
    ChairTestRig,
    make_heightfield_street,
    make_step_street,
)
from wcsim.chair_check.row import TrialSetup, TrialSpec, make_trial_spec
from wcsim.config import RewardConfig
from wcsim.core.frames import deg2rad, rad2deg
from wcsim.physics.wheelchair.drive_controller import stopping_distance_m
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec
from wcsim.types import ClassId, Joystick, PlantState

HeightAt = Callable[[float, float], float]
"""Height of the ground at a place x, y."""

RUN_UP_M: Final = 0.5
# The rows expect the peaks that these plants had when they were designed.
_PLANTS_OF_PEAKS: Final = ("rwd", "mwd")
# What the sensor shows at most, 16 g.
_SENSOR_RANGE_MPS2: Final = 157.0
_TOUCHING_M: Final = 0.002
_LEVEL_M: Final = 0.005
# To reach a steady speed before a kerb.
_APPROACH_M: Final = 3.3
_WALL_M: Final = 2.0
_RUNS_PER_PEAK: Final = 6
_LONGEST_STEP_S: Final = 1.0 / 120.0

# Falls off a kerb, in the order of Erickson et al. 2016 (JNER 13:20).
_OFF_KERB_MPS: Final = 1.5
_SHALLOW_DEG: Final = 25
_STEEP_DEG: Final = 60
# Below this upright part of its z a chair lies on its side.
_LEAST_UPRIGHT: Final = 0.5

# Twisted ramps.
# Twist over the wheelbase.
_TWIST_RAD: Final = deg2rad(3.0)
# Fall of the ramp, 1 in 14.
_RAMP_RAD: Final = deg2rad(4.0)
_RAMP: Final = (
    f"ramp of {rad2deg(_RAMP_RAD):.0f} degrees, "
    f"twisted by {rad2deg(_TWIST_RAD):.0f} over the wheelbase"
)
_STEADY_STICK: Final = Joystick(0.0, 0.5)
_CELL_M: Final = 0.1
_HALF_LENGTH_M: Final = 6.0
_HALF_WIDTH_M: Final = 2.0
# From the start to the middle of the ramp.
_START_M: Final = 4.0
_RUN_S: Final = 3.0
_PHASES: Final = 6
_TURN_S: Final = 1.5
_STOP_S: Final = 4.0


def make_kerb_trials(setup: TrialSetup) -> Iterator[TrialSpec]:
    """The rows of one plant."""
    spec = plant_spec(setup.chair)
    yield from _climbs(spec)
    yield from _events(spec)
    # These rows show how another chair compares, and judge nothing.
    has_peaks = setup.chair.plant in _PLANTS_OF_PEAKS
    yield from _peaks(judged=has_peaks)
    yield from _falls(spec, judged=has_peaks or _has_no_rear_casters(spec))


def make_twisted_ramp_trials(_setup: TrialSetup) -> Iterator[TrialSpec]:
    """The rows of one plant."""
    yield make_trial_spec("twisted_ramp_load", _least_load_share, ramp=_RAMP)
    yield make_trial_spec("twisted_ramp_stop", _stopping_share, ramp=_RAMP)
    yield make_trial_spec("twisted_ramp_turn", _turned_share, ramp=_RAMP)


def _climbs(spec: PlantSpec) -> Iterator[TrialSpec]:
    declared = spec.climbs
    starts = (("standstill", 0.0, declared.standstill_m), ("run_up", RUN_UP_M, declared.run_up_m))
    for start, run_up_m, climbed_m in starts:
        for rise_m in sorted({*climbed_m, *declared.refused_m}):
            measure = partial(_kerb_climbed, rise_m=rise_m, run_up_m=run_up_m)
            up = 1.0 if rise_m in climbed_m else 0.0
            yield make_trial_spec(
                "kerb_{mm}mm_{start}",
                measure,
                up,
                mm=round(1000 * rise_m),
                start=start,
                run_up=run_up_m,
            )


def _events(spec: PlantSpec) -> Iterator[TrialSpec]:
    """Driving, kerb and wall: the penalty on acceleration must tell them apart."""
    low, high = RewardConfig().accel_window_mps2
    window = f"penalty window {low:g} to {high:g} m/s2"
    yield make_trial_spec("event_driving", _driving_peak_mps2, low, window=window)
    yield make_trial_spec("event_cruise", driving.measure_cruise_peak_accel_mps2, window=window)
    # Sprung casters take a kerb softly, so a plant with them meets it faster.
    speed = 1.67 if any(pair.arm is not None for pair in spec.casters) else 1.0
    over = partial(_step_peak_mps2, rise_m=0.04)
    yield make_trial_spec(
        "event_kerb_40mm", over, span=(low, high), speed_mps=speed, speed=speed, window=window
    )
    yield make_trial_spec(
        "event_wall_6kmh",
        _wall_peak_mps2,
        span=(high, _SENSOR_RANGE_MPS2),
        speed_mps=1.67,
        window=window,
    )


def _peaks(*, judged: bool) -> Iterator[TrialSpec]:
    # A faster chair is over the lowest kerb within two steps of 1/120 s, and its peak depends on
    # the step.
    kerbs = ((0.02, 0.8, 9.0, 20.0), (-0.06, 1.0, 12.0, 40.0), (-0.12, 1.0, 25.0, 46.0))
    for rise_m, speed, low, high in kerbs:
        yield make_trial_spec(
            "peak_{what}_{mm:.0f}mm",
            partial(_step_peak_mps2, rise_m=rise_m),
            span=(low, high),
            speed_mps=speed,
            judged=judged,
            what="kerb" if rise_m > 0.0 else "drop",
            mm=1000 * abs(rise_m),
            speed=speed,
        )
    yield make_trial_spec("peak_wall_1mps", _wall_peak_mps2, speed_mps=1.0, judged=judged)


def _falls(spec: PlantSpec, *, judged: bool) -> Iterator[TrialSpec]:
    # Higher kerbs and shallower approaches tip.
    cases = [
        (0.12, _SHALLOW_DEG, 0.0),
        (0.12, _STEEP_DEG, 0.0),
        (0.20, _SHALLOW_DEG, 0.0),
        (0.20, _STEEP_DEG, 0.0),
        (0.30, 5, 1.0),
        (0.30, _SHALLOW_DEG, 1.0),
        (0.30, _STEEP_DEG, 0.0),
    ]
    if not _has_no_rear_casters(spec):
        cases.remove((0.20, _SHALLOW_DEG, 0.0))
    for drop_m, angle_deg, tips in cases:
        yield make_trial_spec(
            "falls_off_{cm}cm_at_{angle}deg",
            partial(_tips_off, drop_m=drop_m, approach_rad=deg2rad(angle_deg)),
            tips,
            speed_mps=_OFF_KERB_MPS,
            judged=judged,
            cm=round(100 * drop_m),
            angle=angle_deg,
            speed=_OFF_KERB_MPS,
        )


def _has_no_rear_casters(spec: PlantSpec) -> bool:
    """Whether all casters are ahead of the drive wheels, as in the experiments off kerbs."""
    return all(pair.swivel_x_m > 0.0 for pair in spec.casters)


def _foremost_x_m(spec: PlantSpec) -> float:
    """The foremost point of all wheels, casters trailing, ahead of the drive axle."""
    casters = [pair.swivel_x_m - pair.trail_m + pair.radius_m for pair in spec.casters]
    return max([spec.wheel.radius_m, *casters])


def _rear_axle_x_m(spec: PlantSpec) -> float:
    """The rearmost wheel's axle, trailing, ahead of the drive axle (negative behind it)."""
    return min([0.0, *(pair.swivel_x_m - pair.trail_m for pair in spec.casters)])


def _kerb_climbed(setup: TrialSetup, rise_m: float, run_up_m: float) -> float:
    """1 when it comes up a kerb square on with all its wheels, 0 when it does not.

    Args:
        setup: The chair; it drives at its full speed.
        rise_m: Height of the kerb.
        run_up_m: Way of the foremost wheel to the kerb, from rest; 0 to begin with the wheel at it.
    """
    with ChairTestRig(setup, make_step_street(rise_m)) as rig:
        spec = rig.chair.spec
        rig.place(FACE_X_M - _foremost_x_m(spec) - max(run_up_m, _TOUCHING_M))
        up_m = FACE_X_M + 0.3 - _rear_axle_x_m(spec)
        rig.drive(FORWARD, 9.0, lambda state: float(state.p_WB_m[0]) > up_m)
        end = rig.drive(NEUTRAL, 2.5).states[-1].p_WB_m
    return float(end[0] > FACE_X_M and abs(end[2] - rise_m) < _LEVEL_M)


def _step_peak_mps2(setup: TrialSetup, rise_m: float, face: ClassId = ClassId.KERB) -> float:
    """The largest low-passed acceleration as it meets a step up (or down) square on at full speed.

    It is the mean over runs whose starts lie a fraction of a step's way apart.
    """
    # Where within a step a wheel meets an edge is chance, and moves a single peak by up to a fifth.
    with ChairTestRig(setup, make_step_street(rise_m, face)) as rig:
        spec = rig.chair.spec
        speed_mps = setup.chair.v_max_mps
        start_m = FACE_X_M - _foremost_x_m(spec) - _APPROACH_M
        beyond_m = FACE_X_M + 0.8 - _rear_axle_x_m(spec)
        seconds = 3.0 + (beyond_m - start_m) / speed_mps
        peaks = []
        for run in range(_RUNS_PER_PEAK):
            rig.place(start_m - run / _RUNS_PER_PEAK * speed_mps * _LONGEST_STEP_S)
            ride = rig.drive(FORWARD, seconds, lambda state: float(state.p_WB_m[0]) > beyond_m)
            peaks.append(ride.peak_mps2)
    return float(np.mean(peaks))


def _wall_peak_mps2(setup: TrialSetup) -> float:
    return _step_peak_mps2(setup, _WALL_M, ClassId.BUILDING)


def _driving_peak_mps2(setup: TrialSetup) -> float:
    """The largest low-passed acceleration of driving: off, straight, full turn, to a stop."""
    with ChairTestRig(setup) as rig:
        # The chair was put down from a millimetre.
        rig.drive(NEUTRAL, 1.0)
        drives = [
            rig.drive(FORWARD, 4.0),
            rig.drive(Joystick(-1.0, 1.0), 3.0),
            rig.drive(NEUTRAL, 3.0),
        ]
    return max(ride.peak_mps2 for ride in drives)


def _tips_off(setup: TrialSetup, drop_m: float, approach_rad: float) -> float:
    """1 when it falls on its side as it drives off a kerb, 0 when it stays upright.

    Args:
        setup: The chair.
        drop_m: Height of the kerb.
        approach_rad: Angle between its way and the kerb's edge.
    """
    heading = 0.5 * math.pi - approach_rad
    with ChairTestRig(setup, make_step_street(-drop_m)) as rig:
        outline = rig.chair.spec.outline
        ahead_m = outline.middle_x_m + 0.5 * outline.length_m
        aside_m = 0.5 * outline.width_m
        # The first corner starts so far from the edge that the chair reaches its full speed.
        gap_m = 0.1 + ahead_m * math.cos(heading) + aside_m * math.sin(heading)
        run_m = 0.5 + setup.chair.v_max_mps
        x_m = FACE_X_M - gap_m - run_m * math.cos(heading)
        rig.place(x_m, -run_m * math.sin(heading), heading)
        seconds = 4.0 + (run_m + 1.0 / math.sin(approach_rad)) / setup.chair.v_max_mps
        ride = rig.drive(FORWARD, seconds, _lies_on_side)
    return float(_lies_on_side(ride.states[-1]))


def _lies_on_side(state: PlantState) -> bool:
    return bool(np.cos(state.roll_rad) * np.cos(state.pitch_rad) < _LEAST_UPRIGHT)


def _least_load_share(setup: TrialSetup) -> float:
    """The least load of a drive wheel at rest on a twisted ramp, over that on level ground."""
    level = _loads_N(setup, lambda _x, _y: 0.0)
    least = [
        load / level[name]
        for twist in (1.0, -1.0)
        for fall in (_RAMP_RAD, -_RAMP_RAD)
        for name, load in _loads_N(setup, _twisted_ramp(setup, twist, fall)).items()
    ]
    return min(least)


def _stopping_share(setup: TrialSetup) -> float:
    """The longest way to a stop down a ramp that twists to and fro, over that on a level."""
    return max(_ramp_stop_m(setup, phase) for phase in range(_PHASES)) / _level_stop_m(setup)


def _turned_share(setup: TrialSetup) -> float:
    """The least turn in 1.5 s down a ramp that twists to and fro, over that on a level.

    Below 0 if it turns the other way.
    """
    shares = []
    for stick in (Joystick(-0.5, 0.3), Joystick(0.5, 0.3)):
        level = _turned_rad(setup, stick, lambda _x, _y: 0.0)
        shares += [
            _turned_rad(setup, stick, _wavy_ramp(setup, phase)) / level for phase in range(_PHASES)
        ]
    return min(shares)


def _wheelbase_m(spec: PlantSpec) -> float:
    """From the drive axle to the swivels farthest away from it."""
    return max(abs(pair.swivel_x_m) for pair in spec.casters)


def _twisted_ramp(setup: TrialSetup, twist: float, fall_rad: float) -> HeightAt:
    """A ramp whose cross slope grows with x, level across below the drive axle."""
    per_m = twist * _TWIST_RAD / _wheelbase_m(plant_spec(setup.chair))
    return lambda x, y: -math.tan(fall_rad) * x + y * math.tan(per_m * x)


def _wavy_ramp(setup: TrialSetup, phase: int) -> HeightAt:
    """A ramp that falls along x and twists to and fro, nowhere more than the saddle."""
    per_m = 1.0 / _wheelbase_m(plant_spec(setup.chair))
    shift = 2.0 * math.pi * phase / _PHASES
    return lambda x, y: (
        -math.tan(_RAMP_RAD) * x + y * math.tan(_TWIST_RAD * math.sin(per_m * x + shift))
    )


def _loads_N(setup: TrialSetup, height: HeightAt) -> dict[str, float]:
    """Mean loads of the drive wheels at rest in the middle."""
    with ChairTestRig(
        setup, make_heightfield_street(height, _HALF_WIDTH_M, _HALF_WIDTH_M, 0.5 * _CELL_M)
    ) as rig:
        loads = rig.weigh_N()
    return {name: loads.get(name, 0.0) for name in ("wheel_l", "wheel_r")}


def _ramp_stop_m(setup: TrialSetup, phase: int) -> float:
    height = _wavy_ramp(setup, phase)
    with ChairTestRig(
        setup, make_heightfield_street(height, _HALF_LENGTH_M, _HALF_WIDTH_M, _CELL_M)
    ) as rig:
        rig.place(-_START_M, z_m=height(-_START_M, 0.0))
        start = rig.drive(_STEADY_STICK, _RUN_S).states[-1]
        end = rig.drive(NEUTRAL, _STOP_S).states[-1]
    return math.dist(start.p_WB_m, end.p_WB_m)


def _level_stop_m(setup: TrialSetup) -> float:
    with ChairTestRig(setup) as rig:
        rig.place(-_START_M)
        v_mps = float(rig.drive(_STEADY_STICK, _RUN_S).speed_mps[-1])
    return stopping_distance_m(v_mps, setup.chair.decel_mps2, setup.chair.jerk_mps3)


def _turned_rad(setup: TrialSetup, stick: Joystick, height: HeightAt) -> float:
    with ChairTestRig(
        setup, make_heightfield_street(height, _HALF_LENGTH_M, _HALF_WIDTH_M, _CELL_M)
    ) as rig:
        rig.place(-_START_M, z_m=height(-_START_M, 0.0))
        states = [*rig.drive(_STEADY_STICK, _RUN_S).states[-1:], *rig.drive(stick, _TURN_S).states]
    return sum(
        math.remainder(after.yaw_rad - before.yaw_rad, math.tau)
        for before, after in pairwise(states)
    )
