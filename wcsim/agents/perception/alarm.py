"""When a user is warned: the smoothed danger of the own stick, as one doubtful tick is not enough.

Policies that warn share it, so that tables compare what they detect, not how often they waver.
"""

from dataclasses import dataclass
from typing import Final

# Share of the newest tick in the smoothed danger: about three ticks count.
NEWEST: Final = 0.5
# A warning ends below this share of the level at which it starts.
CALM: Final = 0.7
# Level for a policy with dangers of 0 and 1 alone: two ticks in a row reach it, one does not.
TWO_TICKS: Final = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmState:
    """Whether the user is warned, and the smoothed danger of the own stick behind it."""

    level: float = 0.0
    on: bool = False


def next_alarm_state(before: AlarmState, danger: float, warn: float) -> AlarmState:
    """The alarm a tick later: on above `warn`, off again below `CALM` of it.

    Args:
        before: The alarm of the tick before.
        danger: Of the user's own stick, if it is held, in 0..1.
        warn: Smoothed danger above which the user is warned.

    >>> alarm, warned = AlarmState(), []
    >>> for danger in (0.9, 0.0, 0.9, 0.9, 0.4, 0.3, 0.1):
    ...     alarm = next_alarm_state(alarm, danger, warn=0.5)
    ...     warned.append(alarm.on)
    >>> warned
    [False, False, True, True, True, True, False]
    """
    level = before.level + NEWEST * (danger - before.level)
    return AlarmState(level=level, on=level > warn or (before.on and level > CALM * warn))
