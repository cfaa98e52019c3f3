"""The table of a plant: all its trials, done one by one or in a pool of processes.

Rows of the twisted ramp: grip of both drive wheels, stopping and steering.

Rows of static stability (ISO 7176-1): tilts at which the chair tips, and that they fall with its height.

Rows of the scales: mass, balance, inertia, losses and grip against what the parameter file declares.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Final

from wcsim.chair_check import ramps, scales
from wcsim.chair_check.declared import FORWARD_DOWN, LEFT_DOWN, REAR_DOWN, inertia_kgm2, stand
from wcsim.chair_check.row import Row, Setup, Trial, measured
from wcsim.chair_check.rows.driving import driving_trials
from wcsim.chair_check.rows.kerb import kerb_trials
from wcsim.chair_check.static_balance import Vec2, loads_N
from wcsim.chair_check.tilt_table import expected_tip_rad, measured_tip_rad
from wcsim.core.frames import deg
from wcsim.errors import ConfigError
from wcsim.physics.engine import GRAVITY_MPS2
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec

_FILE = "parameter file"
_COAST_MPS = 1.0
_AXES = ("roll", "pitch", "yaw")


def _weight_trials(setup: Setup) -> Iterator[Trial]:
    """The rows of one plant."""
    spec = plant_spec(setup.chair)
    yield from _loads(spec)
    yield from _inertias(spec)
    yield from _losses(spec)


def _loads(spec: PlantSpec) -> Iterator[Trial]:
    yield Trial(
        name="mass",
        unit="kg",
        bound="file",
        low=0.995 * spec.whole_kg,
        high=1.005 * spec.whole_kg,
        method="normal loads of all wheels at rest, divided by 9.81 m/s2",
        source=_FILE,
        measure=scales.mass_kg,
    )
    loads = loads_N(stand(spec))
    share = sum(load for name, load in loads.items() if name.startswith("wheel")) / sum(loads.values())
    yield Trial(
        name="drive_wheel_share",
        unit="",
        bound="file",
        low=share - 0.02,
        high=share + 0.02,
        method="share of the weight that rests on the drive wheels",
        source="statics of masses, springs and contact points",
        measure=scales.drive_wheel_share,
    )


def _inertias(spec: PlantSpec) -> Iterator[Trial]:
    for axis, inertia in enumerate(inertia_kgm2(spec)):
        yield Trial(
            name=f"inertia_{_AXES[axis]}",
            unit="kg m2",
            bound="file",
            low=0.98 * float(inertia),
            high=1.02 * float(inertia),
            method="floating with joints held: 20 Nm for 0.5 s, divided by the resulting rate",
            source=_FILE + ": inertia of all parts, parallel axes",
            measure=partial(scales.turning_inertia_kgm2, axis=axis),
        )


def _losses(spec: PlantSpec) -> Iterator[Trial]:
    yield Trial(
        name="turning_loss",
        unit="1/s",
        bound="file",
        low=-0.001,
        high=0.001,
        method="share of its yaw rate that it loses in one second while floating",
        source="no damping is declared",
        measure=scales.turning_loss_per_s,
    )
    yield Trial(
        name="coasting_loss",
        unit="m/s2",
        bound="file",
        low=-0.01,
        high=0.01,
        method="slowing down on level ground from 1 m/s with the motors off, mean of 2 s",
        source="no rolling resistance is declared",
        measure=scales.coasting_mps2,
        speed_mps=_COAST_MPS,
    )
    chair = stand(spec)
    loads = loads_N(chair)
    friction = {foot.name: foot.friction for foot in chair.feet}
    grip = sum(load * friction[name] for name, load in loads.items()) / (spec.whole_kg * GRAVITY_MPS2)
    yield Trial(
        name="grip",
        unit="",
        bound="file",
        low=0.95 * grip,
        high=1.05 * grip,
        method="pull along the ground at which it slides with locked wheels, divided by its weight",
        source=_FILE + ": friction of each wheel, weighted with its load",
        measure=scales.grip,
    )


_COM_HEIGHTS_M: Final = (0.50, 0.60)
_TOLERANCE_DEG: Final = 1.0
_LEAST_LEFT, _MOST_LEFT = 0.5, 0.98
_METHOD: Final = (
    "tilt table at 0.2 deg/s, brakes on, casters at their worst angle (sideways on a beam: off, trailing); "
    "tip = uphill wheels leave it"
)
_SOURCE: Final = "tip line through the declared contact points below the declared centre of mass, within 1 deg"


def _tip_trials(setup: Setup, only: Sequence[str] = ()) -> Iterator[Trial]:
    """The rows of one plant: each way to tip at each height of the centre of mass.

    What is expected takes a moment to find, so rows whose names begin with none of the words of `only` are left out.
    """
    for name, downhill, antitips in _ways(setup):
        for height_m in _COM_HEIGHTS_M:
            if only and not _name(name, height_m).startswith(tuple(only)):
                continue
            expected_deg = deg(expected_tip_rad(setup.at_com_height(height_m), downhill, antitips))
            yield Trial(
                name=_name(name, height_m),
                unit="deg",
                bound="file",
                low=expected_deg - _TOLERANCE_DEG,
                high=expected_deg + _TOLERANCE_DEG,
                method=_METHOD,
                source=_SOURCE,
                measure=partial(_tip_deg, height_m=height_m, downhill=downhill, antitips=antitips),
            )


def _falling_rows(setup: Setup, rows: Mapping[str, Row]) -> Iterator[Row]:
    """Share of each tip angle that is left as the centre of mass is raised; the pivots of each way stay the same."""
    low_m, high_m = _COM_HEIGHTS_M
    for name, _, _ in _ways(setup):
        pair = rows.get(_name(name, low_m)), rows.get(_name(name, high_m))
        if pair[0] is None or pair[1] is None:
            continue
        value = pair[1].value / pair[0].value
        yield Row(
            name=f"{name}_falls",
            value=value,
            unit="",
            bound="file",
            low=_LEAST_LEFT,
            high=_MOST_LEFT,
            method=f"tip angle at {high_m:.2f} m divided by that at {low_m:.2f} m",
            source="a higher centre of mass above the same pivots tips earlier",
            ok=_LEAST_LEFT <= value <= _MOST_LEFT,
        )


def _ways(setup: Setup) -> Iterator[tuple[str, Vec2, bool]]:
    yield "tip_forward", FORWARD_DOWN, True
    yield "tip_rear", REAR_DOWN, True
    antitips_x_m = [pair.p_m[0] for pair in plant_spec(setup.chair).antitips]
    if any(x_m > 0.0 for x_m in antitips_x_m):
        yield "tip_forward_no_antitips", FORWARD_DOWN, False
    if any(x_m < 0.0 for x_m in antitips_x_m):
        yield "tip_rear_no_antitips", REAR_DOWN, False
    yield "tip_lateral", LEFT_DOWN, True


def _name(way: str, height_m: float) -> str:
    return f"{way}_com_{round(100 * height_m)}cm"


def _tip_deg(setup: Setup, height_m: float, downhill: Vec2, antitips: bool) -> float:
    return deg(measured_tip_rad(setup.at_com_height(height_m), downhill, antitips))


_LEAST_LOAD: Final = 0.2  # of the static load
_RAMP: Final = f"ramp of {deg(ramps.FALL_RAD):.0f} degrees, twisted by {deg(ramps.TWIST_RAD):.0f} over the wheelbase"


def _ramp_trials(_setup: Setup) -> Iterator[Trial]:
    """The rows of one plant."""
    yield Trial(
        name="twisted_ramp_load",
        unit="",
        bound="wcsim",
        low=_LEAST_LOAD,
        high=1.2,
        method=f"least load of a drive wheel at rest on a {_RAMP}, up and down, both ways, relative to level ground",
        source="both drive wheels keep a fifth of their load",
        measure=ramps.least_load_share,
    )
    yield Trial(
        name="twisted_ramp_stop",
        unit="",
        bound="wcsim",
        low=0.8,
        high=1.25,
        method=f"longest stopping distance from half stick, down a {_RAMP}, both ways, relative to level ground",
        source="jerk-limited v2/2a + v a/2j, 25 % more for the slope",
        measure=ramps.stopping_share,
    )
    yield Trial(
        name="twisted_ramp_turn",
        unit="",
        bound="wcsim",
        low=0.75,
        high=1.25,
        method=f"least turn in 1.5 s, stick to either side, down a {_RAMP}, both ways, relative to level ground",
        source="requested turn, within 25 %",
        measure=ramps.turned_share,
    )


Progress = Callable[[str], None]
_MAKERS: Final = (_weight_trials, driving_trials, _ramp_trials, kerb_trials)


def trials(setup: Setup, only: Sequence[str] = ()) -> tuple[Trial, ...]:
    """The trials of a plant whose names begin with one of some words; all if none.

    Raises ConfigError or PhysicsError for a plant that cannot be.
    """
    most_mps = plant_spec(setup.chair).limits.speed_mps
    slow_enough = (trial for trial in _made(setup, only) if trial.speed_mps is None or trial.speed_mps <= most_mps)
    return (*slow_enough, *_tip_trials(setup, only))


def too_fast(setup: Setup, only: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the rows that ask for more speed than the plant's `limits.speed_mps`, and are left out."""
    most_mps = plant_spec(setup.chair).limits.speed_mps
    return tuple(
        trial.name for trial in _made(setup, only) if trial.speed_mps is not None and trial.speed_mps > most_mps
    )


def _made(setup: Setup, only: Sequence[str]) -> Iterator[Trial]:
    for make in _MAKERS:
        yield from (trial for trial in make(setup) if not only or trial.name.startswith(tuple(only)))


def table(setup: Setup, only: Sequence[str] = (), workers: int = 1, progress: Progress | None = None) -> list[Row]:
    """The table of a plant.

    Args:
        setup: The chair, its IMU and the rate.
        only: Beginnings of the names of the rows that are wanted; all if none.
        workers: Processes to share the work; 1 for none but this one.
        progress: Told the name of each row as it is done.

    Raises:
        ConfigError: The plant is unknown, its file is wrong, or no row begins so.
        PhysicsError: A trial gave no number.
    """
    chosen = trials(setup, only)
    if not chosen:
        fast = too_fast(setup, only)
        what = (
            f"{', '.join(fast)}: faster than the plant's limits.speed_mps"
            if fast
            else (f"no row starts with {', '.join(only)!r}")
        )
        raise ConfigError(f"{what}; expected the start of a row's name")
    rows: dict[str, Row] = {}
    for row in _done(chosen, setup, workers):
        rows[row.name] = row
        if progress is not None:
            progress(row.name)
    return [*rows.values(), *_falling_rows(setup, rows)]


def _done(chosen: Sequence[Trial], setup: Setup, workers: int) -> Iterator[Row]:
    if workers == 1:
        yield from (measured(trial, setup) for trial in chosen)
        return
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(partial(measured, setup=setup), chosen)
