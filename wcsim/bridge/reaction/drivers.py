"""The street notices the wheelchairs: drivers and cyclists brake for one in their way, pass it where there is room.

What one driver does is a chain of pure functions: `_perceive` the chair -> is there a conflict (`_conflict_pose`) ->
how fast may it be (`ConflictCheck.limit`) -> is there room to pass, within the lane or in the next one
(`_room_to_pass`) -> one plan over all chairs (`_considered`) -> which command (`_command`). They remember nothing: what
a driver knows from the tick before comes in as a value.

SUMO never learns of the chairs; what they do to the traffic goes through its own speed, lane and sublane commands,
because placing a proxy with `moveToXY` kills libsumo on real nets. Drivers see a chair one tick late. Who does not look
(1 - attention share) is drawn once per actor from the seed, so it does not depend on the order of things; share and
reaction time are those towards each chair.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.bridge.reaction.commands import LET_GO, ActorCommand, Blocked, ChairInStreet
from wcsim.bridge.reaction.conflict import (
    LAST_GAP_M,
    NO_TOUCH_M,
    ON_PAVEMENT_M,
    ON_ROAD_M,
    SIDE_GAP_M,
    STOP_SHORT_M,
    ConflictCheck,
    SweptOverlap,
    approach_mps,
    look_m,
)
from wcsim.bridge.reaction.swept_path import STEP_M, Brakes, LaneShape, OnLane, Roads, Tube, way_ahead
from wcsim.bridge.reaction.wide_turns import SwingOut
from wcsim.config import WorldConfig
from wcsim.core.boxes import box_from_actor, boxes_touch
from wcsim.types import F64, ActorKind, ActorState

ASIDE_MPS, ASIDE_START_S = 0.8, 0.5  # how fast a vehicle moves over, and what it needs to begin
CREEP_MPS = 1.0
SIDLE_MPS = 0.2  # who still has to move over creeps no faster near a chair: the tail follows only as it drives on
SQUEEZE_MPS = 0.8  # who has waited long drives by at this pace where its body is clear, with less than the usual gap
STRADDLE_M = 0.1
THERE_M = 0.05  # so near to the place where it wants to be a vehicle is there
LEAST_ASIDE_M = 0.02  # a smaller shift is no command
STEER_SHARE = 1.0  # of its length that a vehicle keeps free before it, to steer out into the next lane
ENTERED_M = 0.5
LANE_CHANGE_S = 3.0
IMPATIENT_S = 8.0  # after so long a wait a driver takes smaller gaps in the next lane
RAIL = (ActorKind.TRAM,)


class _Encounter(NamedTuple):  # as the rest, made in every tick: a frozen dataclass costs twice as much
    """One vehicle whose way leads past one wheelchair, as its driver perceives the two."""

    check: ConflictCheck
    place: OnLane
    here: LaneShape  # the lane that it is in
    on_road: bool  # the chair is where vehicles drive
    touch: SweptOverlap
    brake_mps2: float  # that the driver plans with
    tick_s: float

    @property
    def ahead(self) -> bool:
        """Whether the usual gap to the chair is still kept; who is alongside already only must not touch it."""
        return self.touch.at[1] > self.check.now + 1

    @property
    def length_m(self) -> float:
        """Of the vehicle."""
        return self.check.actor.size_lwh_m[0]

    @property
    def straddles(self) -> bool:
        """Whether the vehicle's body reaches over the edge of its lane, as on the way between two of them."""
        reach_m = abs(self.place.left_m) + 0.5 * self.check.actor.size_lwh_m[1]
        return reach_m > 0.5 * self.here.width_m + STRADDLE_M


class _Passing(NamedTuple):
    """How a driver gets past a wheelchair: beside it within the lane, by the next lane, or not at all."""

    speed_mps: float = 0.0  # that may be driven past it from here on; 0 where it has to stop first
    aside_m: float | None = None  # to move over within the lane, left positive
    lane_index: int | None = None  # to change to

    @property
    def possible(self) -> bool:
        """Whether there is a way round at all."""
        return self.aside_m is not None or self.lane_index is not None


class _Steering(NamedTuple):
    """Out of the lane: to where, and how fast at most, so that there is room to do it."""

    lane_index: int | None = None
    limit_mps: float = math.inf
    resumed: bool = False  # it is half way there, and only told again


class _DriverPlan(NamedTuple):
    """What a vehicle should do, over all chairs that its driver has looked at."""

    limit_mps: float = math.inf
    nearest_m: float = math.inf  # to where its body would touch a chair
    keep_lane: bool = False
    lane_index: int | None = None
    aside_m: float | None = None
    could_pass: bool = False
    toward: tuple[str, int] | None = None  # edge and lane of the last change of lanes


class _WaitingTimes(NamedTuple):
    """How long a driver has been kept by wheelchairs."""

    stands_s: float = 0.0
    waits_s: float = 0.0  # for a way round that there is
    squeezes: bool = False  # has stood so long that a gap that just clears will do

    @property
    def pushy(self) -> bool:
        """Whether the driver takes smaller gaps in the next lane by now."""
        return self.waits_s > IMPATIENT_S


def _perceive(
    actor: ActorState, place: OnLane, here: LaneShape, tube: Tube, chair: ChairInStreet, row: F64,
    brake_mps2: float, tick_s: float,
) -> _Encounter | None:  # fmt: skip
    """How a driver sees a chair, whose `row()` is (8,); None when the way `tube` from `place` does not come near it."""
    speed_mps = math.hypot(*actor.v_W_mps[:2].tolist())
    check = ConflictCheck(actor=actor, tube=tube, front_m=tube.front_m(place), speed_mps=speed_mps, row=row)
    on_road = chair.on_road or here.shared
    touch = check.touch(place.left_m, ON_ROAD_M if on_road else ON_PAVEMENT_M)
    if touch.at[-1] < 0:
        return None
    return _Encounter(
        check=check, place=place, here=here, on_road=on_road, touch=touch, brake_mps2=brake_mps2, tick_s=tick_s
    )


def _considered(before: _DriverPlan, it: _Encounter, roads: Roads, impatient: bool) -> _DriverPlan:
    """The plan of a driver who has thought of one chair more: the least speed, and the last way round that was found.

    One who is `impatient` has stood so long that a gap that just clears will do.
    """
    keep_lane = before.keep_lane or _too_near_to_change_lanes(it)
    limit_mps = it.check.limit(it.touch, it.place.left_m, it.brake_mps2, it.tick_s)
    at = _conflict_pose(it)
    if at < 0:
        return before._replace(keep_lane=keep_lane, limit_mps=min(before.limit_mps, limit_mps))
    distance_m = it.check.distance_m(at)
    passing = _room_to_pass(it, distance_m, roads)
    steering = _steering_out(it, before, passing, distance_m, _junction_left_m(it, roads))
    limit_mps = min(_passing_mps(it, passing, limit_mps), steering.limit_mps)
    narrow_mps = _narrow_gap_mps(it, at) if impatient else None
    plan = _DriverPlan(
        limit_mps=min(before.limit_mps, limit_mps if narrow_mps is None else max(limit_mps, narrow_mps)),
        nearest_m=min(before.nearest_m, distance_m),
        keep_lane=keep_lane or passing.possible,
        lane_index=steering.lane_index,
        aside_m=before.aside_m if passing.aside_m is None else passing.aside_m,
        could_pass=before.could_pass or passing.possible or steering.resumed,
        toward=before.toward if steering.lane_index is None else (it.here.edge_id, steering.lane_index),
    )
    # Through a narrow gap it goes straight on: a body that moves over turns in it.
    return plan if narrow_mps is None else plan._replace(lane_index=None, aside_m=0.0)


# --- is there a conflict, and how fast may it be ---


def _conflict_pose(it: _Encounter) -> int:
    """The first pose on the way at which the vehicle comes nearer to the chair than it may; -1 where there is none.

    Ahead of a chair a driver keeps the usual gap, alongside one only a touch counts.
    """
    return it.touch.at[1] if it.ahead else it.touch.at[0]


def _too_near_to_change_lanes(it: _Encounter) -> bool:
    """Whether SUMO may begin no change of lanes of its own here: it moves sideways even who stands."""
    speed_mps = it.check.speed_mps
    braking_m = 0.7 * speed_mps + 0.25 * speed_mps**2
    least_m = max(3.0 + braking_m, 2.0 * STOP_SHORT_M + it.length_m + LANE_CHANGE_S * speed_mps)
    return it.on_road and it.check.distance_m(it.touch.at[-1]) < least_m


def _passing_mps(it: _Encounter, passing: _Passing, limit_mps: float) -> float:
    """The speed limit of a driver who has a way round: first over, then on.

    While it still has to move over it does not go on as before, but brakes no harder than is comfortable for that.
    """
    moves_over = passing.aside_m is not None and abs(passing.aside_m) > THERE_M
    if it.ahead and passing.speed_mps > 0.0 and moves_over:
        limit_mps = min(limit_mps, it.check.speed_mps - it.brake_mps2 * it.tick_s)
    return max(limit_mps, passing.speed_mps)


# --- is there room to pass ---


def _room_to_pass(it: _Encounter, distance_m: float, roads: Roads) -> _Passing:
    """The way round a chair that stands or rolls along: within the lane where that has room, else by the next lane."""
    if it.check.actor.kind in RAIL or not it.check.passable(it.touch.at[1]):
        return _Passing()
    lane = roads.lane(it.check.tube.lane_at(it.check.front_of(it.touch.at[1])))
    within = _passing_in_lane(it, distance_m, lane.width_m) if roads.sublanes else None
    if within is not None:
        return within
    # On the way between two lanes SUMO does not turn back.
    if lane.edge_id != it.here.edge_id or it.here.internal or it.straddles:
        return _Passing()
    beyond_m = distance_m + 2.0 * (STOP_SHORT_M + it.length_m)
    return _Passing(lane_index=_free_lane(it, roads.lanes_beside(it.check.actor.id, beyond_m)))


def _passing_in_lane(it: _Encounter, distance_m: float, lane_width_m: float) -> _Passing | None:
    """The nearest place beside the chair, within a lane of this width, where the body gets by; None without one."""
    for left_m in it.touch.room(it.check.actor.size_lwh_m[1], lane_width_m):
        past = it.check.touch(left_m, ON_ROAD_M, straight=True)
        past_mps = it.check.limit(past, left_m, it.brake_mps2, it.tick_s)
        if past.at[0] >= 0 or past_mps <= 0.0:  # a body that turns there sweeps more than the lane's width
            continue
        aside_m = left_m - it.place.left_m
        there = abs(aside_m) < THERE_M
        room_m = it.check.distance_m(it.touch.at[0]) if it.touch.at[0] >= 0 else math.inf
        if there and room_m <= LAST_GAP_M:  # skewed, and with no room to straighten
            continue
        return _Passing(speed_mps=min(_shift_mps(aside_m, distance_m), past_mps), aside_m=aside_m)
    return None


def _shift_mps(aside_m: float, distance_m: float) -> float:
    """The speed at which a vehicle has moved over in time, before it comes to the chair."""
    creep_mps = SIDLE_MPS if distance_m > LAST_GAP_M else 0.0
    if abs(aside_m) < THERE_M:
        creep_mps = CREEP_MPS
    need_s = ASIDE_START_S + abs(aside_m) / ASIDE_MPS
    return max(creep_mps, 0.8 * (distance_m - STOP_SHORT_M) / need_s)


def _free_lane(it: _Encounter, beside: tuple[int, ...]) -> int | None:
    """The first of the lanes beside in which the vehicle clears the chair; None when it fills them too."""
    for index in beside:
        away_m = (index - it.here.index) * it.here.width_m
        ends_m = abs(it.touch.left_m - away_m), abs(it.touch.right_m - away_m)
        if min(ends_m) > 0.5 * it.check.actor.size_lwh_m[1] + SIDE_GAP_M:
            return index
    return None


# --- steering out ---


def _steering_out(
    it: _Encounter, before: _DriverPlan, passing: _Passing, distance_m: float, enters_m: float
) -> _Steering:
    """The lane that a vehicle steers for, and the speed at which it stops before there is no room left to steer.

    A vehicle that is half way into another lane, or still inside a junction, keeps that room though it knows no way
    round yet. `enters_m` is from `_junction_left_m`; so far it drives on.
    """
    steers = it.ahead and passing.speed_mps == 0.0 and (it.straddles or enters_m > 0.0)
    asked = before.lane_index if passing.lane_index is None else passing.lane_index
    again = _resumed_lane(it, before.toward) if steers and asked is None else None
    lane_index = again if asked is None else asked
    if lane_index is None and not steers:
        return _Steering()
    room_m = max(enters_m, distance_m - STOP_SHORT_M - STEER_SHARE * it.length_m)
    limit_mps = approach_mps(room_m, it.brake_mps2, it.tick_s)
    return _Steering(lane_index=lane_index, limit_mps=limit_mps, resumed=again is not None)


def _junction_left_m(it: _Encounter, roads: Roads) -> float:
    """From inside a junction, how far on its front is on the road where the chair stands, if that begins on the way.

    Only there does it learn whether it may change lanes.
    """
    lane_id = it.check.tube.lane_at(it.check.front_of(max(it.touch.at[1], 0)))
    if not it.here.internal or roads.lane(lane_id).internal:
        return 0.0
    return max(0.0, it.check.tube.start_m[lane_id][0] + ENTERED_M - it.check.front_m)


def _resumed_lane(it: _Encounter, toward: tuple[str, int] | None) -> int | None:
    """The lane to which a vehicle that is half way there is told to go on; None for any other vehicle."""
    if toward is None or not it.straddles or toward[0] != it.here.edge_id:
        return None
    index = toward[1]
    return index if (index - it.here.index) * it.place.left_m > 0.0 else None


def _narrow_gap_mps(it: _Encounter, at: int) -> float | None:
    """How fast it may drive by with a gap that just clears; None where its front half would touch the chair.

    A tail that still lags behind touches later, and has come in line by then.
    """
    touches, gap = it.touch.at[0], it.touch.at[1]
    clears = touches < 0 or (touches - gap) * STEP_M > 0.5 * it.length_m
    if not (it.on_road and clears and it.check.passable(at)):
        return None
    if touches < 0:
        return SQUEEZE_MPS
    return min(SQUEEZE_MPS, approach_mps(it.check.distance_m(touches) - LAST_GAP_M, it.brake_mps2, it.tick_s))


# --- which command ---


def _waited(before: _WaitingTimes, plan: _DriverPlan, speed_mps: float, tick_s: float) -> _WaitingTimes:
    """How long a driver has waited when this tick is counted too."""
    stands = speed_mps < 0.1 and plan.limit_mps <= SIDLE_MPS and plan.nearest_m < 3.0 * STOP_SHORT_M
    waits = plan.could_pass and speed_mps < CREEP_MPS
    stands_s = before.stands_s + tick_s if stands else 0.0
    return _WaitingTimes(
        stands_s=stands_s,
        waits_s=before.waits_s + tick_s if waits else 0.0,
        squeezes=before.squeezes or stands_s > IMPATIENT_S,
    )


def _braking(plan: _DriverPlan, speed_mps: float, free_mps: float, brakes: Brakes, tick_s: float) -> tuple[float, bool]:
    """The speed that is commanded, and whether it takes more than the service brake.

    SUMO drives at `free_mps` by itself.
    """
    if not plan.limit_mps < free_mps:
        return LET_GO, False
    # It is a divisor; with so little room any speed takes more than the service brake.
    room_m = max(plan.nearest_m - LAST_GAP_M, 0.05)
    if speed_mps <= 0.5 or speed_mps**2 / (2.0 * room_m) <= brakes.service_mps2:
        return plan.limit_mps, False
    floor_mps = speed_mps - brakes.emergency_mps2 * tick_s
    return max(0.0, floor_mps, min(plan.limit_mps, speed_mps)), True


def _command(
    actor_id: str, plan: _DriverPlan, speed: tuple[float, bool], pushy: bool, moved_over: bool
) -> ActorCommand | None:
    """What carries out a plan with this speed from `_braking`; None when SUMO does it by itself.

    It is `pushy` who takes smaller gaps in the next lane; who `moved_over` was told to do so a tick ago: SUMO remembers
    that until it could, so it is told to stay.
    """
    if speed[0] == LET_GO and not (plan.keep_lane or plan.aside_m is not None or plan.lane_index is not None):
        return None
    aside_m = plan.aside_m if plan.aside_m is not None and abs(plan.aside_m) > LEAST_ASIDE_M else None
    stays = moved_over and aside_m is None and plan.lane_index is None
    return ActorCommand(
        actor_id=actor_id,
        speed_mps=speed[0],
        hard=speed[1],
        keep_lane=plan.keep_lane,
        pushy=pushy,
        lane_index=plan.lane_index,
        aside_m=0.0 if stays else aside_m,
    )


_Seen = tuple[ChairInStreet, F64]  # with its row
BRAKE_MPS2 = 4.5  # deceleration that drivers and cyclists plan with, at most
COMFORT_SHARE = 0.6  # of the brakes that a driver plans with


class _Watch(NamedTuple):
    """What the reaction remembers of a vehicle that has a chair near its way."""

    brakes: Brakes
    waiting: _WaitingTimes = _WaitingTimes()
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
            if actor.is_person or actor.piece:  # a rear piece runs where its front has run
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
        return tuple(actor.id for actor in fresh if any(_lands_on(actor, row, self._config.tick_s) for row in rows))

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
    ) -> tuple[_DriverPlan | None, tuple[str, int] | None, dict[AttentionModel, float]]:
        """What a driver wants to do about the chairs that it has had time to notice, each with its row.

        None when there are none; then the lane that it was told to change to, and since when it sees chairs near its
        way, by its habits towards them.
        """
        here, tick_s = roads.lane(place.lane_id), self._config.tick_s
        brake_mps2 = COMFORT_SHARE * min(BRAKE_MPS2, watch.brakes.service_mps2)
        noticed: _DriverPlan | None = None
        early, toward = _DriverPlan(), watch.toward
        seen_s: dict[AttentionModel, float] = {}
        for chair, row in near:
            encounter = _perceive(actor, place, here, tube, chair, row, brake_mps2, tick_s)
            if encounter is None:
                continue
            habits = self._towards(chair)
            reaction_s = habits.reaction_s(actor)
            # A vehicle that has just come into being has no way behind it on which it would have seen the chair.
            seen_s[habits] = watch.seen_s.get(habits, 0.0) + (reaction_s if fresh else tick_s)
            notices = seen_s[habits] >= reaction_s
            # Chairs not noticed yet get a plan that no order comes from; only the lane steered for is shared.
            before = (noticed or _DriverPlan() if notices else early)._replace(toward=toward)
            plan = _considered(before, encounter, roads, watch.waiting.squeezes)
            toward = plan.toward
            if notices:
                noticed = plan
            else:
                early = plan
        return noticed, toward, seen_s

    def _decided(
        self, actor: ActorState, watch: _Watch, plan: _DriverPlan, roads: Roads, fresh: bool
    ) -> tuple[ActorCommand | None, _WaitingTimes]:
        """The command that carries out a plan, None where SUMO does it by itself, and how long a driver has waited."""
        speed_mps, tick_s = math.hypot(*actor.v_W_mps[:2].tolist()), self._config.tick_s
        waiting = _waited(watch.waiting, plan, speed_mps, tick_s)
        brakes = replace(watch.brakes, emergency_mps2=math.inf) if fresh else watch.brakes  # it begins at any speed
        speed = _braking(plan, speed_mps, roads.allowed_mps(actor.id), brakes, tick_s)
        return _command(actor.id, plan, speed, waiting.pushy, watch.moves_over), waiting


def _lands_on(actor: ActorState, row: F64, tick_s: float) -> bool:
    """Whether an actor's body covers the chair, or will before it can be told anything."""
    x, y, cos, sin, long_m, wide_m = box_from_actor(actor, NO_TOUCH_M)
    ahead_m = tick_s * math.hypot(actor.v_W_mps[0], actor.v_W_mps[1])
    middle = x + 0.5 * ahead_m * cos, y + 0.5 * ahead_m * sin
    return boxes_touch(*middle, cos, sin, long_m + 0.5 * ahead_m, wide_m, *row[:6].tolist())
