"""What is said of a command, held against a copy of the world in which it is given: twelve kinds of states.

A drive is done in a copy first; it says when the verdict on the stick changes and when the chair crashes. The same
drive then stops at some of these ticks. There commands next to the other verdict, and some by chance, are given in
copies of the world: held for half a second, then let go until the chair stands. What the engine says of contacts, tilt
and falls is the physics' verdict; nothing of the oracle is asked for it. Two ends are told apart: others who hit a
chair, whatever it does; and a chair that stands while a wheel touches nothing, over the edge of a kerb.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Final

import numpy as np

from benchmarks.judge.held_stick import HeldStreet, given
from benchmarks.judge.kerb_places import KerbCase, facing, kerb_starts
from benchmarks.judge.starts import PLANTS, place_of
from wcsim.agents.policy_api import TellsUnsafe
from wcsim.bridge.world_copy import in_copy
from wcsim.bridge.world_rollout import rollout
from wcsim.towns.scenario.town import find_town
from wcsim.types import F64, ActorKind, Bool, ClassId, ClientSnapshot, Joystick, StartSpec

BEFORE_S: Final = 3.0
STATES: Final = 5  # of a drive
STICKS: Final = 6  # of a state, half of them next to the other verdict
DRIVE_TICKS: Final = 60
_PEOPLE, _RIDERS = (ActorKind.PEDESTRIAN,), (ActorKind.BICYCLE, ActorKind.SCOOTER, ActorKind.MOTORCYCLE, ActorKind.CAR)


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """One command in one state; seconds until it goes wrong, None where it does not."""

    kind: str
    policy: str
    plant: str
    stick: tuple[float, float]
    near: bool  # next to the other verdict
    physics_s: float | None
    end: str  # "own", "other", "hangs", or "" for a chair that stands
    oracle_s: float | None
    unsafe: bool | None  # the policy's own word; None for one that says nothing


def kinds() -> tuple[str, ...]:
    """The twelve names."""
    return (*_KERBS, *_GROUND, *_SOLID, *_ACTORS)


_KERBS: Final = {
    "kerb up, straight": KerbCase(),
    "kerb up, oblique": KerbCase(angle_deg=45.0),
    "kerb up, backwards": KerbCase(backwards=True),
    "kerb down, straight": KerbCase(below=False),
    "kerb down, oblique": KerbCase(below=False, angle_deg=50.0),
    "kerb down, backwards": KerbCase(below=False, backwards=True),
}
_GROUND: Final = ("lowered kerb or ramp", "grass")
_SOLID: Final = ("wall or pole, ahead", "wall or pole, turning")
_ACTORS: Final = ("people", "riders and cars")


def ask_everywhere(policies: tuple[str, ...], towns: tuple[str, ...], drives: int, seed: int) -> Iterator[Asked]:
    """Drive so often with each policy, chair and town in each kind."""
    for town in towns:
        for plant in PLANTS:
            for policy in policies:
                with HeldStreet(find_town(town), policy, plant, seed) as street:
                    place_W_m = place_of(street, seed)
                    for kind in kinds():
                        yield from asked(street, kind, drives, place_W_m, seed)


def asked(street: HeldStreet, kind: str, drives: int, place_W_m: F64, seed: int) -> Iterator[Asked]:
    """Drive so many times in states of a kind, and ask in some ticks of each."""
    rng = np.random.default_rng([seed, kinds().index(kind)])
    starts = islice(_starts(street, kind, place_W_m, rng), 20 * drives)
    for _ in islice(filter(None, (street.begin(start, stick) for start, stick in starts)), drives):
        ticks = json.loads(in_copy(street.world, lambda _copy: _ticks(street)))
        yield from _ask_at(street, kind, _chosen(ticks["changes"], ticks["steps"], rng), rng)


def _starts(
    street: HeldStreet, kind: str, near_W_m: F64, rng: np.random.Generator
) -> Iterator[tuple[StartSpec, Joystick]]:
    """The stick is pushed with a little to one side."""
    if kind in _KERBS:
        case = _KERBS[kind]
        for start in kerb_starts(street.world.street, case, near_W_m, rng):
            yield start, Joystick(float(rng.normal(0.0, 0.2)), case.stick.y)
        return
    for _ in range(20_000):
        if kind in _ACTORS:
            found = _before_actor(street, _PEOPLE if kind == "people" else _RIDERS, rng)
        else:
            found = _on_ground(street, kind, near_W_m, rng)
        if found is None:
            continue
        turning = kind == "wall or pole, turning"
        ahead = -1.0 if turning and rng.random() < 0.4 else 0.9
        yield found, Joystick(float(np.clip(rng.normal(0.0, 0.7 if turning else 0.2), -1.0, 1.0)), ahead)


def _on_ground(street: HeldStreet, kind: str, near_W_m: F64, rng: np.random.Generator) -> StartSpec | None:
    """A place of a kind of ground, or a little before something solid."""
    grid = street.world.street.grid
    place = near_W_m + rng.uniform(-120.0, 120.0, 2)
    yaw_rad, clear_m = float(rng.uniform(-math.pi, math.pi)), float(grid.clearance_at(place))
    ground, ahead = int(grid.class_at(place)), np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    if kind in _SOLID:
        faces = float(grid.clearance_at(place + 0.5 * ahead)) < clear_m - 0.3
        fits = 1.2 < clear_m < 2.5 and (faces or kind == "wall or pole, turning")
    elif kind == "grass":
        fits = ground in (ClassId.TERRAIN, ClassId.GROUND, ClassId.VEGETATION) and clear_m > 1.2
    else:
        line = place + np.arange(0.5, 3.0, 0.1)[:, None] * ahead
        raised_m = grid.raised_at(line)
        fits = clear_m > 1.2 and bool(((raised_m > 0.02) & (raised_m < 0.1)).sum() >= 2)
    return facing(place, yaw_rad, near_W_m) if fits else None


def _before_actor(street: HeldStreet, which: tuple[ActorKind, ...], rng: np.random.Generator) -> StartSpec | None:
    """A place some metres from somebody who is near the chair now, facing them more or less."""
    actors = [actor for actor in street.world.snapshot.actors if actor.kind in which]
    if not actors:
        next(rollout(street.world))
        return None
    actor = actors[int(rng.integers(len(actors)))]
    from_rad, grid = float(rng.uniform(-math.pi, math.pi)), street.world.street.grid
    place = actor.p_W_m[:2] + float(rng.uniform(2.0, 5.0)) * np.array([math.cos(from_rad), math.sin(from_rad)])
    if float(grid.clearance_at(place)) < 1.0:
        return None
    return facing(place, from_rad + math.pi + float(rng.normal(0.0, 0.3)), place)


def _ticks(street: HeldStreet) -> bytes:
    """Of a drive in a copy: those in which the verdict on the stick changes, and the last ones."""
    said: list[bool] = []

    def note(now: ClientSnapshot) -> None:
        said.append(now.truth is not None and now.truth.danger)

    driven = street.drive(DRIVE_TICKS, note)
    changes = [tick for tick in range(1, len(said)) if said[tick] is not said[tick - 1]]
    return json.dumps({"changes": changes, "steps": driven.steps}).encode()


def _chosen(changes: list[int], steps: int, rng: np.random.Generator) -> list[int]:
    """Where to stop: around a change, and in the last three seconds."""
    around = {tick + by for tick in changes[:2] for by in (-1, 0)}
    last = range(max(0, steps - round(BEFORE_S / 0.1)), steps)
    more = rng.choice(list(last), size=min(len(last), STATES), replace=False).tolist() if len(last) else []
    return sorted({tick for tick in [*around, *more][:STATES] if 0 <= tick < steps})


def _ask_at(street: HeldStreet, kind: str, ticks: list[int], rng: np.random.Generator) -> Iterator[Asked]:
    found: list[Asked] = []
    count = iter(range(DRIVE_TICKS + 1))

    def ask(now: ClientSnapshot) -> None:
        tick = next(count)
        if tick not in ticks or now.truth is None:
            return
        safe = now.truth.safe_actions
        edge = _next_to_other(safe, street)
        sides = (rng.permutation(np.flatnonzero(edge & safe)), rng.permutation(np.flatnonzero(edge & ~safe)))
        near = np.concatenate([side[: STICKS // 4 + 1] for side in sides])[: STICKS // 2]
        more = rng.permutation(len(safe))[: STICKS - len(near)]
        own = street.policy.unsafe if isinstance(street.policy, TellsUnsafe) else None
        for action in (*near.tolist(), *more.tolist()):
            stick = street.actions.points[action]
            after_s, end = json.loads(in_copy(street.world, partial(given, stick=Joystick(*stick.tolist()))))
            found.append(
                Asked(
                    kind=kind,
                    policy=street.policy.name,
                    plant=street.config.chair.plant,
                    stick=(float(stick[0]), float(stick[1])),
                    near=action in near,
                    physics_s=after_s,
                    end=end,
                    oracle_s=None if safe[action] else float(now.truth.first_s[action]),
                    unsafe=None if own is None else bool(own[action]),
                )
            )

    if ticks:
        street.drive(max(ticks) + 1, ask)
    yield from found


def _next_to_other(safe: Bool, street: HeldStreet) -> Bool:
    """(A,) which actions have a neighbour on the lattice with the other verdict."""
    points = street.actions.points
    close = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) < 0.26
    return np.asarray((close & (safe[:, None] != safe[None])).any(axis=1))
