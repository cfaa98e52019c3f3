"""A world's traffic with wheelchairs that are led by hand, without an engine: who touches whom, seen from above.

Contacts are overlaps of the chair's rectangle with a vehicle's box or a person's disc, as the bridge mirrors them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wcsim.bridge.epoch import ReactingTraffic
from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.bridge.reaction.commands import CHAIR, ROADWAY, VEHICLE, ActorCommand, Blocked, ChairInStreet
from wcsim.bridge.sumo.session import SumoOptions, SumoSession
from wcsim.config import ChairConfig, WorldConfig
from wcsim.core.boxes import box_from_actor, boxes_touch, gap_to_box
from wcsim.core.closing import ClosingContextBase
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scenario.town import Town
from wcsim.types import F64, ActorState, Street

_TOUCH_M = 0.01  # bodies that share less than this only touch


class ReactionStage(ClosingContextBase):
    """A `ReactingTraffic` and any chairs; `deflected_into` and `contacts` collect what should not happen."""

    def __init__(self, town: Town, street: Street, config: WorldConfig, seed: int, warmup_s: float) -> None:
        """Start SUMO and let it run for `warmup_s`. Raises WorldInUseError, SumoError."""
        self._ground = street.grid
        self.half_m = plant_spec(ChairConfig()).outline.half_lw_m  # of its chairs
        self._config = config
        self.contacts: set[str] = set()
        self.deflected_into: set[str] = set()
        self._still: set[str] = set()  # of the people whom SUMO itself does not move
        self._places: dict[str, tuple[float, ...]] = {}  # where it had them a tick ago
        self._sumo = SumoSession(replace(_options(town, street, config, seed), warmup_s=warmup_s))
        self._traffic = ReactingTraffic(config, street.grid, self._sumo, AttentionModel(config, seed))

    def tick(self, chairs: Sequence[ChairInStreet]) -> tuple[ActorState, ...]:
        """One tick with the chairs where they are; the actors near them afterwards."""
        here_W_m = np.array([chair.p_W_m for chair in chairs]).reshape(-1, 2)
        self._traffic.react(tuple(chairs))
        self._sumo.step()
        near = self._traffic.read(here_W_m)
        self._traffic.move(near, here_W_m)
        self._look(near, chairs)
        places = {actor.id: tuple(actor.p_W_m[:2].tolist()) for actor in near if actor.is_person}
        slow = {actor.id for actor in near if actor.is_person and float(np.hypot(*actor.v_W_mps[:2])) < 0.1}
        self._still = slow | {name for name, place in places.items() if self._places.get(name) == place}
        self._places = places
        return self._traffic.actors

    def apply(self, order: ActorCommand) -> None:
        """Have an actor told something."""
        self._sumo.pilot.apply(order)

    def blocked(self) -> tuple[Blocked, ...]:
        """Who stands because of a chair now; who only queues behind somebody that does not go on could not pass."""
        blocked = self._traffic.blocked()
        stuck = {one.actor_id for one in blocked if not one.could_pass}
        behind = {one.actor_id: one.behind for one in blocked if one.behind}
        queue = queue_behind(behind, stuck | self._still.difference(one.actor_id for one in blocked) | {VEHICLE})
        return tuple(replace(one, could_pass=one.could_pass and one.actor_id not in queue) for one in blocked)

    def passing(self) -> tuple[str, ...]:
        """Who is on a way round a chair now."""
        aside = (actor.id for actor in self._traffic.actors if actor.deflect_m and actor.is_person)
        return (*self._traffic.passing(), *aside)

    @property
    def tick_s(self) -> float:
        """Length of a tick."""
        return self._config.tick_s

    def near(self, here_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """The actors near these points as SUMO has them."""
        return self._sumo.actors(here_W_m, radius_m)

    def chair(self, p_W_m: F64, yaw_rad: float, speed_mps: float = 0.0) -> ChairInStreet:
        """A chair at a place of this street."""
        x, y = p_W_m.tolist()
        return ChairInStreet(
            p_W_m=p_W_m,
            v_W_mps=speed_mps * np.array([math.cos(yaw_rad), math.sin(yaw_rad)]),
            on_road=self._ground.class_here(x, y) in ROADWAY,
            half_m=self.half_m,
            yaw_rad=yaw_rad,
            z_m=self._ground.height_here(x, y),
        )

    def close(self) -> None:
        """End SUMO."""
        self._sumo.close()

    def _look(self, near: Sequence[ActorState], chairs: Sequence[ChairInStreet]) -> None:
        for actor, bare in zip(self._traffic.actors, near, strict=True):
            for chair in chairs:
                if touches_chair(actor, chair):
                    self.contacts.add(actor.whole_id)
            if (actor.p_W_m[:2] != bare.p_W_m[:2]).any() and self._pushed_into_something(actor, bare, near):
                self.deflected_into.add(actor.id)

    def _pushed_into_something(self, actor: ActorState, bare: ActorState, near: Sequence[ActorState]) -> bool:
        """Whether a person's deflection, and not SUMO itself, has it overlap a wall, a vehicle or another person."""
        radius_m = _radius_m(actor)
        walls = [float(self._ground.clearance_at(a.p_W_m)) for a in (actor, bare)]
        if walls[0] < min(radius_m - 0.1, walls[1]):  # the raster's cells are 0.1 m
            return True
        return any(
            other.id != actor.id
            and _overlap_m(actor, other) > max(_TOUCH_M, _overlap_m(bare, other_bare) + _TOUCH_M)
            and (other.is_person or _overlap_m(bare, other_bare) <= _TOUCH_M)  # else SUMO itself has them meet
            for other, other_bare in zip(self._traffic.actors, near, strict=True)
            if abs(other.p_W_m[0] - actor.p_W_m[0]) + abs(other.p_W_m[1] - actor.p_W_m[1]) < 15.0
        )


def touches_chair(actor: ActorState, chair: ChairInStreet) -> bool:
    """Whether an actor's body overlaps a wheelchair's footprint."""
    x, y = chair.p_W_m.tolist()
    box = (x, y, math.cos(chair.yaw_rad), math.sin(chair.yaw_rad), *chair.half_m)
    if actor.is_person:
        px, py, _ = actor.p_W_m.tolist()
        return gap_to_box(px, py, *box) < _radius_m(actor) - _TOUCH_M
    return bool(boxes_touch(*box_from_actor(actor, -_TOUCH_M), *box))


def _overlap_m(person: ActorState, other: ActorState) -> float:
    x, y, _ = person.p_W_m.tolist()
    if other.is_person:
        ox, oy, _ = other.p_W_m.tolist()
        return _radius_m(person) + _radius_m(other) - math.hypot(x - ox, y - oy)
    return _radius_m(person) - float(gap_to_box(x, y, *box_from_actor(other)))


def _radius_m(person: ActorState) -> float:
    return 0.5 * max(person.size_lwh_m[:2])


def _options(town: Town, street: Street, config: WorldConfig, seed: int) -> SumoOptions:
    return SumoOptions(
        sumocfg=town.sumocfg,
        origin_m=town.file.origin_m,
        settings=Settings(world=config, seed=seed),
        z_origin_m=street.net_origin_m[2],
    )


def queue_behind(behind: dict[str, str], ends: set[str]) -> set[str]:
    """Who stands behind one of `ends`, or behind somebody who does; `behind` names for each the one before it."""
    queue: set[str] = set()
    for first in behind:
        name, way = first, {first}
        # People may stand behind one another in a ring, hence the set of those on the way.
        while (name := behind.get(name, CHAIR)) and name not in way and name not in ends and name not in queue:
            way.add(name)
        if name in ends or name in queue:
            queue |= way
    return queue
