"""Rows of kerbs: which are climbed, what they feel like, which make a chair fall off them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Final

from wcsim.chair_check import driving, kerbs
from wcsim.chair_check.row import Measure, Setup, Trial
from wcsim.config import RewardConfig
from wcsim.config.plant import known_plants
from wcsim.core.frames import rad
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec

RUN_UP_M: Final = 0.5
_FALL_MPS: Final = 1.5
_SHALLOW_DEG, _STEEP_DEG = 25, 60
_MOST_MPS2: Final = 157.0  # what the sensor shows at most, 16 g
_MEAN: Final = "mean of six runs"
_SPAN: Final = "values of both plants when they were designed, 25 % to either side"
_FALL_SOURCE: Final = "ordering of Erickson et al. 2016 (JNER 13:20): higher kerbs and shallower approaches tip"


def kerb_trials(setup: Setup) -> Iterator[Trial]:
    """The rows of one plant."""
    spec = plant_spec(setup.chair)
    yield from _climbs(spec)
    yield from _events(spec)
    ours = setup.chair.plant in known_plants()  # of another chair these rows say how it compares, and judge nothing
    yield from (replace(trial, bound="rwd, mwd", judged=ours) for trial in _peaks())
    yield from (replace(trial, judged=ours or _like_the_experiments(spec)) for trial in _falls(spec))


def _climbs(spec: PlantSpec) -> Iterator[Trial]:
    declared = spec.climbs
    starts = (("standstill", 0.0, declared.standstill_m), ("run_up", RUN_UP_M, declared.run_up_m))
    for name, run_up_m, climbed_m in starts:
        for rise_m in sorted({*climbed_m, *declared.refused_m}):
            up = 1.0 if rise_m in climbed_m else 0.0
            yield Trial(
                name=f"kerb_{round(1000 * rise_m)}mm_{name}",
                unit="climbed",
                bound="file",
                low=up,
                high=up,
                method=f"square on, full stick, run-up {run_up_m:g} m (ISO 7176-10); 1 = all wheels are up",
                source="climbs of the parameter file",
                measure=partial(kerbs.climbs, rise_m=rise_m, run_up_m=run_up_m),
            )


def _events(spec: PlantSpec) -> Iterator[Trial]:
    """Driving, kerb and wall as the penalty on acceleration tells them apart."""
    low, high = RewardConfig().accel_window_mps2
    window = f"penalty window {low:g} to {high:g} m/s2"
    rows: tuple[tuple[str, float, str, str, Measure], ...] = (
        ("driving", 0.25 * low, "off, straight, full turn, to a stop", "below the ", kerbs.driving_peak_mps2),
        ("cruise", 0.5, "cruising straight on level ground", "no bumps; below the ", driving.cruise_peak_mps2),
    )
    for name, most, how, where, measure in rows:
        yield _impact("event_" + name, (0.0, most), "largest low-passed acceleration: " + how, where + window, measure)
    speed = _kerb_speed_mps(spec)
    yield _impact(
        "event_kerb_40mm",
        (low, high),
        f"largest low-passed acceleration over a kerb of 40 mm at {speed:g} m/s, {_MEAN}",
        "inside the " + window,
        partial(kerbs.kerb_peak_mps2, rise_m=0.04),
        speed,
    )
    yield _impact(
        "event_wall_6kmh",
        (high, _MOST_MPS2),
        "largest low-passed acceleration into a wall at 1.67 m/s, " + _MEAN,
        "a crash: above the " + window,
        kerbs.wall_peak_mps2,
        1.67,
    )


def _kerb_speed_mps(spec: PlantSpec) -> float:
    """Speed at which the 40 mm kerb is judged: sprung casters take a kerb softly, so faster for a plant with them."""
    return 1.67 if any(pair.arm is not None for pair in spec.casters) else 1.0


def _peaks() -> Iterator[Trial]:
    # faster over the lowest kerb, it is over within two steps of 1/120 s, and its peak depends on the step
    kerbs_m = ((0.02, 0.8, 9.0, 20.0), (-0.06, 1.0, 12.0, 40.0), (-0.12, 1.0, 25.0, 46.0))
    for rise_m, speed, low, high in kerbs_m:
        what = "kerb" if rise_m > 0.0 else "drop"
        yield _impact(
            f"peak_{what}_{round(1000 * abs(rise_m))}mm",
            (low, high),
            f"largest low-passed acceleration over a {what} of {1000 * abs(rise_m):g} mm at {speed:g} m/s, {_MEAN}",
            _SPAN,
            partial(kerbs.kerb_peak_mps2, rise_m=rise_m),
            speed,
        )
    yield _impact(
        "peak_wall_1mps",
        (29.0, 49.0),
        "largest low-passed acceleration into a wall at 1 m/s, " + _MEAN,
        _SPAN,
        kerbs.wall_peak_mps2,
        1.0,
    )


def _impact(
    name: str,
    span_mps2: tuple[float, float],
    method: str,
    source: str,
    measure: Measure,
    speed_mps: float | None = None,
) -> Trial:
    return Trial(
        name=name,
        unit="m/s2",
        bound="wcsim",
        low=span_mps2[0],
        high=span_mps2[1],
        method=method,
        source=source,
        measure=measure,
        speed_mps=speed_mps,
        impact=True,
    )


def _like_the_experiments(spec: PlantSpec) -> bool:
    """Whether it has no wheels behind the driven ones, as the chair that was driven off kerbs."""
    return all(pair.swivel_x_m > 0.0 for pair in spec.casters)


def _falls(spec: PlantSpec) -> Iterator[Trial]:
    cases = [(drop_m, angle, 0.0) for drop_m in (0.12, 0.20) for angle in (_SHALLOW_DEG, _STEEP_DEG)]
    if not _like_the_experiments(spec):
        cases.remove((0.20, _SHALLOW_DEG, 0.0))
    for drop_m, angle_deg, tips in [*cases, (0.30, 5, 1.0), (0.30, _SHALLOW_DEG, 1.0), (0.30, _STEEP_DEG, 0.0)]:
        yield Trial(
            name=f"falls_off_{round(100 * drop_m)}cm_at_{angle_deg}deg",
            unit="tipped",
            bound="trial",
            low=tips,
            high=tips,
            method=f"off a kerb at {_FALL_MPS:g} m/s, {angle_deg} degrees between way and edge; 1 = lies on its side",
            source=_FALL_SOURCE,
            measure=partial(kerbs.tips_off, drop_m=drop_m, approach_rad=rad(angle_deg)),
            speed_mps=_FALL_MPS,
        )
