"""What kind of accident a crash was, and whose fault: for tables of crashes, decided from plain facts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

from wcsim.config import RewardConfig
from wcsim.core.frames import rad
from wcsim.supervisor.kpi import DROP
from wcsim.supervisor.rewards import GROUND_KINDS, ROLLING_PARTS, hardest
from wcsim.types import ActorKind, Contact

FALL_REMEMBERED_S: Final = 10.0  # a kerb that is rammed so soon after a fall is a consequence of it
_FALLING_S: Final = 1.0  # so long after its middle left the pavement a chair may still be in the fall


class CrashClass(Enum):
    """The value is what tables say."""

    KERB_AFTER_FALL = "kerb rammed from the road, after a fall"
    KERB = "kerb rammed otherwise"
    FALLING = "body strikes while falling"
    DROP = "drop"
    GROUND = "ground struck otherwise"
    WALL = "wall of a building"
    PEDESTRIAN = "pedestrian"
    FURNITURE = "furniture, tree, pole"
    PARKED = "parked car"
    CYCLIST = "cyclist"
    CAR = "car"
    LARGE = "bus, truck, tram"
    CHAIR = "other wheelchair"
    ROLLOVER = "rollover"
    JOLT = "jolt"
    OTHER = "something else"


_BY_KIND: Final = {
    "building": CrashClass.WALL,
    "static": CrashClass.FURNITURE,
    ActorKind.PEDESTRIAN.value: CrashClass.PEDESTRIAN,
    ActorKind.BICYCLE.value: CrashClass.CYCLIST,
    ActorKind.SCOOTER.value: CrashClass.CYCLIST,
    ActorKind.MOTORCYCLE.value: CrashClass.CAR,
    ActorKind.CAR.value: CrashClass.CAR,
    ActorKind.TRUCK.value: CrashClass.LARGE,
    ActorKind.BUS.value: CrashClass.LARGE,
    ActorKind.TRAM.value: CrashClass.LARGE,
    ActorKind.WHEELCHAIR.value: CrashClass.CHAIR,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CrashFacts:
    """What is known of a crash when it happens."""

    reason: str  # as in Events.crash_reason
    contacts: tuple[Contact, ...]  # of its tick
    on_road: bool  # the chair's middle is on a carriageway
    fell_s: float | None  # since its middle left the pavement over a kerb, None when it has not in this episode
    straddles: bool  # its wheels stand over ground of two heights, as on the edge of a kerb
    kerb_beside: bool  # the ground at its outline is higher than under its middle, by more than a low kerb
    roll_rad: float
    pitch_rad: float
    parked: bool = False  # what it touched is a car on a car park


def classify(facts: CrashFacts, config: RewardConfig) -> CrashClass:
    """The class of a crash; of several things that were touched, the one that was hit hardest decides."""
    if facts.reason == DROP:
        return CrashClass.DROP
    if facts.reason == "tilt":
        return CrashClass.ROLLOVER
    if facts.reason == "acceleration":
        return CrashClass.JOLT
    hit = hardest(facts.reason, facts.contacts, config)
    if hit is None:
        return CrashClass.OTHER
    if hit.kind in GROUND_KINDS:
        return _against_ground(facts, config)
    if facts.parked and hit.kind not in ("building", "static"):
        return CrashClass.PARKED
    return _BY_KIND.get(hit.kind, CrashClass.OTHER)


def meets_kerb(facts: CrashFacts) -> bool:
    """Whether what was struck of the ground is a kerb: who rams one mostly touches the edge of the pavement on it."""
    kerbs = (c for c in facts.contacts if c.kind == "kerb" and c.part not in ROLLING_PARTS)
    return facts.kerb_beside or next(kerbs, None) is not None


def _against_ground(facts: CrashFacts, config: RewardConfig) -> CrashClass:
    """A body or footplate that struck the ground or a kerb."""
    roll_max, pitch_max = rad(config.roll_window_deg[1]), rad(config.pitch_window_deg[1])
    if abs(facts.roll_rad) > roll_max or abs(facts.pitch_rad) > pitch_max:
        return CrashClass.ROLLOVER
    tips_over_edge = facts.straddles and not facts.on_road  # one that rams the kerb has its middle on the road
    if tips_over_edge or (facts.fell_s is not None and facts.fell_s <= _FALLING_S):
        return CrashClass.FALLING
    if not meets_kerb(facts):
        return CrashClass.GROUND
    after_fall = facts.fell_s is not None and facts.fell_s <= FALL_REMEMBERED_S
    return CrashClass.KERB_AFTER_FALL if facts.on_road and after_fall else CrashClass.KERB
