"""Rows of static stability (ISO 7176-1): tilts at which the chair tips, and that they fall with its height."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Final

from wcsim.chair_check.declared import FORWARD_DOWN, LEFT_DOWN, REAR_DOWN
from wcsim.chair_check.row import Row, Setup, Trial
from wcsim.chair_check.static_balance import Vec2
from wcsim.chair_check.tilt_table import expected_tip_rad, measured_tip_rad
from wcsim.core.frames import deg
from wcsim.physics.wheelchair.plant import plant_spec

_COM_HEIGHTS_M: Final = (0.50, 0.60)
_TOLERANCE_DEG: Final = 1.0
_LEAST_LEFT, _MOST_LEFT = 0.5, 0.98
_METHOD: Final = (
    "tilt table at 0.2 deg/s, brakes on, casters at their worst angle (sideways on a beam: off, trailing); "
    "tip = uphill wheels leave it"
)
_SOURCE: Final = "tip line through the declared contact points below the declared centre of mass, within 1 deg"


def tip_trials(setup: Setup, only: Sequence[str] = ()) -> Iterator[Trial]:
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


def falling_rows(setup: Setup, rows: Mapping[str, Row]) -> Iterator[Row]:
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
