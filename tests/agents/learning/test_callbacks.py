from __future__ import annotations

from dataclasses import replace

from wcsim.agents.learning.callbacks import _report_events
from wcsim.types import Events

CALM = Events(episode=0, step=1, crashed=False, crash_reason="", truncated=False, arrived=False, gave_up=False)


def test_a_jam_is_reported_once_a_step_and_crashes_each_with_their_words():
    told = []
    crash = replace(CALM, crashed=True, crash_reason="collision", crash="was hit by car c", jam_teleports=2)
    _report_events(lambda kind, **values: told.append((kind, values)), 7, (crash, CALM, crash))
    fact = ("crash", {"step": 7, "reason": "collision", "told": "was hit by car c"})
    assert told == [("jam", {"step": 7, "teleported": 2}), fact, fact]
    _report_events(lambda kind, **values: told.append(kind), 8, (CALM,))
    assert len(told) == 3
