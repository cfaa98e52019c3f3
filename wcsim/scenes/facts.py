"""What a scene came to, in numbers that its file can demand."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from wcsim.config.scene import SceneExpect

ALONE_M = 99.0
"""The gap to others when there are none."""
FASTEST_MPS = 99.0
"""The slowest speed when no vehicle drives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFacts:
    """What a scene came to, over all its seats, by the names of `SceneExpect`, which says what each is."""

    crashed: bool
    arrivals: int
    travelled_m: float
    climb_m: float
    drop_m: float
    rolled_back_m: float
    aside_m: float
    narrowest_m: float
    max_roll_deg: float
    max_pitch_deg: float
    jolt_mps2: float
    standing_s: float
    red_starts: int
    green_starts: int
    closest_actor_m: float
    closest_vehicle_m: float
    closest_rider_m: float
    closest_person_m: float
    closest_chair_m: float
    overtaken: int
    slowest_mps: float
    gave_way: int
    went_on: int
    made_way_m: float
    actors_seen: int


def faults(facts: SceneFacts, expect: SceneExpect) -> tuple[str, ...]:
    """Where what happened is not what the scene must show; empty when all is well."""
    found = []
    if expect.crashed is not None and facts.crashed != expect.crashed:
        found.append(f"crashed is {facts.crashed}, expected {expect.crashed}")
    for name in SceneExpect.model_fields:
        window = getattr(expect, name)
        if isinstance(window, tuple) and not window[0] <= getattr(facts, name) <= window[1]:
            found.append(f"{name} is {getattr(facts, name):.3f}, expected {window[0]:g} to {window[1]:g}")
    return tuple(found)


def facts_from_line(text: str) -> SceneFacts:
    """The inverse of `facts_line`."""
    return SceneFacts(**json.loads(text.strip().splitlines()[-1]))


def facts_line(facts: SceneFacts) -> str:
    """Facts as one line of JSON."""
    return json.dumps(asdict(facts))
