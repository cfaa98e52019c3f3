"""The reaction battery: chairs that stand in the way for ten minutes, and chairs that roll out before traffic.

Places are drawn from the seed on small streets built for it and in a real town; where most traffic comes by is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.reaction.engineless_world import ReactionStage, touches_chair
from benchmarks.reaction.places import KINDS, ChairPlace, RollOut, busy_places, roll_outs
from benchmarks.reaction.streets import SMALL_STREETS, build_small_street
from wcsim.bridge.reaction.commands import ChairInStreet
from wcsim.config import WorldConfig
from wcsim.core import seeding
from wcsim.errors import TownError
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.street import load_street
from wcsim.towns.sumo.net import read_net
from wcsim.types import ActorState, Street

_WARMUP_S = 120.0
BEFORE_S = 2.5  # so far ahead of the next vehicle the chair comes out
_ROLL_MPS = 1.2
_ROLL_S = 12.0
WAIT_S = 90.0  # for a vehicle to come
_CALM_S = 8.0  # without a chair, between two trials
_GONE_M = 8.0
_SOON_S = 2.5
CLEAR_M = 1.5
STANDS_MPS = 0.3
_SPARE_PLACES = 3

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
    roll_out: dict[str, int]
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


def roll_out(stage: ReactionStage, way: RollOut) -> bool | None:
    """One trial: the chair comes out 2.5 s before the next vehicle would be there; whether anything touched it.

    It does not drive into what stands in its way. None when no vehicle came within the time that a trial waits.
    """
    tick_s, place = stage.tick_s, np.array(way.start_W_m)
    for _ in range(round(WAIT_S / tick_s)):
        stage.tick(())
        near = stage.near(place[None], 60.0)
        free = all(math.dist(a.p_W_m[:2], place) > CLEAR_M + 0.5 * a.size_lwh_m[0] for a in near)
        soonest_s = min((way.arrives_s(actor) for actor in near), default=math.inf)
        if free and BEFORE_S - 2.0 * tick_s < soonest_s <= BEFORE_S:
            break
    else:
        return None
    stage.contacts.clear()
    step_m = tick_s * _ROLL_MPS * np.array([math.cos(way.yaw_rad), math.sin(way.yaw_rad)])
    actors: tuple[ActorState, ...] = ()
    for _ in range(round(_ROLL_S / tick_s)):
        ahead = stage.chair(place + 3.0 * step_m, way.yaw_rad)
        waits = any(np.hypot(*a.v_W_mps[:2]) < STANDS_MPS and touches_chair(a, ahead) for a in actors)
        place = place if waits else place + step_m
        actors = stage.tick((stage.chair(place, way.yaw_rad, 0.0 if waits else _ROLL_MPS),))
    touched = bool(stage.contacts)
    for _ in range(round(_CALM_S / tick_s)):
        stage.tick(())
    return touched


@dataclass(frozen=True, slots=True, kw_only=True)
class BatteryOrder:
    """What to run."""

    town: str  # name or path of a town with real streets; "" for the small streets alone
    seed: int  # of the traffic, the places and the trials
    standing_s: float  # how long a chair stands at each place
    trials: int  # roll-outs at each share of attention
    streets: int  # of the small ones
    places: int  # of each kind in the town
    warmup_s: float = _WARMUP_S  # before a chair comes; the traffic is watched for places where much of it comes by


def run_battery(order: BatteryOrder, work: Path, progress: Progress) -> Battery:
    """Run everything, with the small streets in the folder `work`; `progress` is told what has been done.

    Raises:
        TownError: no such town, or it offers no place to stand.
    """
    sites = list(_sites(order, work))
    results: dict[str, list[Standing]] = {kind: [] for kind in KINDS}
    hits = {1: 0, 0: 0}
    done = 0
    for i, site in enumerate(sites):
        for kind, result in site.stand_everywhere(order.standing_s, progress):
            results[kind].append(result)
        share = order.trials // len(sites) + (i < order.trials % len(sites))
        ways = site.ways(share)
        rolled = {attention: site.roll(ways, share, attention, progress) for attention in (1, 0)}
        tried = min(len(touched) for touched in rolled.values())
        done += tried
        hits = {attention: hits[attention] + sum(rolled[attention][:tried]) for attention in hits}
    missing = [kind for kind in KINDS if not results[kind]]
    if missing:
        raise TownError(f"bench reaction: no {missing[0]} with traffic in {order.town!r}; choose another town")
    return _battery(results, hits, done)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Site:
    """One street or town of the battery."""

    town: Town
    street: Street
    seed: int
    per_kind: int
    warmup_s: float

    def stage(self, attention: float) -> ReactionStage:
        config = WorldConfig(attention_share=attention)
        return ReactionStage(self.town, self.street, config, seeding.derive(self.seed, "sumo"), self.warmup_s)

    def stand_everywhere(self, standing_s: float, progress: Progress) -> Iterator[tuple[str, Standing]]:
        net = read_net(self.town.net, self.town.file.origin_m)
        with self.stage(1.0) as stage:
            places = busy_places(net, stage, self.warmup_s, seeding.generator(self.seed, "places"))
        for kind, ranked in places.items():
            found = 0
            for place in ranked[: self.per_kind + _SPARE_PLACES]:
                if found == self.per_kind:
                    break
                with self.stage(1.0) as stage:
                    result = stand(stage, place, standing_s)
                if result is not None:
                    found += 1
                    progress(_told(self.town.name, place, result))
                    yield kind, result

    def ways(self, trials: int) -> Sequence[RollOut]:
        """Where the chairs of so many trials come out."""
        net = read_net(self.town.net, self.town.file.origin_m)
        with self.stage(1.0) as stage:
            return roll_outs(net, stage, trials, self.warmup_s, seeding.generator(self.seed, "roll-outs"))

    def roll(self, ways: Sequence[RollOut], trials: int, attention: int, progress: Progress) -> list[bool]:
        """For each trial whether anything touched the chair; fewer than asked where no vehicle comes by."""
        found: list[bool] = []
        with self.stage(float(attention)) as stage:
            for i in range(4 * trials):
                if len(found) == trials:
                    break
                touched = roll_out(stage, ways[i % len(ways)])
                if touched is not None:
                    found.append(touched)
        progress(
            f"{self.town.name} rolling out, attention {attention}: {sum(found)} of {len(found)} trials with contact"
        )
        return found


def _sites(order: BatteryOrder, work: Path) -> Iterator[_Site]:
    for street in SMALL_STREETS[: order.streets]:
        yield _site(order, build_small_street(street, work / street.name, order.seed), street.name, 1)
    if order.town:
        town = find_town(order.town)
        yield _site(order, town, town.name, order.places)


def _site(order: BatteryOrder, town: Town, name: str, per_kind: int) -> _Site:
    seed = seeding.derive(order.seed, "site", name)
    return _Site(town=town, street=load_street(town), seed=seed, per_kind=per_kind, warmup_s=order.warmup_s)


def _told(town: str, place: ChairPlace, result: Standing) -> str:
    x, y = place.p_W_m
    return (
        f"{town} {place.kind} at {x:.1f}, {y:.1f}: {len(result.contacts)} contacts, "
        f"{result.passed} of {result.could_pass} passed, longest wait {result.blocked_s_max:.1f} s"
    )


def _battery(results: dict[str, list[Standing]], hits: dict[int, int], trials: int) -> Battery:
    every = [result for found in results.values() for result in found]
    could = sum(result.could_pass for result in every)
    return Battery(
        standing={kind: sum(len(result.contacts) for result in results[kind]) for kind in KINDS},
        roll_out={"attention_1": hits[1], "attention_0": hits[0], "trials": trials},
        passed_share=sum(result.passed for result in every) / could if could else 1.0,
        deflect_overlaps=sum(len(result.deflect_overlaps) for result in every),
        blocked_s_max=max(result.blocked_s_max for result in every),
    )
