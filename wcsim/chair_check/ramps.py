"""Trials on a twisted ramp, as a kerb lowered at a corner has it: what the wheels carry, how it stops and turns."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Final

from wcsim.chair_check.rig import NEUTRAL, Rig, grid_street
from wcsim.chair_check.row import Setup, Trial
from wcsim.core.frames import deg, rad
from wcsim.physics.wheelchair.drive_controller import stopping_distance_m
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec
from wcsim.types import Joystick

_TWIST_RAD: Final = rad(3.0)  # over the wheelbase
_FALL_RAD: Final = rad(4.0)  # of the ramp, 1 in 14
_STEADY: Final = Joystick(0.0, 0.5)
_CELL_M: Final = 0.1
_HALF_M: Final = 6.0
_WIDE_M: Final = 2.0
_START_M: Final = 4.0  # ahead of the middle
_RUN_S: Final = 3.0
_PHASES: Final = 6
_TURN_S: Final = 1.5
_STOP_S: Final = 4.0
_WEIGH_S: Final = 0.5

Height = Callable[[float, float], float]
_LEAST_LOAD: Final = 0.2  # of the static load
_RAMP: Final = f"ramp of {deg(_FALL_RAD):.0f} degrees, twisted by {deg(_TWIST_RAD):.0f} over the wheelbase"


def ramp_trials(_setup: Setup) -> Iterator[Trial]:
    """The rows of one plant."""
    yield Trial(
        name="twisted_ramp_load",
        unit="",
        bound="wcsim",
        low=_LEAST_LOAD,
        high=1.2,
        method=f"least load of a drive wheel at rest on a {_RAMP}, up and down, both ways, relative to level ground",
        source="both drive wheels keep a fifth of their load",
        measure=_least_load_share,
    )
    yield Trial(
        name="twisted_ramp_stop",
        unit="",
        bound="wcsim",
        low=0.8,
        high=1.25,
        method=f"longest stopping distance from half stick, down a {_RAMP}, both ways, relative to level ground",
        source="jerk-limited v2/2a + v a/2j, 25 % more for the slope",
        measure=_stopping_share,
    )
    yield Trial(
        name="twisted_ramp_turn",
        unit="",
        bound="wcsim",
        low=0.75,
        high=1.25,
        method=f"least turn in 1.5 s, stick to either side, down a {_RAMP}, both ways, relative to level ground",
        source="requested turn, within 25 %",
        measure=_turned_share,
    )


def _least_load_share(setup: Setup) -> float:
    """The least load of a drive wheel at rest on a twisted ramp, facing up or down it, over that on level ground."""
    level = _loads_N(setup, lambda _x, _y: 0.0)
    least = [
        load / level[name]
        for twist in (1.0, -1.0)
        for fall in (_FALL_RAD, -_FALL_RAD)
        for name, load in _loads_N(setup, _saddle(setup, twist, fall)).items()
    ]
    return min(least)


def _stopping_share(setup: Setup) -> float:
    """Way to a stop from a steady speed down a ramp that twists to and fro, at its worst, over that on a level."""
    return max(_stop_m(setup, phase) for phase in range(_PHASES)) / _level_stop_m(setup)


def _turned_share(setup: Setup) -> float:
    """The least turn in 1.5 s down a ramp that twists to and fro, over that on a level; below 0 if the other way."""
    shares = []
    for stick in (Joystick(-0.5, 0.3), Joystick(0.5, 0.3)):
        level = _turned_rad(setup, stick, lambda _x, _y: 0.0)
        shares += [_turned_rad(setup, stick, _wave(setup, phase)) / level for phase in range(_PHASES)]
    return min(shares)


def _wheelbase_m(spec: PlantSpec) -> float:
    """From the drive axle to the swivels farthest away from it."""
    return max(abs(pair.swivel_x_m) for pair in spec.casters)


def _saddle(setup: Setup, twist: float, fall_rad: float) -> Height:
    """A ramp whose cross slope grows with x, level across below the drive axle."""
    per_m = twist * _TWIST_RAD / _wheelbase_m(plant_spec(setup.chair))
    return lambda x, y: -math.tan(fall_rad) * x + y * math.tan(per_m * x)


def _wave(setup: Setup, phase: int) -> Height:
    """A ramp that falls along x and twists to and fro, nowhere more than the saddle."""
    per_m = 1.0 / _wheelbase_m(plant_spec(setup.chair))
    shift = 2.0 * math.pi * phase / _PHASES
    return lambda x, y: -math.tan(_FALL_RAD) * x + y * math.tan(_TWIST_RAD * math.sin(per_m * x + shift))


def _loads_N(setup: Setup, height: Height) -> dict[str, float]:
    """Mean loads of the drive wheels at rest in the middle."""
    with Rig(setup, grid_street(height, _WIDE_M, _WIDE_M, 0.5 * _CELL_M)) as rig:
        rig.place(0.0)
        rig.drive(NEUTRAL, 2.0)
        steps = round(_WEIGH_S * setup.hz)
        sums = {"wheel_l": 0.0, "wheel_r": 0.0}
        for _ in range(steps):
            rig.substep()
            loads = rig.loads_N()
            for name in sums:
                sums[name] += loads.get(name, 0.0) / steps
        rig.chair.end_tick(None)
    return sums


def _stop_m(setup: Setup, phase: int) -> float:
    height = _wave(setup, phase)
    with Rig(setup, grid_street(height, _HALF_M, _WIDE_M, _CELL_M)) as rig:
        rig.place(-_START_M, z_m=height(-_START_M, 0.0))
        start = rig.drive(_STEADY, _RUN_S).states[-1]
        end = rig.drive(NEUTRAL, _STOP_S).states[-1]
    return math.dist(start.p_WB_m, end.p_WB_m)


def _level_stop_m(setup: Setup) -> float:
    with Rig(setup) as rig:
        rig.place(-_START_M)
        v_mps = float(rig.drive(_STEADY, _RUN_S).speed_mps[-1])
    return stopping_distance_m(v_mps, setup.chair.decel_mps2, setup.chair.jerk_mps3)


def _turned_rad(setup: Setup, stick: Joystick, height: Height) -> float:
    with Rig(setup, grid_street(height, _HALF_M, _WIDE_M, _CELL_M)) as rig:
        rig.place(-_START_M, z_m=height(-_START_M, 0.0))
        states = [*rig.drive(_STEADY, _RUN_S).states[-1:], *rig.drive(stick, _TURN_S).states]
    return sum(math.remainder(after.yaw_rad - before.yaw_rad, math.tau) for before, after in pairwise(states))
