"""Rows of the twisted ramp: grip of both drive wheels, stopping and steering."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from wcsim.chair_check import ramps
from wcsim.chair_check.row import Setup, Trial
from wcsim.core.frames import deg

_LEAST_LOAD: Final = 0.2  # of the static load
_RAMP: Final = f"ramp of {deg(ramps.FALL_RAD):.0f} degrees, twisted by {deg(ramps.TWIST_RAD):.0f} over the wheelbase"


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
