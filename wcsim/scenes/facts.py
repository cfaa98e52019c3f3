"""What a scene came to, in numbers that its file can demand."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from wcsim.config.scene import SceneExpect

ALONE_M = 99.0
"""The gap to others when there are none."""
FASTEST_MPS = 99.0
"""The slowest speed when nobody drives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFacts:
    """What a scene came to, over all its seats; angles in degrees, as in the scene's own file."""

    crashed: bool
    arrivals: int
    travelled_m: float
    climb_m: float  # the highest rise of a chair above the height it started at
    drop_m: float  # the deepest fall below it
    rolled_back_m: float  # the longest way that a chair went backwards in one go
    aside_m: float  # how far a chair left the straight line from its start to its goal, or ahead
    narrowest_m: float  # free width of the pavement across a chair, where it was smallest
    max_roll_deg: float
    max_pitch_deg: float
    jolt_mps2: float  # the largest acceleration that an IMU felt
    standing_s: float  # time that chairs stood still before they arrived
    red_starts: int  # how often a chair drove onto a crossing whose light was not green
    green_starts: int
    closest_actor_m: float  # smallest gap between the boxes of a chair and of anything else that moves
    closest_vehicle_m: float  # the same by kind: cars, buses, trams and the like
    closest_rider_m: float  # cyclists, scooters, motorcyclists
    closest_person_m: float
    closest_chair_m: float
    overtaken: int  # others that came up behind a chair and ended ahead of it
    slowest_mps: float  # the lowest speed of a vehicle near a chair, after it has driven
    gave_way: int  # vehicles that braked to less than walking pace near a chair
    went_on: int  # of those, how many drove on
    made_way_m: float  # the farthest that a person stepped aside
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
    return json.dumps(facts_of(facts))


def facts_of(facts: SceneFacts) -> dict[str, bool | float]:
    """Facts by name, for a JSON file."""
    return asdict(facts)
