"""The numbers of a drive as it goes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from wcsim.drive.tally import DriveTally

STILL = {
    "step": 1, "joystick_distance": 0.5, "speed_mps": -1.0, "arrived": False, "gave_up": False, "crashed": False,
    "truncated": False, "help_asked": False, "warning": False, "intervening": False, "overruled": False,
}  # fmt: skip


def tallied(*ticks: dict[str, Any]) -> DriveTally:
    tally = DriveTally()
    for changes in ticks:
        tally.add(SimpleNamespace(**{**STILL, **changes}), 0.1)  # type: ignore[arg-type]
    return tally


def test_steps_before_a_handover_were_not_lived_by_the_policy() -> None:
    tally = tallied({"step": 26}, {"step": 27}, {"step": 28})
    assert tally.kpi2 == 3.0
    tally.end_episode()
    tally.add(SimpleNamespace(**STILL), 0.1)  # type: ignore[arg-type]
    tally.end_episode()
    assert tally.kpi2 == 2.0


def test_distance_and_way_are_means_and_sums_of_all_ticks() -> None:
    tally = tallied({"joystick_distance": 0.1}, {"speed_mps": 0.0}, {"crashed": True})
    assert tally.kpi1 == pytest.approx((0.1 + 0.5 + 0.5) / 3)
    assert (tally.way_m, tally.moving_ticks, tally.crashes) == (pytest.approx(0.2), 2, 1)
    assert DriveTally().kpi1 is None


@pytest.mark.parametrize("end", ["crashed", "truncated"])
def test_an_episode_that_ends_with_the_last_tick_counts(end: str) -> None:
    tally = tallied({}, {}, {end: True}, {}, {end: True})
    assert (tally.episode_steps, tally.steps, tally.kpi2) == ([3, 2], 0, 2.5)
    tally.end_episode()
    assert tally.episode_steps == [3, 2], "once"


def test_stretches_count_once() -> None:
    on = {"warning": True, "overruled": True}
    tally = tallied(on, on, {}, on, {"intervening": True}, {"intervening": True})
    assert (tally.warnings, tally.overrules, tally.interventions) == (2, 2, 1)
