"""The drive law of `core/joystick.py`, fitted to recorded drives of a chair.

It also measures how well law and plant repeat such drives.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np

from wcsim.chair_check.rig import ChairTestRig, make_heightfield_street
from wcsim.chair_check.row import TICK_S, TrialSetup
from wcsim.chair_check.stick_drives import STEP_S, RecordedDrive
from wcsim.config import ChairConfig
from wcsim.core import seeding
from wcsim.core.jit import compile_exact_kernel
from wcsim.core.joystick import advance_drive, drive_limits_from_chair, shape_joystick
from wcsim.types import F64, Joystick

# The numbers of the law (11,): the limits of `core/joystick.py`, and these.
_DEADBAND, _EXPONENT, _DELAY = 8, 9, 10
# Those that are fitted; hardly anybody drives backwards for long.
DELAY_S: Final = "delay_s"
# Least, usual and most; what these drives reach takes the place of 0.
_NUMBERS: Final = {
    "v_max_mps": (0.11, 0.0, 5.0),
    "accel_mps2": (0.05, 0.6, 6.0),
    "decel_mps2": (0.05, 1.5, 6.0),
    "jerk_mps3": (0.5, 5.0, 50.0),
    "yaw_rate_max_radps": (0.05, 0.0, 4.0),
    "yaw_accel_radps2": (0.05, 2.0, 20.0),
    "yaw_slowdown_s_per_m": (0.001, 0.1, 5.0),
    "deadband": (0.001, 0.05, 0.5),
    "shape_exponent": (1.0, 1.1, 3.0),
    DELAY_S: (0.001, 0.15, 1.0),
}
_LEAST, _USUAL, _MOST = np.array(list(_NUMBERS.values())).T
# A fit starts with each: jerk and deceleration together have several valleys.
_JERKS_MPS3: Final = (3.0, 10.0, 30.0)
_PULL: Final = 0.05  # of the misfit is what a number costs that is e times the usual one
_IS_JERK: Final = np.array([name == "jerk_mps3" for name in _NUMBERS])
# Of a number, for slopes: less would follow the steps in which a drive of samples answers.
_NUDGE: Final = 0.01
_DRAWS: Final = 100
_SPARE_M: Final = 10.0  # of the yard, beyond where full speed leads


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionErrors:
    """How far motions are from the measured ones."""

    speed_rms_mps: float
    turn_rms_radps: float
    speed_explained: float  # share of the variance
    turn_explained: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveLawFit:
    """The numbers of a chair's controller, and their 95 % intervals; one drive gives none."""

    values: dict[str, float]  # by their names in [chair]; and delay_s, from the stick to the wheels
    intervals: dict[str, tuple[float, float]]


def fit_drive_law(drives: Sequence[RecordedDrive], draws: int = _DRAWS) -> DriveLawFit:
    """Fit by least squares, speed and turn rate weighted by their variance.

    The intervals come from drives that are drawn anew.

    Args:
        drives: At least one, with turns.
        draws: How often the drives are drawn anew; none: without intervals.
    """
    # Logarithms of the numbers (10,) that a chair has which reaches what these drives reach.
    known = _USUAL.copy()
    motions = np.abs(np.concatenate([drive.motion for drive in drives]))
    known[known == 0.0] = np.percentile(motions, 99.0, axis=0)
    usual = np.log(np.clip(known, _LEAST, _MOST))
    starts = [np.where(_IS_JERK, math.log(jerk), usual) for jerk in _JERKS_MPS3]
    # Drives hardly separate jerk and deceleration: of all that fit, the pull finds the most usual.
    pull = math.sqrt(_PULL * min(_solved(drives, start, usual, 0.0)[1] for start in starts))
    found = min(
        (_solved(drives, start, usual, pull) for start in starts), key=lambda pair: pair[1]
    )[0]
    rng = seeding.make_rng(0, "drives drawn anew")
    drawn = [found]
    for _ in range(draws if len(drives) > 1 else 0):
        chosen = [drives[k] for k in rng.integers(len(drives), size=len(drives)).tolist()]
        drawn.append(_solved(chosen, found, usual, pull)[0])
    low, high = np.exp(np.percentile(drawn, (2.5, 97.5), axis=0)).tolist()
    intervals = (
        dict(zip(_NUMBERS, zip(low, high, strict=True), strict=True)) if len(drawn) > 1 else {}
    )
    return DriveLawFit(
        values=dict(zip(_NUMBERS, np.exp(found).tolist(), strict=True)), intervals=intervals
    )


def _solved(
    drives: Sequence[RecordedDrive], start: F64, usual: F64, pull: float
) -> tuple[F64, float]:
    """Logarithms of the numbers (10,) that fit best near a start, and the half sum of squares."""
    from scipy.optimize import least_squares  # takes a while to load

    motion = np.concatenate([drive.motion for drive in drives])
    scale = np.maximum(motion.std(axis=0), 1e-3)

    def misses(logs: F64) -> F64:
        made = np.concatenate(
            simulate_drive_law(drives, dict(zip(_NUMBERS, np.exp(logs).tolist(), strict=True)))
        )
        return np.concatenate([((made - motion) / scale).ravel(), pull * (logs - usual)])

    def slopes(logs: F64) -> F64:
        steps = _NUDGE * np.eye(len(logs))
        return np.stack(
            [(misses(logs + step) - misses(logs - step)) / (2.0 * _NUDGE) for step in steps], axis=1
        )

    low, high = np.log(_LEAST), np.log(_MOST)
    inside = np.clip(start, low + _NUDGE, high - _NUDGE)
    solved: Any = least_squares(
        misses, inside, slopes, (low, high), max_nfev=40, xtol=1e-4, ftol=1e-5
    )
    return solved.x, float(solved.cost)


def simulate_drive_law(drives: Sequence[RecordedDrive], values: Mapping[str, float]) -> list[F64]:
    """Speeds and turn rates (n, 2) by the law alone, of numbers as in a `DriveLawFit`.

    Their samples are those of the drives.
    """
    chair = ChairConfig.model_construct(**cast(Mapping[str, Any], values))
    numbers = np.array(
        [*drive_limits_from_chair(chair), chair.deadband, chair.shape_exponent, values[DELAY_S]]
    )
    return [_followed(drive.stick, numbers) for drive in drives]


@compile_exact_kernel
def _followed(stick: F64, numbers: F64) -> F64:
    """Speeds and turn rates (n, 2) of a drive (n, 2) that begins at rest."""
    out = np.empty(stick.shape)
    whole = int(numbers[_DELAY] / STEP_S)
    part = numbers[_DELAY] / STEP_S - whole
    v = w = a = 0.0
    for at in range(len(stick)):
        new, old = stick[max(0, at - whole)], stick[max(0, at - whole - 1)]
        # Between two samples, so that the delay has a slope.
        x, y = new[0] + part * (old[0] - new[0]), new[1] + part * (old[1] - new[1])
        # What this sample causes shows in the next one.
        out[at, 0], out[at, 1] = v, w
        sx, sy = shape_joystick(x, y, numbers[_DEADBAND], numbers[_EXPONENT])
        v, w, a = advance_drive(v, w, a, sx, sy, numbers, STEP_S)
    return out


def simulate_plant_motion(drive: RecordedDrive, setup: TrialSetup) -> F64:
    """Speeds and turn rates (n, 2) of the chair in PyBullet on a level yard.

    It gets the stick once a tick. The next sample after a tick's beginning is the first that may
    show what the tick did.
    """
    ticks = round(TICK_S / STEP_S)
    found = [(0.0, 0.0)]
    half_m = _SPARE_M + setup.chair.v_max_mps * STEP_S * len(drive.stick)
    with ChairTestRig(
        setup, make_heightfield_street(lambda x, y: 0.0, half_m, half_m, 2.0 * half_m)
    ) as rig:
        for x, y in drive.stick[::ticks].tolist():
            state = rig.drive(Joystick(x, y), TICK_S).states[-1]
            found.append((float(state.v_B_mps[0]), float(state.w_B_radps[2])))
    at, rows = np.arange(len(drive.stick)) / ticks, np.array(found)
    return np.stack([np.interp(at, np.arange(len(rows)), rows[:, k]) for k in (0, 1)], axis=1)


def delay_motion(motion: F64, delay_s: float) -> F64:
    """The motion of a chair that gets the same stick so much later: first it stands."""
    samples = round(delay_s / STEP_S)
    return np.concatenate([np.zeros((samples, 2)), motion])[: len(motion)]


def compute_motion_errors(drives: Sequence[RecordedDrive], motions: Sequence[F64]) -> MotionErrors:
    """What lies between motions (n, 2) and those measured in all drives together."""
    measured = np.concatenate([drive.motion for drive in drives])
    missed = np.mean((np.concatenate(list(motions)) - measured) ** 2, axis=0)
    rms = np.sqrt(missed).tolist()
    explained = (1.0 - missed / np.maximum(measured.var(axis=0), 1e-12)).tolist()
    return MotionErrors(
        speed_rms_mps=rms[0],
        turn_rms_radps=rms[1],
        speed_explained=explained[0],
        turn_explained=explained[1],
    )
