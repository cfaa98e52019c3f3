"""What a drive tells its observers (a recorder, a test): one record a tick, and events; and its metrics so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from wcsim.supervisor.kpi import STANDS_MPS
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
    told: str = ""  # details in words


class DriveObserver(Protocol):
    """Observes a drive, and changes nothing."""

    def tick(self, driven: DrivenTick) -> None:
        """A tick is done."""

    def event(self, event: DriveEvent) -> None:
        """Something has happened; comes before the `tick` that it belongs to."""

    def close(self) -> None:
        """The drive is over."""


@dataclass(slots=True, kw_only=True)
class DriveMetrics:
    """The two KPIs of a drive as it goes, its distance, and counts of events; `add` is called with each tick."""

    ticks: int = 0
    distance_sum: float = 0.0  # of joystick distances
    way_m: float = 0.0
    moving_ticks: int = 0
    arrivals: int = 0
    given_up: int = 0
    crashes: int = 0
    helps: int = 0  # counted as they are heard
    overrules: int = 0  # presses
    warnings: int = 0  # stretches of ticks, as the next
    interventions: int = 0
    episode_steps: list[int] = field(default_factory=list)  # of those that have ended
    steps: int = 0  # of the episode that is on, from a handover on; 0 once it has ended
    _before: tuple[bool, bool, bool] = (False, False, False)

    def add(self, driven: DrivenTick, tick_s: float) -> None:
        """One tick."""
        self.ticks += 1
        self.steps += 1
        self.distance_sum += driven.joystick_distance
        self.way_m += abs(driven.speed_mps) * tick_s
        self.moving_ticks += abs(driven.speed_mps) > STANDS_MPS
        self.arrivals += driven.arrived
        self.given_up += driven.gave_up
        self.crashes += driven.crashed
        now = (driven.warning, driven.intervening, driven.overruled)
        begun = [is_on and not was for is_on, was in zip(now, self._before, strict=True)]
        self.warnings += begun[0]
        self.interventions += begun[1]
        self.overrules += begun[2]
        self._before = now
        if driven.crashed or driven.truncated:  # a drive may end before the next episode begins
            self.end_episode()

    def end_episode(self) -> None:
        """The episode is over, by a crash, its step limit, or because somebody began another."""
        if self.steps:
            self.episode_steps.append(self.steps)
        self.steps = 0

    @property
    def kpi1(self) -> float | None:
        """Mean joystick distance, KPI 1; None before the first tick."""
        return self.distance_sum / self.ticks if self.ticks else None

    @property
    def kpi2(self) -> float:
        """Mean steps that an episode lived, KPI 2; of the one that is on while none has ended."""
        ended = self.episode_steps
        return sum(ended) / len(ended) if ended else float(self.steps)
