"""The street notices the wheelchairs: drivers and cyclists brake for one in their way, pass it where there is room.

SUMO never learns of the chairs; what they do to the traffic goes through its own speed, lane and sublane commands,
because placing a proxy with `moveToXY` kills libsumo on real nets. Drivers see a chair one tick late. Who does not
look (1 - attention share) is drawn once per actor from the seed, so it does not depend on the order of things; share
and reaction time are those towards each chair.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.bridge.reaction.commands import LET_GO, ActorCommand, Blocked, ChairInStreet, is_person
from wcsim.bridge.reaction.conflict import lands_on, look_m
from wcsim.bridge.reaction.driver_model import DriverPlan, WaitingTimes, braking, command, considered, perceive, waited
from wcsim.bridge.reaction.swept_path import Brakes, OnLane, Roads, Tube, way_ahead
from wcsim.bridge.reaction.wide_turns import SwingOut
from wcsim.config import WorldConfig
from wcsim.types import F64, ActorState

_Seen = tuple[ChairInStreet, F64]  # with its row
BRAKE_MPS2 = 4.5  # deceleration that drivers and cyclists plan with, at most
COMFORT_SHARE = 0.6  # of the brakes that a driver plans with


class _Watch(NamedTuple):
    """What the reaction remembers of a vehicle that has a chair near its way."""

    brakes: Brakes
    waiting: WaitingTimes = WaitingTimes()
    seen_s: Mapping[AttentionModel, float] = MappingProxyType({})  # since chairs are near, by its habits towards them
    could_pass: bool = False
    held: bool = False
    toward: tuple[str, int] | None = None  # edge and lane that it was told to change to
    moves_over: bool = False  # was told to: SUMO remembers that until it could do it


class StreetReaction:
    """Decides each tick which drivers and riders brake for a wheelchair or pass it, and who is let go again."""

    def __init__(self, config: WorldConfig, habits: AttentionModel, swing: SwingOut | None = None) -> None:
        self._config = config
        self._habits = habits
        self._swing = swing
        self._watched: dict[str, _Watch] = {}
        self._tubes: dict[str, Tube] = {}
        self._come: Collection[str] = ()

    def react(
        self, actors: Iterable[ActorState], chairs: Sequence[ChairInStreet], roads: Roads
    ) -> tuple[ActorCommand, ...]:
        """Orders for this tick, in the actors' order; a vehicle that no chair is near any more is let go once."""
        orders: list[ActorCommand] = []
        watched: dict[str, _Watch] = {}
        rows = [chair.row() for chair in chairs]
        places_W_m = [(row.item(0), row.item(1)) for row in rows]
        seen: set[str] = set()
        for actor in actors:
            if is_person(actor) or actor.piece:  # a rear piece runs where its front has run
                continue
            seen.add(actor.id)
            led = actor if self._swing is None else self._swing.led(actor)
            near = self._may_matter(led, places_W_m)
            watch = self._watch(led, roads, chairs, rows, near, orders) if near else None
            if watch is not None:
                watched[actor.id] = watch
        # In the order of the last tick, as orders to SUMO must have one.
        gone = [name for name, watch in self._watched.items() if watch.held and name not in watched]
        orders += [ActorCommand(actor_id=name, speed_mps=LET_GO) for name in gone]
        self._tubes = {name: tube for name, tube in self._tubes.items() if name in seen}
        self._watched = watched
        return tuple(orders)

    def turned_away(
        self, actors: Iterable[ActorState], chairs: Sequence[ChairInStreet], come: Collection[str]
    ) -> tuple[str, ...]:
        """Who has just been put on top of a chair, or less than a tick before it, by SUMO, which does not see it.

        Args:
            actors: Those near the chairs after SUMO's step.
            chairs: The wheelchairs.
            come: Who came into being in this step: departed, or ended a teleport. Only these have no way behind them,
                so they see the chair at once and begin at any speed.
        """
        self._come = come
        if not come:
            return ()
        rows = [chair.row() for chair in chairs]
        fresh = [actor for actor in actors if actor.id in come]
        return tuple(actor.id for actor in fresh if any(lands_on(actor, row, self._config.tick_s) for row in rows))

    def blocked(self) -> tuple[Blocked, ...]:
        """The vehicles that stand because of a chair now."""
        return tuple(
            Blocked(actor_id=name, for_s=watch.waiting.stands_s, could_pass=watch.could_pass)
            for name, watch in self._watched.items()
            if watch.waiting.stands_s > 0.0
        )

    def passing(self) -> tuple[str, ...]:
        """The vehicles that have a way round a chair now."""
        return tuple(name for name, watch in self._watched.items() if watch.held and watch.could_pass)

    def _may_matter(self, actor: ActorState, places_W_m: Sequence[tuple[float, float]]) -> list[int]:
        """Cheap early out: which chairs are neither farther than the vehicle looks, nor well behind it."""
        x, y, _ = actor.p_W_m.tolist()
        vx, vy, _ = actor.v_W_mps.tolist()
        length_m = actor.size_lwh_m[0]
        reach_m = look_m(math.hypot(vx, vy), BRAKE_MPS2) + length_m + 4.0
        cos, sin = math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)
        return [
            i
            for i, (cx, cy) in enumerate(places_W_m)
            if (cx - x) ** 2 + (cy - y) ** 2 <= reach_m * reach_m
            and (cx - x) * cos + (cy - y) * sin > -0.5 * length_m - 3.0
        ]

    def _watch(
        self,
        actor: ActorState,
        roads: Roads,
        chairs: Sequence[ChairInStreet],
        rows: Sequence[F64],
        near: Sequence[int],
        orders: list[ActorCommand],
    ) -> _Watch | None:
        """Look at one vehicle's way and order what is needed; None when no chair is near it."""
        # Who looks at all is asked first: a question to SUMO costs far more.
        near = [i for i in near if self._towards(chairs[i]).looks(actor)]
        place = roads.on_lane(actor.id) if near else None
        if place is None:
            return None
        tube = self._tubes[actor.id] = way_ahead(actor, place, roads, self._tubes.get(actor.id))
        if self._swing is not None:
            tube = self._swing.line(actor, tube)
        old = self._watched.get(actor.id) or _Watch(brakes=roads.brakes(actor.id))
        fresh = actor.id in self._come
        plan, toward, seen_s = self._plans(actor, place, tube, old, [(chairs[i], rows[i]) for i in near], roads, fresh)
        if not seen_s:
            return None
        if plan is None:  # all too new
            if old.held:
                orders.append(ActorCommand(actor_id=actor.id, speed_mps=LET_GO))
            return old._replace(seen_s=seen_s, toward=toward, held=False)
        order, waiting = self._decided(actor, old, plan, roads, fresh)
        if order is not None:
            orders.append(order)
        elif old.held:
            orders.append(ActorCommand(actor_id=actor.id, speed_mps=LET_GO))
        return _Watch(
            brakes=old.brakes,
            waiting=waiting,
            seen_s=seen_s,
            could_pass=plan.could_pass,
            held=order is not None,
            toward=toward,
            moves_over=old.moves_over if order is None else bool(order.aside_m),
        )

    def _towards(self, chair: ChairInStreet) -> AttentionModel:
        return chair.habits or self._habits

    def _plans(
        self,
        actor: ActorState,
        place: OnLane,
        tube: Tube,
        watch: _Watch,
        near: Sequence[_Seen],
        roads: Roads,
        fresh: bool,
    ) -> tuple[DriverPlan | None, tuple[str, int] | None, dict[AttentionModel, float]]:
        """What a driver wants to do about the chairs that it has had time to notice, each with its row.

        None when there are none; then the lane that it was told to change to, and since when it sees chairs near its
        way, by its habits towards them.
        """
        here, tick_s = roads.lane(place.lane_id), self._config.tick_s
        brake_mps2 = COMFORT_SHARE * min(BRAKE_MPS2, watch.brakes.service_mps2)
        noticed: DriverPlan | None = None
        early, toward = DriverPlan(), watch.toward
        seen_s: dict[AttentionModel, float] = {}
        for chair, row in near:
            encounter = perceive(actor, place, here, tube, chair, row, brake_mps2, tick_s)
            if encounter is None:
                continue
            habits = self._towards(chair)
            reaction_s = habits.reaction_s(actor)
            # A vehicle that has just come into being has no way behind it on which it would have seen the chair.
            seen_s[habits] = watch.seen_s.get(habits, 0.0) + (reaction_s if fresh else tick_s)
            notices = seen_s[habits] >= reaction_s
            # Chairs not noticed yet get a plan that no order comes from; only the lane steered for is shared.
            before = (noticed or DriverPlan() if notices else early)._replace(toward=toward)
            plan = considered(before, encounter, roads, watch.waiting.squeezes)
            toward = plan.toward
            if notices:
                noticed = plan
            else:
                early = plan
        return noticed, toward, seen_s

    def _decided(
        self, actor: ActorState, watch: _Watch, plan: DriverPlan, roads: Roads, fresh: bool
    ) -> tuple[ActorCommand | None, WaitingTimes]:
        """The command that carries out a plan, None where SUMO does it by itself, and how long a driver has waited."""
        speed_mps, tick_s = math.hypot(*actor.v_W_mps[:2].tolist()), self._config.tick_s
        waiting = waited(watch.waiting, plan, speed_mps, tick_s)
        brakes = replace(watch.brakes, emergency_mps2=math.inf) if fresh else watch.brakes  # it begins at any speed
        speed = braking(plan, speed_mps, roads.allowed_mps(actor.id), brakes, tick_s)
        return command(actor.id, plan, speed, waiting.pushy, watch.moves_over), waiting
