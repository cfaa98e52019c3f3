"""The street notices the wheelchairs.

Drivers and cyclists brake for one in their way, pass it where there is room. What one driver does
is a chain of pure functions: `_perceive` the chair -> is there a conflict (`_conflict_pose`) -> how
fast may it be (`ConflictCheck.limit`) -> is there room to pass, within the lane or in the next one
(`_room_to_pass`) -> one plan over all chairs (`_considered`) -> which command (`_command`). They
remember nothing: what a driver knows from the tick before comes in as a value.

SUMO never learns of the chairs; what they do to the traffic goes through its own speed, lane and
sublane commands, because placing a proxy with `moveToXY` kills libsumo on real nets. Drivers see a
chair one tick late. Who does not look (1 - attention share) is drawn once per actor from the seed,
so it does not depend on the order of things; share and reaction time are those towards each chair.
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
from wcsim.bridge.reaction.swept_path import (
    STEP_M,
    Brakes,
    LaneShape,
    OnLane,
    Roads,
    Tube,
    way_ahead,
)
from wcsim.bridge.reaction.wide_turns import SwingOut
from wcsim.config import WorldConfig
from wcsim.core.boxes import box_from_actor, boxes_touch
from wcsim.types import F64, ActorKind, ActorState

# How fast a vehicle moves over, and what it needs to begin.
_ASIDE_MPS, _ASIDE_START_S = 0.8, 0.5
_CREEP_MPS = 1.0
# Who still has to move over creeps no faster near a chair: the tail follows only as it drives on.
_SIDLE_MPS = 0.2
# Who has waited long drives by at this pace where its body is clear, with less than the usual gap.
_SQUEEZE_MPS = 0.8
_STRADDLE_M = 0.1
_THERE_M = 0.05  # so near to the place where it wants to be a vehicle is there
_LEAST_ASIDE_M = 0.02  # a smaller shift is no command
# Of its length that a vehicle keeps free before it, to steer out into the next lane.
_STEER_SHARE = 1.0
_ENTERED_M = 0.5
_LANE_CHANGE_S = 3.0
_IMPATIENT_S = 8.0  # after so long a wait a driver takes smaller gaps in the next lane
_RAIL = (ActorKind.TRAM,)
_BRAKE_MPS2 = 4.5  # deceleration that drivers and cyclists plan with, at most
_COMFORT_SHARE = 0.6  # of the brakes that a driver plans with


# As the other tuples here, made in every tick: a frozen dataclass costs twice as much.
class _Encounter(NamedTuple):
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
        """Whether the chair is ahead by more than the usual gap, so not alongside yet."""
        return self.touch.at[1] > self.check.now + 1

    @property
    def length_m(self) -> float:
        """Of the vehicle."""
        return self.check.actor.size_lwh_m[0]

    @property
    def straddles(self) -> bool:
        """Whether the vehicle's body reaches over the edge of its lane.

        It does on the way from one lane to the next.
        """
        reach_m = abs(self.place.left_m) + 0.5 * self.check.actor.size_lwh_m[1]
        return reach_m > 0.5 * self.here.width_m + _STRADDLE_M


class _Passing(NamedTuple):
    """How a driver gets past a wheelchair: within the lane, by the next lane, or not at all."""

    speed_mps: float = 0.0  # that may be driven past it from here on; 0 where it has to stop first
    aside_m: float | None = None  # to move over within the lane, left positive
    lane_index: int | None = None  # to change to

    @property
    def possible(self) -> bool:
        """Whether there is a way round at all."""
        return self.aside_m is not None or self.lane_index is not None


class _Steering(NamedTuple):
    """To which lane a vehicle steers, and how fast at most, so that it has room to do it."""

    lane_index: int | None = None
    limit_mps: float = math.inf
    resumed: bool = False  # it is half way there, and gets the command again


class _DriverPlan(NamedTuple):
    """What a vehicle should do, over all chairs that its driver has looked at."""

    limit_mps: float = math.inf
    nearest_m: float = math.inf  # to where its body would touch a chair
    stay_in_lane: bool = False
    lane_index: int | None = None
    aside_m: float | None = None
    could_pass: bool = False
    toward: tuple[str, int] | None = None  # edge and lane of the last change of lanes


class _WaitingTimes(NamedTuple):
    """How long a driver has waited for wheelchairs."""

    stands_s: float = 0.0
    waits_s: float = 0.0  # for a way round that there is
    squeezes: bool = False  # has stood so long that a gap that just clears will do

    @property
    def pushy(self) -> bool:
        """Whether the driver takes smaller gaps in the next lane by now."""
        return self.waits_s > _IMPATIENT_S


class _Watch(NamedTuple):
    """What the reaction remembers of a vehicle that has a chair near its way."""

    brakes: Brakes
    waiting: _WaitingTimes = _WaitingTimes()
    # Since chairs are near, by its habits towards them.
    seen_s: Mapping[AttentionModel, float] = MappingProxyType({})
    could_pass: bool = False
    held: bool = False
    toward: tuple[str, int] | None = None  # edge and lane of its last lane change
    moves_over: bool = False  # by command: SUMO remembers that until it is done


class StreetReaction:
    """Decides each tick which drivers and riders brake for a wheelchair, or pass it.

    One that no chair is near any more is let go again.
    """

    def __init__(
        self, config: WorldConfig, habits: AttentionModel, swing: SwingOut | None = None
    ) -> None:
        self._config = config
        self._habits = habits
        self._swing = swing
        self._watched: dict[str, _Watch] = {}
        self._tubes: dict[str, Tube] = {}
        self._spawned: Collection[str] = ()

    def react(
        self, actors: Iterable[ActorState], chairs: Sequence[ChairInStreet], roads: Roads
    ) -> tuple[ActorCommand, ...]:
        """The commands of this tick, in the actors' order.

        A vehicle that no chair is near any more is let go once.
        """
        commands: list[ActorCommand] = []
        watched: dict[str, _Watch] = {}
        rows = [chair.row() for chair in chairs]
        places_W_m = [(row.item(0), row.item(1)) for row in rows]
        seen: set[str] = set()
        for actor in actors:
            # A rear piece runs where its front has run.
            if actor.is_person or actor.piece:
                continue
            seen.add(actor.id)
            led = actor if self._swing is None else self._swing.led(actor)
            # An early out that is cheap: chairs farther than it looks, or well behind it.
            x, y, _ = led.p_W_m.tolist()
            vx, vy, _ = led.v_W_mps.tolist()
            length_m = led.size_lwh_m[0]
            reach_m = look_m(math.hypot(vx, vy), _BRAKE_MPS2) + length_m + 4.0
            cos, sin = math.cos(led.yaw_rad), math.sin(led.yaw_rad)
            near = [
                i
                for i, (cx, cy) in enumerate(places_W_m)
                if (cx - x) ** 2 + (cy - y) ** 2 <= reach_m * reach_m
                and (cx - x) * cos + (cy - y) * sin > -0.5 * length_m - 3.0
            ]
            watch = self._watch(led, roads, chairs, rows, near, commands) if near else None
            if watch is not None:
                watched[actor.id] = watch
        # In the order of the last tick, as commands to SUMO must have one.
        past = [name for name, watch in self._watched.items() if watch.held and name not in watched]
        commands += [ActorCommand(actor_id=name, speed_mps=LET_GO) for name in past]
        self._tubes = {name: tube for name, tube in self._tubes.items() if name in seen}
        self._watched = watched
        return tuple(commands)

    def turned_away(
        self,
        actors: Iterable[ActorState],
        chairs: Sequence[ChairInStreet],
        spawned: Collection[str],
    ) -> tuple[str, ...]:
        """The vehicles that SUMO, which sees no chair, has just put on one or right before it.

        Args:
            actors: Those near the chairs after SUMO's step.
            chairs: The wheelchairs.
            spawned: Who departed in this step, or ended a teleport. Only these have no way behind
                them, so they see the chair at once and start at any speed.
        """
        self._spawned = spawned
        if not spawned:
            return ()
        rows = [chair.row() for chair in chairs]
        found = []
        for actor in actors:
            if actor.id not in spawned:
                continue
            # What its body covers before any command can reach it.
            x, y, cos, sin, long_m, wide_m = box_from_actor(actor, NO_TOUCH_M)
            ahead_m = self._config.tick_s * math.hypot(actor.v_W_mps[0], actor.v_W_mps[1])
            middle = x + 0.5 * ahead_m * cos, y + 0.5 * ahead_m * sin
            sweep = *middle, cos, sin, long_m + 0.5 * ahead_m, wide_m
            if any(boxes_touch(*sweep, *row[:6].tolist()) for row in rows):
                found.append(actor.id)
        return tuple(found)

    def blocked(self) -> tuple[Blocked, ...]:
        """The vehicles that stand because of a chair now."""
        return tuple(
            Blocked(actor_id=name, for_s=watch.waiting.stands_s, could_pass=watch.could_pass)
            for name, watch in self._watched.items()
            if watch.waiting.stands_s > 0.0
        )

    def passing(self) -> tuple[str, ...]:
        """The vehicles that have a way round a chair now."""
        watched = self._watched.items()
        return tuple(name for name, watch in watched if watch.held and watch.could_pass)

    def _watch(
        self,
        actor: ActorState,
        roads: Roads,
        chairs: Sequence[ChairInStreet],
        rows: Sequence[F64],
        near: Sequence[int],
        commands: list[ActorCommand],
    ) -> _Watch | None:
        """Look at one vehicle's way and add its command; None when no chair is near it."""
        # Who looks at all comes first: a query of SUMO costs far more.
        near = [i for i in near if self._towards(chairs[i]).looks(actor)]
        place = roads.on_lane(actor.id) if near else None
        if place is None:
            return None
        tube = self._tubes[actor.id] = way_ahead(actor, place, roads, self._tubes.get(actor.id))
        if self._swing is not None:
            tube = self._swing.line(actor, tube)
        old = self._watched.get(actor.id) or _Watch(brakes=roads.brakes(actor.id))
        fresh = actor.id in self._spawned
        seen = [(chairs[i], rows[i]) for i in near]
        plan, toward, seen_s = self._plans(actor, place, tube, old, seen, roads, fresh)
        if not seen_s:
            return None
        # All chairs are in sight for less than the reaction time.
        if plan is None:
            if old.held:
                commands.append(ActorCommand(actor_id=actor.id, speed_mps=LET_GO))
            return old._replace(seen_s=seen_s, toward=toward, held=False)
        speed_mps = math.hypot(*actor.v_W_mps[:2].tolist())
        waiting = _waited(old.waiting, plan, speed_mps, self._config.tick_s)
        # A vehicle that has just come into being starts at any speed.
        brakes = replace(old.brakes, emergency_mps2=math.inf) if fresh else old.brakes
        free_mps = roads.allowed_mps(actor.id)
        speed = _braking(plan, speed_mps, free_mps, brakes, self._config.tick_s)
        command = _command(actor.id, plan, speed, waiting.pushy, old.moves_over)
        if command is not None:
            commands.append(command)
        elif old.held:
            commands.append(ActorCommand(actor_id=actor.id, speed_mps=LET_GO))
        return _Watch(
            brakes=old.brakes,
            waiting=waiting,
            seen_s=seen_s,
            could_pass=plan.could_pass,
            held=command is not None,
            toward=toward,
            moves_over=old.moves_over if command is None else bool(command.aside_m),
        )

    def _towards(self, chair: ChairInStreet) -> AttentionModel:
        return chair.habits or self._habits

    def _plans(
        self,
        actor: ActorState,
        place: OnLane,
        tube: Tube,
        watch: _Watch,
        near: Sequence[tuple[ChairInStreet, F64]],
        roads: Roads,
        fresh: bool,
    ) -> tuple[_DriverPlan | None, tuple[str, int] | None, dict[AttentionModel, float]]:
        """The plan for the chairs in sight for at least the reaction time, each with its row.

        None without any. Then the lane of its last lane change, and since when it sees chairs near
        its way, by its habits towards them.
        """
        here, tick_s = roads.lane(place.lane_id), self._config.tick_s
        brake_mps2 = _COMFORT_SHARE * min(_BRAKE_MPS2, watch.brakes.service_mps2)
        detected: _DriverPlan | None = None
        early, toward = _DriverPlan(), watch.toward
        seen_s: dict[AttentionModel, float] = {}
        for chair, row in near:
            encounter = _perceive(actor, place, here, tube, chair, row, brake_mps2, tick_s)
            if encounter is None:
                continue
            habits = self._towards(chair)
            reaction_s = habits.reaction_s(actor)
            # A vehicle that has just come into being had no way on which to see the chair before.
            seen_s[habits] = watch.seen_s.get(habits, 0.0) + (reaction_s if fresh else tick_s)
            notices = seen_s[habits] >= reaction_s
            # Chairs not noticed yet get a plan that no command comes from; only the lane is shared.
            before = (detected or _DriverPlan() if notices else early)._replace(toward=toward)
            plan = _considered(before, encounter, roads, watch.waiting.squeezes)
            toward = plan.toward
            if notices:
                detected = plan
            else:
                early = plan
        return detected, toward, seen_s


def _perceive(
    actor: ActorState, place: OnLane, here: LaneShape, tube: Tube, chair: ChairInStreet, row: F64,
    brake_mps2: float, tick_s: float,
) -> _Encounter | None:  # fmt: skip
    """How a driver sees a chair, whose `row()` is (8,).

    None when the way `tube` from `place` does not come near it.
    """
    speed_mps = math.hypot(*actor.v_W_mps[:2].tolist())
    check = ConflictCheck(
        actor=actor, tube=tube, front_m=tube.front_m(place), speed_mps=speed_mps, row=row
    )
    on_road = chair.on_road or here.shared
    touch = check.touch(place.left_m, ON_ROAD_M if on_road else ON_PAVEMENT_M)
    if touch.at[-1] < 0:
        return None
    return _Encounter(
        check=check,
        place=place,
        here=here,
        on_road=on_road,
        touch=touch,
        brake_mps2=brake_mps2,
        tick_s=tick_s,
    )


def _considered(before: _DriverPlan, it: _Encounter, roads: Roads, impatient: bool) -> _DriverPlan:
    """The plan `before` with one chair more: the least speed, and the last way round.

    To an `impatient` driver, who has stood long, a gap that just clears will do.
    """
    stays = before.stay_in_lane or _too_near_to_change_lanes(it)
    limit_mps = it.check.limit(it.touch, it.place.left_m, it.brake_mps2, it.tick_s)
    at = _conflict_pose(it)
    if at < 0:
        return before._replace(stay_in_lane=stays, limit_mps=min(before.limit_mps, limit_mps))
    distance_m = it.check.distance_m(at)
    passing = _room_to_pass(it, distance_m, roads)
    steering = _steering_out(it, before, passing, distance_m, _junction_left_m(it, roads))
    limit_mps = min(_passing_mps(it, passing, limit_mps), steering.limit_mps)
    narrow_mps = _narrow_gap_mps(it, at) if impatient else None
    if narrow_mps is not None:
        limit_mps = max(limit_mps, narrow_mps)
    lane_index = steering.lane_index
    plan = _DriverPlan(
        limit_mps=min(before.limit_mps, limit_mps),
        nearest_m=min(before.nearest_m, distance_m),
        stay_in_lane=stays or passing.possible,
        lane_index=lane_index,
        aside_m=before.aside_m if passing.aside_m is None else passing.aside_m,
        could_pass=before.could_pass or passing.possible or steering.resumed,
        toward=before.toward if lane_index is None else (it.here.edge_id, lane_index),
    )
    # Through a narrow gap it goes straight on: a body that moves over turns in it.
    return plan if narrow_mps is None else plan._replace(lane_index=None, aside_m=0.0)


def _conflict_pose(it: _Encounter) -> int:
    """The first pose at which the vehicle is nearer to the chair than it may; -1 for none.

    Behind a chair a driver holds the usual gap; alongside it only a touch counts.
    """
    return it.touch.at[1] if it.ahead else it.touch.at[0]


def _too_near_to_change_lanes(it: _Encounter) -> bool:
    """Whether SUMO may start no lane change here: it moves even a vehicle that stands."""
    speed_mps = it.check.speed_mps
    braking_m = 0.7 * speed_mps + 0.25 * speed_mps**2
    least_m = max(3.0 + braking_m, 2.0 * STOP_SHORT_M + it.length_m + _LANE_CHANGE_S * speed_mps)
    return it.on_road and it.check.distance_m(it.touch.at[-1]) < least_m


def _passing_mps(it: _Encounter, passing: _Passing, limit_mps: float) -> float:
    """The speed limit of a driver who has a way round: first over, then on.

    While it moves over it brakes, but no harder than is comfortable.
    """
    moves_over = passing.aside_m is not None and abs(passing.aside_m) > _THERE_M
    if it.ahead and passing.speed_mps > 0.0 and moves_over:
        limit_mps = min(limit_mps, it.check.speed_mps - it.brake_mps2 * it.tick_s)
    return max(limit_mps, passing.speed_mps)


def _room_to_pass(it: _Encounter, distance_m: float, roads: Roads) -> _Passing:
    """The way round a chair that stands or rolls along: within the lane, else by the next."""
    if it.check.actor.kind in _RAIL or not it.check.passable(it.touch.at[1]):
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
    """The nearest place beside the chair, within a lane of this width; None without one."""
    for left_m in it.touch.room(it.check.actor.size_lwh_m[1], lane_width_m):
        past = it.check.touch(left_m, ON_ROAD_M, straight=True)
        past_mps = it.check.limit(past, left_m, it.brake_mps2, it.tick_s)
        # A body that turns there sweeps more than the lane's width.
        if past.at[0] >= 0 or past_mps <= 0.0:
            continue
        aside_m = left_m - it.place.left_m
        there = abs(aside_m) < _THERE_M
        room_m = it.check.distance_m(it.touch.at[0]) if it.touch.at[0] >= 0 else math.inf
        # It is skewed, and has no room to straighten.
        if there and room_m <= LAST_GAP_M:
            continue
        return _Passing(speed_mps=min(_shift_mps(aside_m, distance_m), past_mps), aside_m=aside_m)
    return None


def _shift_mps(aside_m: float, distance_m: float) -> float:
    """The speed at which a vehicle has moved over in time, before it comes to the chair."""
    creep_mps = _SIDLE_MPS if distance_m > LAST_GAP_M else 0.0
    if abs(aside_m) < _THERE_M:
        creep_mps = _CREEP_MPS
    need_s = _ASIDE_START_S + abs(aside_m) / _ASIDE_MPS
    return max(creep_mps, 0.8 * (distance_m - STOP_SHORT_M) / need_s)


def _free_lane(it: _Encounter, beside: tuple[int, ...]) -> int | None:
    """The first of the lanes beside in which the vehicle clears the chair; None without one."""
    for index in beside:
        away_m = (index - it.here.index) * it.here.width_m
        ends_m = abs(it.touch.left_m - away_m), abs(it.touch.right_m - away_m)
        if min(ends_m) > 0.5 * it.check.actor.size_lwh_m[1] + SIDE_GAP_M:
            return index
    return None


def _steering_out(
    it: _Encounter, before: _DriverPlan, passing: _Passing, distance_m: float, enters_m: float
) -> _Steering:
    """The lane that a vehicle steers for, and the speed that leaves it room to steer.

    A vehicle half way into another lane, or inside a junction, leaves that room though it knows no
    way round yet. `enters_m` is from `_junction_left_m`; so far it drives on.
    """
    steers = it.ahead and passing.speed_mps == 0.0 and (it.straddles or enters_m > 0.0)
    requested = before.lane_index if passing.lane_index is None else passing.lane_index
    resumed = _resumed_lane(it, before.toward) if steers and requested is None else None
    lane_index = resumed if requested is None else requested
    if lane_index is None and not steers:
        return _Steering()
    room_m = max(enters_m, distance_m - STOP_SHORT_M - _STEER_SHARE * it.length_m)
    limit_mps = approach_mps(room_m, it.brake_mps2, it.tick_s)
    return _Steering(lane_index=lane_index, limit_mps=limit_mps, resumed=resumed is not None)


def _junction_left_m(it: _Encounter, roads: Roads) -> float:
    """From inside a junction, how far ahead the chair's road starts; 0 elsewhere.

    Only there does a driver learn whether it may change lanes.
    """
    lane_id = it.check.tube.lane_at(it.check.front_of(max(it.touch.at[1], 0)))
    if not it.here.internal or roads.lane(lane_id).internal:
        return 0.0
    return max(0.0, it.check.tube.start_m[lane_id][0] + _ENTERED_M - it.check.front_m)


def _resumed_lane(it: _Encounter, toward: tuple[str, int] | None) -> int | None:
    """The lane into which a vehicle is half way, and goes on; None for any other vehicle."""
    if toward is None or not it.straddles or toward[0] != it.here.edge_id:
        return None
    index = toward[1]
    return index if (index - it.here.index) * it.place.left_m > 0.0 else None


def _narrow_gap_mps(it: _Encounter, at: int) -> float | None:
    """How fast it may drive by with a gap that just clears; None where its front half touches.

    A tail that lags behind would touch later, and has come in line by then.
    """
    touches, gap = it.touch.at[0], it.touch.at[1]
    clears = touches < 0 or (touches - gap) * STEP_M > 0.5 * it.length_m
    if not (it.on_road and clears and it.check.passable(at)):
        return None
    if touches < 0:
        return _SQUEEZE_MPS
    room_m = it.check.distance_m(touches) - LAST_GAP_M
    return min(_SQUEEZE_MPS, approach_mps(room_m, it.brake_mps2, it.tick_s))


def _waited(
    before: _WaitingTimes, plan: _DriverPlan, speed_mps: float, tick_s: float
) -> _WaitingTimes:
    """How long a driver has waited when this tick is counted too."""
    stands = (
        speed_mps < 0.1 and plan.limit_mps <= _SIDLE_MPS and plan.nearest_m < 3.0 * STOP_SHORT_M
    )
    waits = plan.could_pass and speed_mps < _CREEP_MPS
    stands_s = before.stands_s + tick_s if stands else 0.0
    return _WaitingTimes(
        stands_s=stands_s,
        waits_s=before.waits_s + tick_s if waits else 0.0,
        squeezes=before.squeezes or stands_s > _IMPATIENT_S,
    )


def _braking(
    plan: _DriverPlan, speed_mps: float, free_mps: float, brakes: Brakes, tick_s: float
) -> tuple[float, bool]:
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

    A `pushy` driver takes smaller gaps in the next lane. One that `moved_over` got that command a
    tick ago. SUMO remembers it until it is done, so the vehicle now gets the command to stay.
    """
    aside_m = plan.aside_m
    moves = plan.stay_in_lane or aside_m is not None or plan.lane_index is not None
    if speed[0] == LET_GO and not moves:
        return None
    if aside_m is not None and abs(aside_m) <= _LEAST_ASIDE_M:
        aside_m = None
    stays = moved_over and aside_m is None and plan.lane_index is None
    return ActorCommand(
        actor_id=actor_id,
        speed_mps=speed[0],
        hard=speed[1],
        stay_in_lane=plan.stay_in_lane,
        pushy=pushy,
        lane_index=plan.lane_index,
        aside_m=0.0 if stays else aside_m,
    )
