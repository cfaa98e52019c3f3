"""What a drive tells its observers (a recorder, a test): the records of its log, a tick or an event each."""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import Final

from wcsim.log.records import Admitted, DriveTick, Note, Respawned
from wcsim.supervisor.kpi import FOLLOWED
from wcsim.types import Joystick

_COUNTED: Final = {
    "crashed": "crashes",
    "dropped": "drops",
    "arrived": "arrivals",
    "gave_up": "given_up",
    "helped": "helps",
    "warning": "warnings",
    "intervening": "interventions",
    "overruled": "overrules",
}  # fields of a tick, and the counters of `KpiTotals`


class DriverKind(StrEnum):
    """Whose stick counts."""

    PERSON = "person"
    SIMULATED = "simulated"


LEAST_SPEED, LEAST_SENSITIVITY, MOST_SENSITIVITY = 0.2, 0.5, 2.0  # of a person's stick


class EventKind(StrEnum):
    """What is written into a drive's event log."""

    BEGUN = "begun"
    EPISODE = "episode"
    REBUILT = "rebuilt"  # the world is another one, at its beginning, before `EPISODE`
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


DriveRecord = DriveTick | Note | Respawned | Admitted
"""A tick; an event; that the episode begins elsewhere than the world began it; that another simulated user sits there,
in another chair. The last two come before the event `EPISODE`."""
DriveObserver = Callable[[DriveRecord], object]
"""Observes a drive, and changes nothing: each tick that is done, and each event before the tick that it belongs to.

Ticks are numbered over the drive, from 1 on; their arrays are copies. One that has `close` is closed with the drive.
"""


def happened_in(tick: object) -> set[str]:
    """What a chair's tick, of a drive or a film, counts for: names of the counters of `KpiTotals`."""
    return {counter for field, counter in _COUNTED.items() if getattr(tick, field, False)}


def xy_of(stick: Joystick) -> tuple[float, float]:
    """A stick as pages and films hold it."""
    return round(stick.x, 4), round(stick.y, 4)


def is_intervention(asked: Joystick, given: Joystick) -> bool:
    """Whether what a chair was given follows its user's stick no more, by the tolerance of KPI 1."""
    return math.hypot(asked.x - given.x, asked.y - given.y) > FOLLOWED
