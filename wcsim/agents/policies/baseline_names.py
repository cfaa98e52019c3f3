"""The names of the baselines, for whoever must not load a simulator.

`agents/policies/baselines.py` has the policies.
"""

from __future__ import annotations

from typing import Final

NAMES: Final = ("follow", "random", "zero", "stop", "dwa")
"""What sees no more than a network does."""

UPPER_BOUND: Final = "oracle"
VISIBLE_BOUND: Final = "oracle-visible"
UPPER_BOUNDS: Final = (VISIBLE_BOUND, UPPER_BOUND)
"""See the truth, so they are no rivals of a network but what could be reached."""


def is_baseline(name: str) -> bool:
    """Whether a baseline has this name."""
    return name in (*NAMES, *UPPER_BOUNDS)
