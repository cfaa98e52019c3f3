"""What `python -m benchmarks crashes` finds, record by record; places are those of the chair's middle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class Crash:
    """One crash."""

    seat: int
    episode: int
    tick: int
    step: int  # of the episode
    p_W_m: tuple[float, float]
    way: str  # the walking way that is nearest
    kind: str  # CrashClass value
    reason: str  # as the judge says
    fault: Literal["own", "other"]
    thing: str  # what was hit: an actor's id, or the class of what stands there
    part: str  # of the chair
    impulse_Ns: float
    speed_mps: float  # just before
    in_picture: bool | None  # 0.3 to 1 s before; None when what was hit is not known
    after_fall: bool  # off a kerb within the last 10 s; where the fall itself is the crash it is not after one
    fell_s: float | None  # before, None without a fall in this episode
    away_share: float | None  # of the 2 s before in which the user had looked elsewhere; None when it is not known
    safe_before: bool | None  # whether the oracle had a safe action 1 s before; None in the first second


@dataclass(frozen=True, slots=True, kw_only=True)
class LostControl:
    """One stretch of lost control."""

    seat: int
    episode: int
    tick: int  # at which it began
    seconds: float
    p_W_m: tuple[float, float]
    way: str
    turned: bool  # against the stick
    rolled: bool  # on, with the stick at rest
    roll_deg: float  # the largest of it, as everything below
    pitch_deg: float
    speed_mps: float
    turn_radps: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """How one episode of a seat began and ended."""

    seat: int
    episode: int
    start_W_m: tuple[float, float]
    steps: int
    end: str  # reason of a crash, "cut" after its last step, "" when the run ended first
