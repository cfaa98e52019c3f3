"""When a user is warned: what each tick says of the own stick, smoothed, so that a doubtful tick is not enough.

Policies that warn share it, so that tables compare what they know, and not how often they change their minds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

NEWEST: Final = (
    0.5  # share of the newest tick in the danger that is warned of: about three ticks count
)
CALM: Final = 0.7  # times the level of the warning: below it a warning ends
TWO_TICKS: Final = 0.6  # level for who knows only a danger of 0 or 1: two ticks in a row are enough, a lone one is not


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """Whether the user is warned, and the smoothed danger of the own stick that it follows from; 0 before anything."""

    level: float = 0.0
    on: bool = False


def next_alarm(before: Alarm, danger: float, warn: float) -> Alarm:
    """The alarm a tick later: on above `warn`, off again below 0.7 of it; a doubtful tick is not enough.

    Args:
        before: The alarm of the tick before.
        danger: Of the user's own stick, if it is held, in 0..1.
        warn: Smoothed danger from which on the user is warned.

    >>> alarm, told = Alarm(), []
    >>> for danger in (0.9, 0.0, 0.9, 0.9, 0.4, 0.3, 0.1):
    ...     alarm = next_alarm(alarm, danger, warn=0.5)
    ...     told.append(alarm.on)
    >>> told
    [False, False, True, True, True, True, False]
    """
    level = before.level + NEWEST * (danger - before.level)
    return Alarm(level=level, on=level > warn or (before.on and level > CALM * warn))
