"""What a drive tells of itself: one record a tick, and events, for whoever looks on (a recorder, a test)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from wcsim.types import F64, Joystick
from wcsim.types.arrays import ComparesArrays


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrivenTick(ComparesArrays):
    """One tick of a drive: who asked for what, what the chair was told, where it then was. Arrays are copies."""

    tick: int  # of the drive, the first is 1; it counts on over episodes
    time_s: float  # of driving since the drive began, at the tick's end
    episode: int  # of the drive, the first is 0
    step: int  # of the episode, the first is 1
    driver: DriverKind
    stick: Joystick  # what the person, or the simulated user, asked for
    intent: Joystick | None  # what the simulated user wants, before its hand; None of a person, where it is not known
    sticks: F64  # (S, 2) the simulated user's within the tick, the last at its end; (0, 2) of a person
    action: int  # the number of `chosen`
    chosen: Joystick  # the policy's answer; the nearest position to the stick where it is off
    commanded: Joystick  # what the chair was told
    unsafe: tuple[int, ...]  # actions that the policy holds for unsafe, empty where it does not say
    assisted: bool  # the policy is on
    level: float | None  # of assistance; None for a policy without levels
    warning: bool
    intervening: bool  # the commanded position follows the stick no more (KPI 1's tolerance)
    overruled: bool  # the person holds the button that takes the policy's say away
    help_asked: bool  # the person asked for help in this tick
    p_WB_m: F64  # (3,) of the drive axle's middle, after the tick
    yaw_rad: float
    roll_rad: float
    pitch_rad: float
    speed_mps: float  # forwards
    joystick_distance: float  # between stick and command, KPI 1's
    progress_m: float  # along the route during this tick
    arrived: bool
    gave_up: bool
    crashed: bool
    crash_reason: str  # "", "collision", "drop", "acceleration", "tilt"
    truncated: bool  # at the step limit
    seed: int  # of the world
    town: str
    profile: str
    policy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveEvent:
    """Something that happened in a drive."""

    kind: EventKind
    tick: int  # of the drive, 0 before the first
    time_s: float
    told: str = ""  # what there is to say of it, in words


class DriveObserver(Protocol):
    """Somebody who looks on at a drive, and changes nothing."""

    def tick(self, driven: DrivenTick) -> None:
        """A tick is done."""

    def event(self, event: DriveEvent) -> None:
        """Something has happened; comes before the `tick` that it belongs to."""

    def close(self) -> None:
        """The drive is over."""
