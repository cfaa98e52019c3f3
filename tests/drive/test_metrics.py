"""The numbers of a drive as it goes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from wcsim.drive.driven import DriveMetrics

STILL = {
    "step": 1, "joystick_distance": 0.5, "speed_mps": -1.0, "arrived": False, "gave_up": False, "crashed": False,
    "truncated": False, "help_asked": False, "warning": False, "intervening": False, "overruled": False,
}  # fmt: skip


def metrics_after(*ticks: dict[str, Any]) -> DriveMetrics:
    metrics = DriveMetrics()
    for changes in ticks:
        metrics.add(SimpleNamespace(**{**STILL, **changes}), 0.1)  # type: ignore[arg-type]
    return metrics


def test_steps_before_a_handover_were_not_lived_by_the_policy() -> None:
    metrics = metrics_after({"step": 26}, {"step": 27}, {"step": 28})
    assert metrics.kpi2 == 3.0
    metrics.end_episode()
    metrics.add(SimpleNamespace(**STILL), 0.1)  # type: ignore[arg-type]
    metrics.end_episode()
    assert metrics.kpi2 == 2.0


def test_distance_and_way_are_means_and_sums_of_all_ticks() -> None:
    metrics = metrics_after({"joystick_distance": 0.1}, {"speed_mps": 0.0}, {"crashed": True})
    assert metrics.kpi1 == pytest.approx((0.1 + 0.5 + 0.5) / 3)
    assert (metrics.way_m, metrics.moving_ticks, metrics.crashes) == (pytest.approx(0.2), 2, 1)
    assert DriveMetrics().kpi1 is None


@pytest.mark.parametrize("end", ["crashed", "truncated"])
def test_an_episode_that_ends_with_the_last_tick_counts(end: str) -> None:
    metrics = metrics_after({}, {}, {end: True}, {}, {end: True})
    assert (metrics.episode_steps, metrics.steps, metrics.kpi2) == ([3, 2], 0, 2.5)
    metrics.end_episode()
    assert metrics.episode_steps == [3, 2], "once"


def test_stretches_count_once() -> None:
    on = {"warning": True, "overruled": True}
    metrics = metrics_after(on, on, {}, on, {"intervening": True}, {"intervening": True})
    assert (metrics.warnings, metrics.overrules, metrics.interventions) == (2, 2, 1)
