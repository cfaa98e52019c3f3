"""The names of the baselines, for whoever must not load a simulator.

`agents/policies/baselines.py` has the policies.
"""

from __future__ import annotations

from typing import Final

from wcsim.core.reading import shown
from wcsim.errors import PolicyError

NAMES: Final = ("follow", "random", "zero", "stop", "dwa")
"""What sees no more than a network does."""

UPPER_BOUND: Final = "oracle"
VISIBLE_BOUND: Final = "oracle-visible"
UPPER_BOUNDS: Final = (VISIBLE_BOUND, UPPER_BOUND)
"""See the truth, so they are no rivals of a network but what could be reached."""


LEVELLED: Final = "dwa"
VETO: Final = "veto:"
"""Before a policy's name: `dwa` forbids what it holds for unsafe, see `policies/veto.py`."""

HIGHEST_LEVEL: Final = 2.0
USUAL_LEVEL: Final = 1.0


def without_veto(name: str) -> str:
    """The policy that a name means, without the wrapper around it.

    >>> without_veto("veto:runs/a@0.2"), without_veto("dwa")
    ('runs/a@0.2', 'dwa')
    """
    return name.removeprefix(VETO)


def is_baseline(name: str) -> bool:
    """Whether a baseline has this name. Raises PolicyError for a level of assistance that there is not."""
    name = without_veto(name)
    level_of(name)
    return name.partition("@")[0] == LEVELLED or name in (*NAMES, *UPPER_BOUNDS)


def level_of(name: str) -> float:
    """How much `dwa@L` assists: 0 at the last moment, 1 as `dwa` itself, 2 early and with wide margins.

    >>> level_of("dwa@0.5"), level_of("dwa"), level_of("follow")
    (0.5, 1.0, 1.0)

    Raises:
        PolicyError: L is no number from 0 to 2.
    """
    who, at, text = name.partition("@")
    if who != LEVELLED or not at:
        return USUAL_LEVEL
    try:
        level = float(text)
    except ValueError:
        level = -1.0
    if not 0.0 <= level <= HIGHEST_LEVEL:
        raise PolicyError(
            f"policy {shown(name)!r} has no such level of assistance; expected {LEVELLED}@L with L from 0 to "
            f"{HIGHEST_LEVEL:g}: {LEVELLED}@{USUAL_LEVEL:g} is {LEVELLED}"
        )
    return level
