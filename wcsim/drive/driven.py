"""What a drive tells its observers (a recorder, a test): the records of its log, a tick or an event each."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from wcsim.log.records import Admitted, DriveTick, Note, Respawned


class DriverKind(StrEnum):
    """Whose stick counts."""

    PERSON = "person"
    SIMULATED = "simulated"


class EventKind(StrEnum):
    """What is written into a drive's event log."""

    BEGUN = "begun"
    EPISODE = "episode"
    REBUILT = "rebuilt"  # the world is another one, at its beginning, before `EPISODE`
    DRIVER = "driver"
    ASSISTANCE = "assistance"
    LEVEL = "level"
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
