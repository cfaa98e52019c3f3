"""The reaction battery: chairs that stand in the way for ten minutes.

Places are drawn from the seed on small streets built for it and in a real town; where most traffic comes by is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.reaction.engineless_world import ReactionStage
from benchmarks.reaction.places import KINDS, ChairPlace, busy_places
from benchmarks.reaction.streets import SMALL_STREETS, build_small_street
from wcsim.bridge.reaction.commands import ChairInStreet
from wcsim.config import WorldConfig
from wcsim.core import seeding
from wcsim.errors import TownError
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.street import load_street
from wcsim.towns.sumo.net import read_net
from wcsim.types import ActorState

WAIT_S = 90.0  # for a vehicle to come
_GONE_M = 8.0
_SOON_S = 2.5
_TRIED = 4  # places of a kind, until one is free for a chair to come

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Ten minutes, or less, beside and before a chair that stands."""

    contacts: frozenset[str]
    deflect_overlaps: frozenset[str]
    blocked_s_max: float  # of those that could have passed
    could_pass: int
    passed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Battery:
    """The whole bench; the fields are the keys of its JSON file."""

    standing: dict[str, int]
    passed_share: float
    deflect_overlaps: int
    blocked_s_max: float


@dataclass(slots=True)
class _Passers:
    """Who had room to pass, and who did."""

    longest_s: float = 0.0
    could: set[str] = field(default_factory=set)
    near: set[str] = field(default_factory=set)

    def look(self, stage: ReactionStage, actors: Sequence[ActorState], chair: ChairInStreet) -> None:
        for blocked in stage.blocked():
            if blocked.could_pass:
                self.longest_s = max(self.longest_s, blocked.for_s)
                self.could.add(blocked.actor_id)
        self.could.update(stage.passing())
        self.near = {a.id for a in actors if math.dist(a.p_W_m[:2], chair.p_W_m) < _GONE_M + 0.5 * a.size_lwh_m[0]}


def stand(stage: ReactionStage, place: ChairPlace, duration_s: float) -> Standing | None:
    """Let a chair stand at a place for `duration_s`; None when the place never is free for it to come."""
    chair, tick_s = stage.chair(np.array(place.p_W_m), place.yaw_rad), stage.tick_s
    for _ in range(round(WAIT_S / tick_s)):  # until the chair can come without jumping on anybody
        if not any(_comes_soon(actor, chair) for actor in stage.near(chair.p_W_m[None], 60.0)):
            break
        stage.tick(())
    else:
        return None
    stage.contacts.clear()
    stage.deflected_into.clear()
    passers = _Passers()
    for _ in range(round(duration_s / tick_s)):
        passers.look(stage, stage.tick((chair,)), chair)
    return Standing(
        contacts=frozenset(stage.contacts),
        deflect_overlaps=frozenset(stage.deflected_into),
        blocked_s_max=passers.longest_s,
        could_pass=len(passers.could),
        passed=len(passers.could - passers.near),
    )


def _comes_soon(actor: ActorState, chair: ChairInStreet) -> bool:
    """Whether an actor is at the chair's place, or will be before it could do anything about it."""
    speed_mps = float(np.hypot(*actor.v_W_mps[:2]))
    reach_m = 2.0 + 0.5 * actor.size_lwh_m[0] + _SOON_S * speed_mps
    return math.dist(actor.p_W_m[:2], chair.p_W_m) < reach_m


def run_battery(
    town: str, seed: int, standing_s: float, work: Path, progress: Progress, streets: int = 3, warmup_s: float = 120.0
) -> Battery:
    """Let chairs stand on the small streets, built into the folder `work`, and in a town.

    Args:
        town: Name or path of a town with real streets; "" for the small streets alone.
        seed: Of the traffic and the places.
        standing_s: How long a chair stands at each place.
        work: Where the small streets are built.
        progress: Told what has been done.
        streets: How many of the small ones.
        warmup_s: Before a chair comes; the traffic is watched for places where much of it comes by.

    Raises:
        TownError: no such town, or it offers no place to stand.
    """
    towns = [build_small_street(street, work / street.name, seed) for street in SMALL_STREETS[:streets]]
    standing, every = dict.fromkeys(KINDS, 0), list[Standing]()
    seen = set[str]()
    for each in (*towns, find_town(town)) if town else towns:
        for place, result in _stand_everywhere(
            each, seeding.derive_seed(seed, "site", each.name), standing_s, warmup_s
        ):
            progress(f"{each.name} {place.kind} at {place.p_W_m}: {len(result.contacts)} contacts")
            standing[place.kind] += len(result.contacts)
            seen.add(place.kind)
            every.append(result)
    if len(seen) < len(KINDS):
        raise TownError(f"bench reaction: a kind of place has no traffic in {town!r}; choose another town")
    could = sum(result.could_pass for result in every)
    return Battery(
        standing=standing,
        passed_share=sum(result.passed for result in every) / could if could else 1.0,
        deflect_overlaps=sum(len(result.deflect_overlaps) for result in every),
        blocked_s_max=max(result.blocked_s_max for result in every),
    )


def _stand_everywhere(
    town: Town, seed: int, standing_s: float, warmup_s: float
) -> Iterator[tuple[ChairPlace, Standing]]:
    """A chair stands at one place of each kind."""
    street, config = load_street(town), WorldConfig(attention_share=1.0)

    def stage() -> ReactionStage:
        return ReactionStage(town, street, config, seeding.derive_seed(seed, "sumo"), warmup_s)

    with stage() as first:
        net = read_net(town.net, town.file.origin_m)
        places = busy_places(net, first, warmup_s, seeding.make_rng(seed, "places"))
    for ranked in places.values():
        for place in ranked[:_TRIED]:
            with stage() as own:
                result = stand(own, place, standing_s)
            if result is not None:
                yield place, result
                break
