"""What a drive tells its observers (a recorder, a test): the records of its log, a tick or an event each."""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol

from wcsim.log.records import DriveTick, Note


class DriverKind(StrEnum):
    """Whose stick counts."""

    PERSON = "person"
    SIMULATED = "simulated"


class EventKind(StrEnum):
    """What is written into a drive's event log."""

    BEGUN = "begun"
    EPISODE = "episode"
    RESPAWN = "respawn"  # the episode begins elsewhere than the world began it, before `EPISODE`
    USER = "user"  # another simulated user sits there, in another chair, before `EPISODE`
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


class DriveObserver(Protocol):
    """Observes a drive, and changes nothing."""

    def tick(self, driven: DriveTick) -> None:
        """A tick is done; its number is of the drive, from 1 on, and its arrays are copies."""

    def event(self, event: Note) -> None:
        """Something has happened, an `EventKind`; comes before the `tick` that it belongs to."""

    def close(self) -> None:
        """The drive is over."""
