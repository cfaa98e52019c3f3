"""What a scene came to, in numbers that its file can demand."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass

import numpy as np

from wcsim import frames
from wcsim.bridge.seat import CHAIR_MIDDLE_M
from wcsim.config import SceneExpect
from wcsim.types import ActorState, ClientSnapshot, Snapshot

CHAIR_RADIUS_M = 0.45


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFacts:
    """What a scene came to, over all its seats; angles in degrees, as in the scene's own file."""

    crashed: bool
    travelled_m: float
    drop_m: float  # the deepest fall of a chair below the height it started at
    max_roll_deg: float
    max_pitch_deg: float
    closest_actor_m: float  # smallest gap between a chair's middle circle and another actor's box; 99 when alone
    standing_s: float  # time that chairs stood still
    actors_seen: int


class SceneMeter:
    """Adds up what happens in a scene."""

    def __init__(self, first: Snapshot) -> None:
        self._start_z_m = [float(client.plant.p_WB_m[2]) for client in first.clients]
        self._crashed = False
        self._travelled_m = self._drop_m = self._roll_rad = self._pitch_rad = self._standing_s = 0.0
        self._closest_m = 99.0
        self._seen: set[str] = set()

    def add(self, snapshot: Snapshot, dt_s: float) -> None:
        """One tick."""
        self._seen.update(actor.id for actor in snapshot.actors)
        for client, start_z_m in zip(snapshot.clients, self._start_z_m, strict=True):
            speed_mps = float(np.hypot(*client.plant.v_B_mps[:2]))
            self._crashed |= client.events.crashed
            self._travelled_m += speed_mps * dt_s
            self._standing_s += dt_s * (speed_mps < 0.05)
            self._drop_m = max(self._drop_m, start_z_m - float(client.plant.p_WB_m[2]))
            self._roll_rad = max(self._roll_rad, abs(client.plant.roll_rad))
            self._pitch_rad = max(self._pitch_rad, abs(client.plant.pitch_rad))
            self._closest_m = min([self._closest_m, *(_gap_m(client, actor) for actor in snapshot.actors)])

    def facts(self) -> SceneFacts:
        """What it came to."""
        return SceneFacts(
            crashed=self._crashed,
            travelled_m=self._travelled_m,
            drop_m=self._drop_m,
            max_roll_deg=frames.deg(self._roll_rad),
            max_pitch_deg=frames.deg(self._pitch_rad),
            closest_actor_m=self._closest_m,
            standing_s=self._standing_s,
            actors_seen=len(self._seen),
        )


def _gap_m(client: ClientSnapshot, actor: ActorState) -> float:
    """Gap between the circle around a chair's middle and an actor's box, on the ground plane."""
    yaw = client.plant.yaw_rad
    middle = client.plant.p_WB_m[:2] + CHAIR_MIDDLE_M * np.array([math.cos(yaw), math.sin(yaw)])
    cos, sin = math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)
    dx, dy = middle - actor.p_W_m[:2]
    along = max(abs(dx * cos + dy * sin) - 0.5 * actor.size_lwh_m[0], 0.0)
    aside = max(abs(dy * cos - dx * sin) - 0.5 * actor.size_lwh_m[1], 0.0)
    return math.hypot(along, aside) - CHAIR_RADIUS_M


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
