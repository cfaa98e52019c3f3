"""The simulated user: the person whose joystick the agent follows, or corrects.

It knows its route, sees the street with limited attention, plans like a person who drives (slows down before corners,
goes around what it noticed, waits at a red light, gives up when nothing moves for long), and moves a stick with a hand
that answers late and not quite exactly. Only the stick is shown to the agent; the clean intent is for metrics.

From where the user wants to go to a joystick position: how a practised driver uses this chair's stick.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.frames import wrap
from wcsim.core.joystick import pushed, yaw_rate_limit
from wcsim.errors import ConfigError
from wcsim.types import F64, Joystick, Outline, Route, Street, UserView
from wcsim.users import avoidance
from wcsim.users.avoidance import Body, Edges
from wcsim.users.crossing import Crossing, Kerbs, crossings
from wcsim.users.hand import Hand, SwitchHand, on_disc
from wcsim.users.perception import Perception, Seen
from wcsim.users.profiles import UserProfile
from wcsim.users.route_line import Path
from wcsim.users.turning import Axle, Turn, Turning, plan_turn

# Turn rate asked for each radian of heading error, and its largest value: who answers late must steer gently, or the
# chair swings (a delayed integrator is stable for gain * delay < pi / 2; drivers keep well below).
_GAIN_DELAY = 0.6
_GAIN_MAX_PER_S = 1.4
_TURN_MAX_RADPS = 1.0
DRIVE_DELAY_S = 0.1  # of the chair's own drive
TURN_IN_PLACE_RAD = 1.0
_BEHIND_RAD = (
    2.6  # a goal farther round than this may be taken on either side: keep the side of before
)


def steer(
    body: Body,
    goal: tuple[float, float],
    speed_mps: float,
    chair: ChairConfig,
    delay_s: float,
    before_x: float,
) -> Joystick:
    """The stick that turns towards `goal` and drives at `speed_mps`, in place when the goal is far off ahead.

    Args:
        body: The chair's middle.
        goal: Point (x, y) in W to drive to.
        speed_mps: Wanted speed when the goal is straight ahead.
        chair: Its limits, and how far a stick must be moved before anything happens: the user has learnt them.
        delay_s: How late the driver's hand answers.
        before_x: The stick's x of the plan before, for goals right behind.
    """
    error = wrap(math.atan2(goal[1] - body.y_m, goal[0] - body.x_m) - body.yaw_rad)
    if abs(error) > _BEHIND_RAD and before_x * error > 0.0:
        error = -error
    turning = abs(error) > TURN_IN_PLACE_RAD
    speed = 0.0 if turning else speed_mps * math.cos(error) ** 2
    w_limit = yaw_rate_limit(
        max(abs(body.speed_mps), speed), chair.yaw_rate_max_radps, chair.yaw_slowdown_s_per_m
    )
    gain = min(_GAIN_MAX_PER_S, _GAIN_DELAY / (delay_s + DRIVE_DELAY_S))
    most = min(1.0, min(_TURN_MAX_RADPS, _GAIN_DELAY / (delay_s + DRIVE_DELAY_S)) / w_limit)
    x = min(most, max(-most, -gain * error / w_limit))
    y = min(speed / chair.v_max_mps, math.sqrt(1.0 - x * x))
    radius = math.hypot(x, y)
    if radius < 0.02:
        return Joystick(0.0, 0.0)
    scale = pushed(radius, chair) / radius
    return Joystick(x * scale, y * scale)


def _stopping_speed(distance_m: float, brake_mps2: float) -> float:
    """The speed from which braking at `brake_mps2` stops within `distance_m`; 0 when it is passed already."""
    return math.sqrt(2.0 * brake_mps2 * max(0.0, distance_m))


# The drive axle may be near the chair's rear end; who steers thinks of the middle.
# Of the rear-wheel drive: for who is not told which plant it is, as in a recording.
_LOOKAHEAD_DELAYS = (
    1.25  # the look-ahead grows with what is driven until the chair answers: else it would weave
)
BRAKE_MPS2 = 0.6
_CORNER_RADPS = 1.0
_CORNER_AHEAD_M = 5.0
_SLOPE_MPS, _SLOPE_AHEAD_M = 0.8, 4.0  # how fast a ramp is driven on, and how far ahead it is seen
_CORRECTION_ERROR = 0.25  # relative, of one corrective movement
_CALM_STICK = 0.2  # who steers more than this looks at the street
_STRAIGHT_S = 0.5  # so long after the beginning of a look elsewhere the stick is straight
ARRIVED_M = 0.5
_PROGRESS_M = 0.25  # less than this is being blocked
_WAIT_PATIENCE = 12.0  # at a light or for a vehicle the user waits this many times longer,
_TURN_PATIENCE = 3.0  # and this many times while turning round
_LONGEST_STEP_S = 0.05
_HAIRPIN_M = 1.0
_NEAREST_GOAL_M = (
    0.5  # nearer to the drive axle than this, a place to steer to says nothing about where to go
)
_GOAL_FARTHER_M = tuple(0.25 * step for step in range(1, 11))
STANDS_MPS = 0.25  # who drives slower than this may plan a turn on the spot
CREEP_MPS, _BACK_STICK = 0.3, -0.5  # on, or back, to where there is room for it
STUCK_S, _STUCK_M, _STUCK_RAD = (
    2.5,
    0.1,
    0.15,
)  # a chair that is told to drive and moves less than this hangs somewhere
FREE_M = 0.5  # and is backed up so far
SCARED_MPS = (
    0.3  # who drives so much faster than it could stop before what it sees has seen it late
)
_CALM_S = 5.0  # so long without that a scare is over


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """What the user has decided on."""

    wish: Joystick
    patience: float = 1.0  # a tick costs one part in so many of what is usual


class User(ABC):
    """Who holds the stick of a seat in one episode; the episode may have several destinations (`follow`).

    The world calls `hand` for the steps of a tick, and `look` at the tick's end.
    """

    def __init__(self, sticks: F64) -> None:
        """Somebody without a destination, whose stick is at the last of these (n, 2)."""
        self.arrived = False
        self.gave_up = False
        self.asks_help = False  # at the last look; for who counts or answers it, it moves no stick
        self.patient = False  # gives up nothing: somebody else drives, and this one says where to
        self._sticks = sticks
        self._path: Path | None = None
        self._arc_m = 0.0

    def follow(self, route: Route) -> None:
        """Take a new destination. Raises ConfigError for a route without points."""
        self._path = Path(route)
        self._arc_m = 0.0
        self.arrived = self.gave_up = False

    @abstractmethod
    def hand(self, steps: int, dt_s: float) -> Joystick:
        """Move on by a tick of `steps` physics steps; the stick afterwards."""

    @abstractmethod
    def look(self, view: UserView) -> None:
        """See the street once, and how far the chair has come."""

    @property
    @abstractmethod
    def intent(self) -> Joystick:
        """What the user wants, before delay and the hand; never shown to the agent."""

    @property
    def joystick(self) -> Joystick:
        """The stick now, on the unit disc: what the agent is shown."""
        return Joystick(*self._sticks[-1].tolist())

    @property
    def sticks(self) -> F64:
        """The stick (steps, 2) after each step of the last call of `hand`; for measurements of the hand."""
        return self._sticks

    @property
    def route_progress_m(self) -> float:
        """How far along the present route the chair is."""
        return self._arc_m


class RecordedStick(Protocol):
    """A stick that was recorded in the place of a profile."""

    def user(self, episode: int, outline: Outline) -> User:
        """Who replays it in an episode."""

    def require_driven_here(self, town: str, town_sha256: Callable[[], str]) -> None:
        """Refuse one of another town, or of this one when it was another. Raises ConfigError that names both."""


FindUser = Callable[[str], UserProfile | RecordedStick]
"""Who is meant by the name of a user. Raises ConfigError for nobody."""


class SimulatedUser(User):
    """A user of a profile."""

    def __init__(
        self,
        profile: UserProfile,
        rng: np.random.Generator,
        chair: ChairConfig,
        outline: Outline,
        street: Street | None = None,
    ) -> None:
        """A user who stands still until `follow` and the first `look`.

        Args:
            profile: Parameters, used as they are (see `profiles.sample`).
            rng: Source of all chance of this user.
            chair: What its drive makes of a joystick.
            outline: The chair's box.
            street: What a person sees of kerbs and crossings; without it the user keeps within 0.35 m of its route and
                knows no crossing.
        """
        super().__init__(np.zeros((1, 2)))
        self.profile = profile
        # What one part draws does not change what another does.
        attention_rng, hand_rng, self._miss_rng, self._law_rng, self._fear_rng = rng.spawn(5)
        self._chair = chair
        self._delay_s = profile.reaction_s + profile.lag_s
        self._lookahead_s = _LOOKAHEAD_DELAYS * (self._delay_s + DRIVE_DELAY_S)
        self._street = street
        self._outline = outline
        self._perception = Perception(profile, attention_rng)
        self._hand = SwitchHand(profile) if profile.discrete else Hand(profile, hand_rng)
        self._intent = Joystick(0.0, 0.0)
        self._time_s: float | None = None
        self._yaw_rad = self._yaw_rate_radps = 0.0
        self._correct_at_s = -math.inf
        self._witness: tuple[UserView, Seen] | None = None
        self._moved: tuple[float, Body] | None = (
            None  # when and where the chair last was somewhere else
        )
        self._freed_m = FREE_M
        self._scared_at_s = -math.inf

    def follow(self, route: Route) -> None:
        """Take a new destination; patience and progress begin anew. Raises ConfigError for a route without points."""
        super().follow(route)
        path = Path(route)
        self._edges = Edges(self._street.grid, path) if self._street is not None else None
        items = crossings(route, self._street.walk) if self._street is not None else ()
        ground = None if self._street is None else self._street.grid
        half_length_m, _ = self._outline.half_lw_m
        # Each route has a generator of its own: what it draws does not depend on how far the one before it was driven.
        (law_rng,) = self._law_rng.spawn(1)
        self._kerbs = Kerbs(items, path, ground, self.profile.law_share, law_rng, half_length_m)
        self._stop_m: float | None = None
        self._patience = 1.0
        self._furthest_m = -math.inf
        self._blocked_s = 0.0
        self._lane_m = 0.0
        self._turning: Turning | None = None
        self._turned_last: Turning | None = None

    @property
    def intent(self) -> Joystick:
        """What the user wants, before delay and the hand; never shown to the agent."""
        return self._intent

    @property
    def witness(self) -> tuple[UserView, Seen] | None:
        """What lay before the user at the last look and what of it was noticed, None of a look elsewhere; for tests."""
        return self._witness

    @property
    def obeys(self) -> Mapping[Crossing, bool]:
        """The crossings of this route that the user has come to, and whether it keeps to the law; for measurements."""
        return self._kerbs.obeys if self._path is not None else {}

    def hand(self, steps: int, dt_s: float) -> Joystick:
        """Move the hand on by a tick of `steps` physics steps; the stick afterwards.

        Raises:
            ConfigError: A step is too long for a hand (more than 0.05 s), or not positive, or there is none.
        """
        if steps < 1 or not 0.0 < dt_s <= _LONGEST_STEP_S:
            raise ConfigError(
                f"a hand cannot move in {steps} steps of {dt_s} s; expected at least one, of 0 to {_LONGEST_STEP_S} s: "
                "change world.substeps"
            )
        self._sticks = self._hand.move(steps, dt_s)
        return self.joystick

    def look(self, view: UserView) -> None:
        """Look at the street once: attention, perception, plan. The hand learns of it after its delay."""
        dt_s = 0.0 if self._time_s is None else max(0.0, view.time_s - self._time_s)
        if dt_s > 0.0:
            self._yaw_rate_radps = wrap(view.yaw_rad - self._yaw_rad) / dt_s
        self._yaw_rad, self._time_s = view.yaw_rad, view.time_s
        if self._path is None:
            return
        body = self._body(view, self._path)
        self._witness, self.asks_help = None, False
        # A stop that was begun is carried on without a look; who drives on towards a light keeps it in sight.
        heeds = self._stop_m is None and self._kerbs.heeds_light(self._arc_m)
        if self._perception.attend(dt_s, abs(self._intent.x) < _CALM_STICK, heeds):
            plan = self._plan(view, body, self._path)
            self._patience = plan.patience
            self._intent = self._corrected(plan.wish, view.time_s)
        else:
            self._intent = self._carried_on(body, dt_s)
        self._judge_progress(self._path, dt_s / self._patience)
        if self.arrived or self.gave_up:
            self._intent = Joystick(0.0, 0.0)
        self._hand.want(self._intent)

    def _body(self, view: UserView, path: Path) -> Body:
        """The chair's middle where it will be when the hand answers: drivers steer ahead of their own delay."""
        x, y, yaw = float(view.p_W_m[0]), float(view.p_W_m[1]), view.yaw_rad
        ahead_m = self._outline.middle_x_m
        arc_m = path.project(
            x + ahead_m * math.cos(yaw), y + ahead_m * math.sin(yaw), self._arc_m
        ).arc_m
        # In a hairpin both legs are equally near, and turning there swings the chair's middle from one to the other:
        # who has come to a place of the route does not go back over it by turning.
        self._arc_m = arc_m if arc_m < self._arc_m - _HAIRPIN_M else max(arc_m, self._arc_m)
        delay_s = self._delay_s
        turned = delay_s * self._yaw_rate_radps
        x += delay_s * view.speed_mps * math.cos(yaw + 0.5 * turned) + ahead_m * math.cos(
            yaw + turned
        )
        y += delay_s * view.speed_mps * math.sin(yaw + 0.5 * turned) + ahead_m * math.sin(
            yaw + turned
        )
        there = path.project(x, y, self._arc_m)
        return Body(
            x_m=x,
            y_m=y,
            yaw_rad=yaw + turned,
            speed_mps=view.speed_mps,
            arc_m=max(there.arc_m, self._arc_m),
            left_m=there.left_m,
            half_m=self._outline.half_lw_m,
        )

    def _plan(self, view: UserView, body: Body, path: Path) -> _Plan:
        seen = self._perception.look(view)
        self._witness = (view, seen)
        speed = self.profile.speed_share * self._chair.v_max_mps
        speed = min(speed, path.speed_limit(body.arc_m, _CORNER_RADPS, BRAKE_MPS2, _CORNER_AHEAD_M))
        speed = min(speed, _stopping_speed(path.length_m - body.arc_m, BRAKE_MPS2))
        if self._edges is not None:
            slope_m = self._edges.slope_ahead(
                body.arc_m - 0.5 * self._outline.length_m, _SLOPE_AHEAD_M
            )
            speed = min(
                speed,
                math.hypot(
                    _SLOPE_MPS, _stopping_speed(slope_m - self._outline.length_m, BRAKE_MPS2)
                ),
            )
        kerb_m = self._stop_m = self._kerbs.stop_m(
            self._arc_m, view.time_s, view.signals, seen.vehicles
        )
        if kerb_m is not None:
            speed = min(speed, _stopping_speed(kerb_m - body.arc_m, BRAKE_MPS2))
        safe = body.safe_speed(seen.things, BRAKE_MPS2, self.profile.reaction_s)
        self.asks_help = self._calls(body.speed_mps - safe, view.time_s)
        if safe < speed:
            speed, self._stop_m = safe, body.arc_m + 0.5 * safe**2 / BRAKE_MPS2
        goal_m = (
            body.arc_m + self.profile.lookahead_m + self._lookahead_s * max(0.0, body.speed_mps)
        )
        speed = self._change_lane(
            body, path, seen, speed, self._edges.aside(goal_m) if self._edges else 0.0
        )
        goal = self._goal(body, path, goal_m)
        if kerb_m is not None and speed < 0.3:
            self._moved = None  # who turned here already would swing the footplate over the kerb
            return _Plan(wish=self._straight_on(body, speed), patience=_WAIT_PATIENCE)
        self._free_when_stuck(body, view.time_s)
        turn = self._turned(body, goal, seen, view.time_s)
        if turn is not None:
            return turn
        return _Plan(wish=self._steered(body, goal, speed))

    def _calls(self, too_fast_mps: float, time_s: float) -> bool:
        """Whether it asks for help: it is scared, and was not in the seconds before."""
        if too_fast_mps < SCARED_MPS:
            return False
        scare_begins = time_s - self._scared_at_s > _CALM_S
        self._scared_at_s = time_s
        return scare_begins and bool(self._fear_rng.random() < self.profile.ask_share)

    def _carried_on(self, body: Body, dt_s: float) -> Joystick:
        """What the hand does during a look elsewhere: it lets go of the steering, and goes on with a stop."""
        x, y = self._intent.x, self._intent.y
        x = math.copysign(max(0.0, abs(x) - _CALM_STICK * dt_s / _STRAIGHT_S), x)
        if self._stop_m is not None and y > 0.0:
            y = min(
                y, self._straight_on(body, _stopping_speed(self._stop_m - body.arc_m, BRAKE_MPS2)).y
            )
        return Joystick(x, y)

    def _goal(self, body: Body, path: Path, arc_m: float) -> tuple[float, float]:
        """Where to steer at or beyond a place of the route: far enough off to say a direction.

        On the inside of a sharp bend, a place well ahead along the route may be right beside the chair's axle: turning
        there would change where to turn to, and never end.
        """
        axle, goal = self._axle(body), path.at(arc_m, self._lane_m)
        for farther_m in _GOAL_FARTHER_M:
            if math.dist(goal, (axle.x_m, axle.y_m)) >= _NEAREST_GOAL_M:
                break
            goal = path.at(arc_m + farther_m, self._lane_m)
        return goal

    def _steered(self, body: Body, goal: tuple[float, float], speed_mps: float) -> Joystick:
        return steer(body, goal, speed_mps, self._chair, self._delay_s, self._intent.x)

    def _straight_on(self, body: Body, speed_mps: float) -> Joystick:
        ahead = body.x_m + math.cos(body.yaw_rad), body.y_m + math.sin(body.yaw_rad)
        return self._steered(body, ahead, speed_mps)

    def _turned(
        self, body: Body, goal: tuple[float, float], seen: Seen, time_s: float
    ) -> _Plan | None:
        """A turn on the spot, with room made for it before; None when none is needed."""
        axle = self._axle(body)
        if self._turning is None:
            # seen from the axle, which a turn does not move: else the turn itself would change what is wanted
            error = wrap(math.atan2(goal[1] - axle.y_m, goal[0] - axle.x_m) - body.yaw_rad)
            if (
                self._street is None
                or abs(error) < TURN_IN_PLACE_RAD
                or abs(body.speed_mps) > STANDS_MPS
            ):
                return None
            tried = self._turned_last.tried(axle) if self._turned_last is not None else 0.0
            backwards = not self.profile.discrete
            turn = plan_turn(self._street.grid, self._outline, axle, error, backwards, tried)
            self._turning = self._turned_last = Turning(turn, axle, time_s)
        to_do = self._turning.next(axle, time_s)
        if to_do is None:
            self._turning = None
            return None
        patience = _TURN_PATIENCE if self._turning.turns else 1.0
        on_m, turn_rad = to_do
        if on_m < 0.0:
            return _Plan(wish=Joystick(0.0, _BACK_STICK), patience=patience)
        yaw = body.yaw_rad + min(max(turn_rad, -2.0), 2.0)
        speed = min(CREEP_MPS, body.safe_speed(seen.things, BRAKE_MPS2, self.profile.reaction_s))
        there = (body.x_m + math.cos(yaw), body.y_m + math.sin(yaw))
        return _Plan(
            wish=self._steered(body, there, speed if on_m > 0.0 else 0.0), patience=patience
        )

    def _free_when_stuck(self, body: Body, time_s: float) -> None:
        """Back up, or next time creep on, when the chair hangs on something: a kerb, a caster across."""
        wants = math.hypot(self._intent.x, self._intent.y) > _CALM_STICK
        if self._moved is None or not wants or _apart(self._moved[1], body):
            self._moved = (time_s, body)
        elif time_s - self._moved[0] > STUCK_S and not self.profile.discrete:
            self._freed_m = -self._freed_m
            self._turning = Turning(
                Turn(move_m=self._freed_m, turn_rad=0.0), self._axle(body), time_s
            )
            self._moved = (time_s, body)

    def _change_lane(
        self, body: Body, path: Path, seen: Seen, speed_mps: float, home_m: float
    ) -> float:
        """Pick the offset from the route, `home_m` where nothing is in the way; the speed that goes with it."""
        desired_mps = self.profile.speed_share * self._chair.v_max_mps
        blocked = body.blocked_lanes(path, seen.things, desired_mps)
        if not blocked:
            self._lane_m = home_m
            return speed_mps
        room = (avoidance.DEFAULT_ROOM_M, avoidance.DEFAULT_ROOM_M)
        if self._edges is not None:
            left_m, right_m = self._edges.room(body.arc_m, avoidance.HORIZON_M)
            beside_m = body.half_m[1] + avoidance.EDGE_MARGIN_M
            room = (left_m - beside_m, right_m - beside_m)
        lane = avoidance.choose_lane(blocked, room, self._lane_m, home_m)
        if lane is not None:
            self._lane_m = lane
        off = abs(body.left_m - self._lane_m) > 0.15
        return min(speed_mps, 0.6 * desired_mps) if off or lane is None else speed_mps

    def _corrected(self, wish: Joystick, time_s: float) -> Joystick:
        """Who steers in single corrections changes the plan only now and then, and misses its size."""
        period_s = self.profile.correct_every_s
        if period_s <= 0.0:
            return wish
        if time_s < self._correct_at_s - 1e-9:
            return self._intent
        # From when it was due, not from this tick: else the ticks' grid would make every period longer.
        self._correct_at_s = max(self._correct_at_s, time_s - period_s) + period_s
        wrong_x, wrong_y = (1.0 + _CORRECTION_ERROR * self._miss_rng.standard_normal(2)).tolist()
        return Joystick(*on_disc(wish.x * wrong_x, wish.y * wrong_y))

    def _axle(self, body: Body) -> Axle:
        ahead_m, yaw = self._outline.middle_x_m, body.yaw_rad
        return Axle(
            x_m=body.x_m - ahead_m * math.cos(yaw),
            y_m=body.y_m - ahead_m * math.sin(yaw),
            yaw_rad=yaw,
        )

    def _judge_progress(self, path: Path, patience_s: float) -> None:
        self.arrived = self.arrived or self._arc_m > path.length_m - ARRIVED_M
        if self._arc_m > self._furthest_m + _PROGRESS_M:
            self._furthest_m, self._blocked_s = self._arc_m, 0.0
        else:
            self._blocked_s += patience_s
        tired = not self.patient and self._blocked_s > self.profile.give_up_s
        self.gave_up = self.gave_up or (tired and not self.arrived)


def _apart(a: Body, b: Body) -> bool:
    return (
        math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) > _STUCK_M
        or abs(wrap(a.yaw_rad - b.yaw_rad)) > _STUCK_RAD
    )
