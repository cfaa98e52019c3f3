"""Sums of an episode against hand-made numbers; whose a crash is, and how smooth a drive was."""

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import CALM
from wcsim.agents.envs.episode_view import InfoObjects
from wcsim.config import RewardConfig
from wcsim.supervisor import kpi
from wcsim.supervisor.kpi import KpiStep, KpiTotals
from wcsim.types import Contact, Joystick

REST = Joystick(0.0, 0.0)
AHEAD = Joystick(0.0, 0.8)
HIT = Contact(kind="car", part="body", impulse_Ns=200.0, cause="other", actor_id="car-1")


def step(distance=0.0, speed_mps=1.0, asked=REST, given=REST, **events) -> KpiStep:
    info = {
        "joystick_distance": distance, "speed_mps": speed_mps,
        "objects": InfoObjects(events=replace(CALM, **events), asked=asked, given=given),
    }  # fmt: skip
    return KpiStep.of(info)


def sums_of(*steps, tick_s=0.1) -> dict[str, Any]:
    return kpi.sum_kpi_steps(steps, tick_s)


def test_a_small_test_by_hand():
    found = sums_of(*(step(distance, 1.5) for distance in (0.0, 0.1768, 1.0)))
    assert (found["steps"], found["within"]) == (3, 2)
    assert found["distance_sum"] == pytest.approx(1.1768)
    assert found["m"] == pytest.approx(0.45)


def frozen(ticks, **other):
    return [step(speed_mps=0.0, asked=AHEAD, **other)] * ticks


def test_a_freeze_takes_three_seconds():
    assert sums_of(*frozen(29))["freezes"] == 0
    assert sums_of(*frozen(30))["freezes"] == 1
    assert sums_of(*frozen(95))["freezes"] == 1
    assert sums_of(*frozen(30), step(), *frozen(31))["freezes"] == 2
    assert sums_of(*frozen(20), step(speed_mps=0.05), *frozen(20))["freezes"] == 0


def test_who_stands_as_the_user_wants_or_tries_to_drive_does_not_freeze():
    assert sums_of(*[step(speed_mps=0.0, asked=Joystick(0.0, 0.29))] * 50)["freezes"] == 0
    assert sums_of(*frozen(50, given=Joystick(0.3, 0.0)))["freezes"] == 0
    assert sums_of(*frozen(50, given=Joystick(0.25, 0.0)))["freezes"] == 1


def test_what_the_world_saw_is_counted():
    found = sums_of(
        step(crossed=True),
        step(crossed=True, entered_red=True, arrived=True),
        step(gave_up=True, help_asked=True),
        step(gave_up=True, on_carriageway=True),
        step(speed_mps=0.049, on_carriageway=True),
        step(speed_mps=0.0, on_carriageway=True),
        step(speed_mps=0.0, help_asked=True),
        tick_s=0.2,
    )
    names = ("goals", "given_up", "crossings", "red_entries", "helps")
    assert [found[name] for name in names] == [1, 2, 2, 1, 2]
    assert found["road_s"] == pytest.approx(0.4)


def test_nothing_driven_is_json():
    found = sums_of()
    assert found["steps"] == found["freezes"] == found["crossings"] == 0 and found["m"] == 0.0
    json.dumps(found, allow_nan=False)


def test_reversing_is_a_way_driven():
    assert sums_of(step(speed_mps=1.0), step(speed_mps=-1.0), tick_s=1.0)["m"] == pytest.approx(2.0)


sticks = st.builds(Joystick, st.floats(-1, 1), st.floats(-1, 1))
steps = st.builds(
    step,
    distance=st.floats(0, 2),
    speed_mps=st.sampled_from([0.0, 0.0, -0.5, 1.0]),
    asked=sticks,
    given=sticks,
    crossed=st.booleans(),
    on_carriageway=st.booleans(),
)


@given(st.lists(steps, max_size=20))
def test_never_nan_and_within_bounds(taken):
    found = sums_of(*taken)
    assert all(math.isfinite(value) for value in found.values() if isinstance(value, int | float))
    assert 0.0 <= found["distance_sum"] <= 2.0 * found["steps"] and found["within"] <= found["steps"] == len(taken)


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 45)), max_size=12))
def test_freezes_are_those_that_a_plain_count_finds(stretches):
    plan = [cold for cold, ticks in stretches for _ in range(ticks)]
    expected = lasted = 0
    for cold in plan:
        lasted = lasted + 1 if cold else 0
        expected += lasted == 30
    assert sums_of(*[frozen(1)[0] if cold else step() for cold in plan])["freezes"] == expected


def crash_after(*speeds_mps: float, **events: Any) -> tuple[list[KpiStep], str]:
    """These ticks and one in which a car hits the chair and throws it, and whose fault that is."""
    steps = [step(speed_mps=speed, **{"on_carriageway": True, **events}) for speed in speeds_mps]
    steps.append(step(speed_mps=3.2, on_carriageway=True, crashed=True, crash_reason="collision"))
    return steps, str(kpi.make_crash_fields(steps[-1].events, (HIT,), steps, 0.1, RewardConfig())["fault"])


@pytest.mark.parametrize("still_ticks, whose", [(0, "other"), (8, "other"), (10, "own"), (50, "own")])
def test_who_stood_on_a_carriageway_for_a_second_is_at_fault_though_the_crash_moved_the_chair(still_ticks, whose):
    assert crash_after(1.0, *[0.0] * still_ticks)[1] == whose


def test_who_came_onto_it_at_red_is_at_fault_and_who_stood_on_a_pavement_is_not():
    assert crash_after(1.0, 1.0, entered_red=True)[1] == "own"
    assert crash_after(*[0.0] * 50, on_carriageway=False)[1] == "other"


def test_a_crash_says_nothing_of_how_smooth_the_drive_was():
    assert sums_of(*crash_after(1.0, 1.1, 1.2)[0])["accel_sq_sum"] == pytest.approx(2.0)
    assert sums_of(*(step(speed_mps=speed) for speed in (1.0, 1.1, 1.2)))["accel_sq_sum"] == pytest.approx(2.0)


def totals_after(*ticks: set[str]) -> KpiTotals:
    totals = KpiTotals()
    for happened in ticks:
        totals = totals.plus(happened, 0.5, -1.0)
    return totals


def test_totals_are_means_and_sums_of_all_ticks_and_of_judged_ones():
    totals = totals_after(set(), {"crashes", "drops"}).plus(set(), 0.2, 0.0).plus(set(), None, 1.0)
    assert totals.kpi1 == pytest.approx((0.5 + 0.5 + 0.2) / 3)
    assert (totals.ticks, totals.judged, totals.speed_sum, totals.moving_ticks) == (4, 3, 3.0, 3)
    assert (totals.crashes, totals.drops, KpiTotals().kpi1) == (1, 1, None)


def test_an_episode_of_totals_counts_once_it_is_over_and_has_steps():
    totals = totals_after(set(), set(), set())
    assert totals.kpi2 == 3.0, "the one that is on"
    totals = totals.after_episode().after_episode()
    assert (totals.ended, totals.ended_steps, totals.steps) == (1, 3, 0)
    assert totals.plus(set(), 0.5, 0.0).after_episode().kpi2 == 2.0
    assert totals.plus(set(), 0.5, 0.0, steps=0).after_episode().ended == 1, "it ended before its handover"


def test_stretches_count_once_in_totals():
    on = {"warnings", "overrules", "helps"}
    totals = totals_after(on, on, set(), on, {"interventions"}, {"interventions"})
    assert (totals.warnings, totals.overrules, totals.interventions, totals.helps) == (2, 2, 1, 3)
