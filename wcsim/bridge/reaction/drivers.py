"""The street notices the wheelchairs: drivers and cyclists brake for one in their way, pass it where there is room.

SUMO never learns of the chairs; what they do to the traffic goes through its own speed, lane and sublane commands,
because placing a proxy with `moveToXY` kills libsumo on real nets. Drivers see a chair one tick late. Who does not
look (1 - attention share) is drawn once per actor from the seed, so it does not depend on the order of things; share
and reaction time are those towards each chair.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field

from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.bridge.reaction.commands import LET_GO, ActorCommand, Blocked, ChairInStreet, is_person
from wcsim.bridge.reaction.conflict import (
    LAST_GAP_M,
    ON_PAVEMENT_M,
    ON_ROAD_M,
    SIDE_GAP_M,
    STOP_SHORT_M,
    ConflictCheck,
    approach_mps,
    lands_on,
    look_m,
)
from wcsim.bridge.reaction.overlap import SweptOverlap, room_beside
from wcsim.bridge.reaction.swept_path import STEP_M, Brakes, LaneShape, OnLane, Roads, Tube, way_ahead
from wcsim.bridge.reaction.wide_turn_bodies import SwingOut
from wcsim.config import WorldConfig
from wcsim.types import F64, ActorKind, ActorState

COMFORT_SHARE = 0.6  # of the brakes that a driver plans with
ASIDE_MPS, ASIDE_START_S = 0.8, 0.5  # how fast a vehicle moves over, and what it needs to begin
CREEP_MPS = 1.0
SIDLE_MPS = 0.2  # who still has to move over creeps no faster near a chair: the tail follows only as it drives on
SQUEEZE_MPS = 0.8  # who has waited long drives by at this pace where its body is clear, with less than the usual gap
STRADDLE_M = 0.1
THERE_M = 0.05  # so near to the place where it wants to be a vehicle is there
STEER_SHARE = 1.0  # of its length that a vehicle keeps free before it, to steer out into the next lane
ENTERED_M = 0.5
LANE_CHANGE_S = 3.0
IMPATIENT_S = 8.0  # after so long a wait a driver takes smaller gaps in the next lane
RAIL = (ActorKind.TRAM,)


@dataclass(slots=True)
class _Watch:
    """What the reaction remembers of a vehicle that has a chair near its way."""

    tube: Tube
    brakes: Brakes
    seen_s: dict[AttentionModel, float] = field(
        default_factory=dict
    )  # since chairs are near, by its habits towards them
    waits_s: float = 0.0
    stands_s: float = 0.0
    could_pass: bool = False
    held: bool = False
    squeezes: bool = False  # has waited so long that a gap that just clears will do
    toward: tuple[str, int] | None = None  # edge and lane that it was told to change to
    moves_over: bool = False  # was told to: SUMO remembers that until it could do it


@dataclass(slots=True)
class _Plan:
    """What a vehicle should do, over all chairs."""

    limit_mps: float = math.inf
    nearest_m: float = math.inf  # to where its body would touch a chair
    near: bool = False
    keep_lane: bool = False
    lane_index: int | None = None
    aside_m: float | None = None
    could_pass: bool = False


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
            Blocked(actor_id=name, for_s=watch.stands_s, could_pass=watch.could_pass)
            for name, watch in self._watched.items()
            if watch.stands_s > 0.0
        )

    def passing(self) -> tuple[str, ...]:
        """The vehicles that have a way round a chair now."""
        return tuple(name for name, watch in self._watched.items() if watch.held and watch.could_pass)

    def _may_matter(self, actor: ActorState, places_W_m: Sequence[tuple[float, float]]) -> list[int]:
        """Cheap early out: which chairs are neither farther than the vehicle looks, nor well behind it."""
        x, y, _ = actor.p_W_m.tolist()
        vx, vy, _ = actor.v_W_mps.tolist()
        length_m = actor.size_lwh_m[0]
        reach_m = look_m(math.hypot(vx, vy), self._config.brake_mps2) + length_m + 4.0
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
        near = [i for i in near if self._towards(chairs[i]).looks(actor)]
        place = roads.on_lane(actor.id) if near else None
        if place is None:
            return None
        old = self._watched.get(actor.id)
        tube = self._tubes[actor.id] = way_ahead(actor, place, roads, self._tubes.get(actor.id))
        if self._swing is not None:
            tube = self._swing.line(actor, tube)
        watch = old or _Watch(tube=tube, brakes=roads.brakes(actor.id))
        watch.tube = tube
        fresh = actor.id in self._come
        plan, too_soon = _Plan(), _Plan()
        seen_s: dict[AttentionModel, float] = {}
        for i in near:
            habits = self._towards(chairs[i])
            reaction_s = habits.reaction_s(actor)
            for_s = watch.seen_s.get(habits, 0.0) + (reaction_s if fresh else self._config.tick_s)
            heeded = plan if for_s >= reaction_s else too_soon
            if self._consider(actor, place, watch, chairs[i], rows[i], roads, heeded):
                seen_s[habits] = for_s
        if not seen_s:
            return None
        watch.seen_s = seen_s
        order = self._order(actor, watch, plan, roads, fresh) if plan.near else None
        if order is not None:
            orders.append(order)
        elif watch.held:
            orders.append(ActorCommand(actor_id=actor.id, speed_mps=LET_GO))
        watch.held = order is not None
        return watch

    def _towards(self, chair: ChairInStreet) -> AttentionModel:
        return chair.habits or self._habits

    def _consider(
        self,
        actor: ActorState,
        place: OnLane,
        watch: _Watch,
        chair: ChairInStreet,
        row: F64,
        roads: Roads,
        plan: _Plan,
    ) -> bool:
        """Add what one chair asks of a vehicle to its plan; whether it is near the vehicle's way."""
        speed_mps = math.hypot(*actor.v_W_mps[:2].tolist())
        look = ConflictCheck(
            actor=actor, tube=watch.tube, front_m=watch.tube.front_m(place), speed_mps=speed_mps, row=row
        )
        in_the_way = chair.on_road or roads.lane(place.lane_id).shared
        gaps_m = ON_ROAD_M if in_the_way else ON_PAVEMENT_M
        touch = look.touch(place.left_m, gaps_m)
        if touch.at[-1] < 0:
            return False
        plan.near = True
        brake_mps2 = COMFORT_SHARE * min(self._config.brake_mps2, watch.brakes.service_mps2)
        if in_the_way and look.distance_m(touch.at[-1]) < _keeps_lane_m(speed_mps, actor.size_lwh_m[0]):
            plan.keep_lane = True
        limit_mps = look.limit(touch, place.left_m, brake_mps2, self._config.tick_s)
        at = touch.at[0] if touch.at[1] <= look.now + 1 else touch.at[1]
        straddles = _straddles(actor, place, roads.lane(place.lane_id))
        if at >= 0:
            distance_m = look.distance_m(at)
            plan.nearest_m = min(plan.nearest_m, distance_m)
            past_mps = self._pass(look, place, touch, distance_m, brake_mps2, roads, plan)
            ahead = touch.at[1] > look.now + 1
            moves_over = ahead and past_mps > 0.0 and plan.aside_m is not None and abs(plan.aside_m) > THERE_M
            if moves_over:  # first over, then on; no harder brake for that than a comfortable one
                limit_mps = min(limit_mps, speed_mps - brake_mps2 * self._config.tick_s)
            limit_mps = max(limit_mps, past_mps)
            enters_m = _enters_m(look, place, touch, roads)
            steers = ahead and past_mps == 0.0 and (straddles or enters_m > 0.0)
            here = roads.lane(place.lane_id)
            if steers and straddles and plan.lane_index is None and watch.toward is not None:
                edge_id, index = watch.toward
                if edge_id == here.edge_id and (index - here.index) * place.left_m > 0.0:  # half way: told again
                    plan.lane_index, plan.could_pass = index, True
            if plan.lane_index is not None:
                watch.toward = here.edge_id, plan.lane_index
            if plan.lane_index is not None or steers:  # not so near that there is no room to steer out
                room_m = max(enters_m, distance_m - STOP_SHORT_M - STEER_SHARE * actor.size_lwh_m[0])
                limit_mps = min(limit_mps, approach_mps(room_m, brake_mps2, self._config.tick_s))
            if watch.squeezes and in_the_way and look.passable(at) and _front_clears(look, touch):
                limit_mps = max(limit_mps, _squeeze_mps(look, touch, brake_mps2, self._config.tick_s))
                plan.aside_m, plan.lane_index = 0.0, None
        plan.limit_mps = min(plan.limit_mps, limit_mps)
        return True

    def _pass(
        self,
        look: ConflictCheck,
        place: OnLane,
        touch: SweptOverlap,
        distance_m: float,
        brake_mps2: float,
        roads: Roads,
        plan: _Plan,
    ) -> float:
        """Look for a way round the chair; returns the speed in m/s that it allows (0 where there is none)."""
        if look.actor.kind in RAIL or not look.passable(touch.at[1]):
            return 0.0
        lane = roads.lane(look.tube.lane_at(look.front_of(touch.at[1])))
        here = roads.lane(place.lane_id)
        width_m = look.actor.size_lwh_m[1]
        if roads.sublanes:
            for left_m in room_beside(touch, width_m, lane.width_m):
                past = look.touch(left_m, ON_ROAD_M, straight=True)
                past_mps = look.limit(past, left_m, brake_mps2, self._config.tick_s)
                if past.at[0] >= 0 or past_mps <= 0.0:  # a body that turns there sweeps more than the lane's width
                    continue
                there = abs(left_m - place.left_m) < THERE_M
                room_m = look.distance_m(touch.at[0]) if touch.at[0] >= 0 else math.inf
                if there and room_m <= LAST_GAP_M:  # skewed, and with no room to straighten
                    continue
                plan.could_pass = plan.keep_lane = True
                plan.aside_m = left_m - place.left_m
                need_s = ASIDE_START_S + abs(plan.aside_m) / ASIDE_MPS
                creep_mps = CREEP_MPS if there else SIDLE_MPS if distance_m > LAST_GAP_M else 0.0
                on_time_mps = max(creep_mps, 0.8 * (distance_m - STOP_SHORT_M) / need_s)
                return min(on_time_mps, past_mps)
        # On the way between two lanes SUMO does not turn back.
        if lane.edge_id == here.edge_id and not here.internal and not _straddles(look.actor, place, here):
            beyond_m = distance_m + 2.0 * (STOP_SHORT_M + look.actor.size_lwh_m[0])
            for index in roads.lanes_beside(look.actor.id, beyond_m):
                away_m = (index - here.index) * here.width_m
                if min(abs(touch.left_m - away_m), abs(touch.right_m - away_m)) > 0.5 * width_m + SIDE_GAP_M:
                    plan.could_pass = plan.keep_lane = True
                    plan.lane_index = index
                    break
        return 0.0

    def _order(self, actor: ActorState, watch: _Watch, plan: _Plan, roads: Roads, fresh: bool) -> ActorCommand | None:
        """The order that carries out a plan; None when SUMO needs none."""
        speed_mps = math.hypot(*actor.v_W_mps[:2].tolist())
        stands = speed_mps < 0.1 and plan.limit_mps <= SIDLE_MPS and plan.nearest_m < 3.0 * STOP_SHORT_M
        watch.stands_s = watch.stands_s + self._config.tick_s if stands else 0.0
        watch.waits_s = watch.waits_s + self._config.tick_s if plan.could_pass and speed_mps < CREEP_MPS else 0.0
        watch.could_pass = plan.could_pass
        watch.squeezes = watch.squeezes or watch.stands_s > IMPATIENT_S
        free_mps = roads.allowed_mps(actor.id)
        slower = plan.limit_mps < free_mps
        if not (slower or plan.keep_lane or plan.aside_m is not None or plan.lane_index is not None):
            return None
        wanted_mps = plan.limit_mps if slower else LET_GO
        hard = False
        if slower and math.isfinite(plan.nearest_m):
            room_m = max(plan.nearest_m - LAST_GAP_M, 0.05)
            if speed_mps > 0.5 and speed_mps**2 / (2.0 * room_m) > watch.brakes.service_mps2:
                hard = True
                floor_mps = 0.0 if fresh else speed_mps - watch.brakes.emergency_mps2 * self._config.tick_s
                wanted_mps = max(0.0, floor_mps, min(wanted_mps, speed_mps))
        aside_m = plan.aside_m if plan.aside_m is not None and abs(plan.aside_m) > 0.02 else None
        stays = watch.moves_over and aside_m is None and plan.lane_index is None
        watch.moves_over = aside_m is not None
        return ActorCommand(
            actor_id=actor.id,
            speed_mps=wanted_mps,
            hard=hard,
            keep_lane=plan.keep_lane,
            pushy=watch.waits_s > IMPATIENT_S,
            lane_index=plan.lane_index,
            aside_m=0.0 if stays else aside_m,
        )


def _front_clears(look: ConflictCheck, touch: SweptOverlap) -> bool:
    """Whether it comes half its length past the place where others stop before it would touch, if it ever does.

    A tail that still lags behind touches later, and has come in line by then.
    """
    return touch.at[0] < 0 or (touch.at[0] - touch.at[1]) * STEP_M > 0.5 * look.actor.size_lwh_m[0]


def _squeeze_mps(look: ConflictCheck, touch: SweptOverlap, brake_mps2: float, tick_s: float) -> float:
    """How fast it may drive by with a gap that just clears."""
    if touch.at[0] < 0:
        return SQUEEZE_MPS
    return min(SQUEEZE_MPS, approach_mps(look.distance_m(touch.at[0]) - LAST_GAP_M, brake_mps2, tick_s))


def _enters_m(look: ConflictCheck, place: OnLane, touch: SweptOverlap, roads: Roads) -> float:
    """From inside a junction, how far on its front is on the road where the chair stands, if that begins on the way.

    Only there does it learn whether it may change lanes.
    """
    lane_id = look.tube.lane_at(look.front_of(max(touch.at[1], 0)))
    if not roads.lane(place.lane_id).internal or roads.lane(lane_id).internal:
        return 0.0
    return max(0.0, look.tube.start_m[lane_id][0] + ENTERED_M - look.front_m)


def _straddles(actor: ActorState, place: OnLane, lane: LaneShape) -> bool:
    """Whether its body reaches over the edge of its lane, as on the way between two of them."""
    return abs(place.left_m) + 0.5 * actor.size_lwh_m[1] > 0.5 * lane.width_m + STRADDLE_M


def _keeps_lane_m(speed_mps: float, length_m: float) -> float:
    """How far before a chair a vehicle begins no change of lanes of SUMO's own: SUMO moves sideways even who stands."""
    braking_m = 0.7 * speed_mps + 0.25 * speed_mps**2
    return max(3.0 + braking_m, 2.0 * STOP_SHORT_M + length_m + LANE_CHANGE_S * speed_mps)
