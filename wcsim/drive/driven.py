"""What a drive tells its observers (a recorder, a test): the records of its ticks and events."""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import Final

from wcsim.log.records import Admitted, DriveTick, Note, Respawned
from wcsim.supervisor.kpi import FOLLOWED
from wcsim.types import Joystick

# Of a person's stick.
LEAST_SPEED, LEAST_SENSITIVITY, MOST_SENSITIVITY = 0.2, 0.5, 2.0
# Fields of a tick, and the counters of `KpiTotals`.
_COUNTED: Final = {
    "crashed": "crashes",
    "dropped": "drops",
    "arrived": "arrivals",
    "gave_up": "given_up",
    "helped": "helps",
    "warning": "warnings",
    "intervening": "interventions",
    "overruled": "overrules",
}
DriveRecord = DriveTick | Note | Respawned | Admitted
"""One record: a tick, an event, another start of the episode, or another simulated user.

- `Respawned`: the episode begins elsewhere than the world began it.
- `Admitted`: another simulated user sits there, in another chair.

These two come before the event `EPISODE`.
"""
DriveObserver = Callable[[DriveRecord], object]
"""Observes a drive and changes nothing. It gets each finished tick, and each event before its tick.

Ticks are numbered from 1 over the whole drive; their arrays are copies. An observer that has
`close` is closed with the drive.
"""


class DriverKind(StrEnum):
    """Whose stick counts."""

    PERSON = "person"
    SIMULATED = "simulated"


class EventKind(StrEnum):
    """What is written into a drive's event log."""

    BEGUN = "begun"
    EPISODE = "episode"
    REBUILT = "rebuilt"  # the world is built anew; comes before `EPISODE`
    DRIVER = "driver"
    ASSISTANCE = "assistance"
    LEVEL = "level"
    STICK_SHAPE = "stick-shape"  # another speed or sensitivity of the person's stick
    OVERRULE = "overrule"
    OVERRULE_END = "overrule-end"
    HELP = "help"
    HELP_END = "help-end"  # its time is over
    WARNING = "warning"
    INTERVENING = "intervening"
    ARRIVED = "arrived"
    GAVE_UP = "gave-up"
    CRASHED = "crashed"
    STEP_LIMIT = "step-limit"
    PAUSED = "paused"
    GOES_ON = "goes-on"
    STICK_LOST = "stick-lost"
    STICK_BACK = "stick-back"
    POLICY_FAILED = "policy-failed"


def happened_in(tick: object) -> set[str]:
    """Names of the counters of `KpiTotals` that a chair's tick, of a drive or a film, adds to."""
    return {counter for field, counter in _COUNTED.items() if getattr(tick, field, False)}


def xy_of(stick: Joystick) -> tuple[float, float]:
    """A stick's x and y, rounded, as pages and films hold it."""
    return round(stick.x, 4), round(stick.y, 4)


def is_intervention(asked: Joystick, given: Joystick) -> bool:
    """Whether a chair's command no longer follows its user's stick, by the tolerance of KPI 1."""
    return math.hypot(asked.x - given.x, asked.y - given.y) > FOLLOWED
