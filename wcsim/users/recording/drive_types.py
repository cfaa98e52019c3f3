"""What a recording of a drive holds: one chair and the person at its joystick, tick by tick (docs/recordings.md)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version

import numpy as np

from wcsim.types import F64, ComparesArrays, Joystick, StartSpec

DRIVE_MAGIC = "wcsim-drive-1"
PERSON = "person"
"""The profile of a recording in which somebody drove who is not simulated."""
RESPAWN = "respawn"
"""The event of an episode that was cut and begun anew: the replay does the same at that tick.

Its detail is the start as JSON, or "" where that was drawn.
"""
USER = "user"
"""The event of another simulated user beside the person, in a chair made anew; its detail is that profile as JSON."""
MOST_SAMPLES = 480  # of the stick in a tick: as many as the steps that a tick's physics may have

NO_ACTION = -1
_SAME_MOTION = ("0.1.0",)
"""Earlier versions in which a stick moves a chair as it does in this one."""


def wcsim_version() -> str:
    """The version that a header names."""
    return version("wcsim")


def moves_as_here(made_by: str) -> bool:
    """Whether a stick moved a chair in that version of wcsim as it does in this one."""
    return made_by in (wcsim_version(), *_SAME_MOTION)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveHeader:
    """What a drive was made with: enough, with its ticks, to make the same drive again."""

    wcsim: str  # version
    fingerprint: str  # the versions that its poses hold for to the last bit
    town: str  # name
    town_address: str  # what finds it on the machine of the drive
    town_sha256: str  # over all of its SUMO input
    seed: int  # of the world
    tick_s: float
    config: str  # JSON of the whole configuration
    profile: str  # of the simulated user, or `PERSON`
    user: str = ""  # JSON of the simulated user's parameters as they were drawn; "" for a person
    beside: str = ""  # JSON of the profile of who sat beside a person, and said where the way goes; "" for nobody
    policy: str = ""  # who assisted; "" for nobody
    level: str = ""  # of the assistance
    episode: str = ""  # of a suite: its name, block and seat
    scene: str = ""  # where the street is a generated scene: its family, seed and SHA-256; "" for a town
    max_steps: int = 10_000
    start: StartSpec | None = None  # of every episode; None where it was drawn

    @property
    def accompanied(self) -> bool:
        """Whether a person drove beside somebody who says where the way goes: a profile, or a scene's recorded user."""
        return bool(self.beside or (self.scene and not self.user))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedTick(ComparesArrays):
    """A tick of a drive: what was done in it, and where the chair was at its end."""

    tick: int  # at its end, of the world
    episode: int
    time_s: float  # at its end, of the drive
    stick: Joystick  # the person's at its beginning, which the policy answered
    intent: Joystick | None = None  # what the person wanted during it, where that is known
    sticks: F64 = field(
        default_factory=lambda: np.zeros((0, 2))
    )  # (S, 2) within it at equal times, the last at its end
    commanded: Joystick  # what the chair was given
    chosen: Joystick  # what the policy chose: the same unless overruled
    action: int = NO_ACTION  # of the action set, as chosen; -1 for none
    p_WB_m: F64  # (3,) at its end, as all that follows
    yaw_rad: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    speed_mps: float
    warning: bool = False
    intervening: bool = False
    overruled: bool = False
    helped: bool = False  # the person asked for help
    arrived: bool = False
    gave_up: bool = False
    crashed: bool = False
    truncated: bool = False

    @property
    def ends(self) -> bool:
        """Whether an episode ended with it."""
        return self.crashed or self.truncated


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedEvent:
    """Something that happened beside the ticks."""

    tick: int  # of the world
    time_s: float  # of the drive
    kind: str  # a word
    detail: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveRecording:
    """A whole recording; see `read_drive`."""

    name: str  # of the file
    header: DriveHeader
    ticks: tuple[RecordedTick, ...]
    events: tuple[RecordedEvent, ...]
    torn: bool  # something that is no whole record followed the last one

    @cached_property
    def episodes(self) -> tuple[tuple[RecordedTick, ...], ...]:
        """The ticks of each episode, in order."""
        found: list[list[RecordedTick]] = []
        for tick in self.ticks:
            if not found or found[-1][-1].episode != tick.episode:
                found.append([])
            found[-1].append(tick)
        return tuple(tuple(part) for part in found)

    @property
    def knows_intents(self) -> bool:
        """Whether what the person wanted is known of every tick."""
        return bool(self.ticks) and all(tick.intent is not None for tick in self.ticks)
