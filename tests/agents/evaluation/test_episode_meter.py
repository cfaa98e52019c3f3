"""Whose a crash is, and how smooth a drive was: told by what came before the crash."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from wcsim.agents.evaluation.episode_meter import EpisodeMeter
from wcsim.config import RewardConfig
from wcsim.types import Contact, Events, Joystick

NOTHING = Events(
    episode=0, step=1, crashed=False, crash_reason="", truncated=False, arrived=False, gave_up=False,
    on_carriageway=True,
)  # fmt: skip
HIT = Contact(kind="car", part="body", impulse_Ns=200.0, cause="other", actor_id="car-1")


def told(speed_mps: float, **events: Any) -> dict[str, Any]:
    rest = Joystick(0.0, 0.0)
    happened = replace(NOTHING, **events)
    return {"events": happened, "joystick_distance": 0.0, "asked": rest, "given": rest, "speed_mps": speed_mps}


def crash_after(*speeds_mps: float, **events: Any) -> tuple[EpisodeMeter, str]:
    """A meter of these ticks and of one in which a car hits the chair and throws it."""
    meter = EpisodeMeter(0.1, RewardConfig())
    for speed in speeds_mps:
        meter.add(told(speed, **events), None)
    last = {**told(3.2, crashed=True, crash_reason="collision"), "contacts": (HIT,)}
    meter.add(last, None)
    return meter, str(meter.crash(last)["fault"])


@pytest.mark.parametrize(("still_ticks", "whose"), [(0, "other"), (8, "other"), (10, "own"), (50, "own")])
def test_who_stood_on_a_carriageway_for_a_second_is_at_fault_though_the_crash_moved_the_chair(still_ticks, whose):
    assert crash_after(1.0, *[0.0] * still_ticks)[1] == whose


def test_who_came_onto_it_at_red_is_at_fault_and_who_stood_on_a_pavement_is_not():
    assert crash_after(1.0, 1.0, entered_red=True)[1] == "own"
    assert crash_after(*[0.0] * 50, on_carriageway=False)[1] == "other"


def test_a_crash_says_nothing_of_how_smooth_the_drive_was():
    sums = crash_after(1.0, 1.1, 1.2)[0].sums("collision")
    assert sums["accel_sq_sum"] == pytest.approx(2.0)
    calm = EpisodeMeter(0.1, RewardConfig())
    for speed in (1.0, 1.1, 1.2):
        calm.add(told(speed), None)
    assert calm.sums()["accel_sq_sum"] == pytest.approx(2.0)


def test_requests_for_help_are_added_up():
    meter = EpisodeMeter(0.1, RewardConfig())
    for asks in (True, False, True):
        meter.add(told(1.0, help_asked=asks), None)
    assert meter.sums()["helps"] == 2
