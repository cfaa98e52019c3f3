"""The simulated user: what a person with a joystick does in a tick, from the street to the stick.

It knows its route, sees the street with limited attention, and plans like a practised driver: it
slows down before corners, goes around what it detected, waits at a red light, and gives up when
nothing moves for long. Its hand answers late and not quite exactly. The agent sees the stick alone;
the clean intent is for metrics.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Final, Protocol

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.frames import wrap_angle
from wcsim.core.joystick import compute_yaw_rate_limit, raw_radius_from_shaped
from wcsim.errors import ConfigError
from wcsim.types import F64, Joystick, Outline, Route, Street, UserView
from wcsim.types.chair import AT_REST
from wcsim.users.avoidance import LateralOffsetPlanner, PredictedChairPose
from wcsim.users.crossing import CrossingStopPlanner, RouteCrossing, find_route_crossings
from wcsim.users.hand import StickHandModel, SwitchHandModel, clip_to_disc
from wcsim.users.perception import FARTHEST_SIGHT, PerceivedObjects, UserPerception
from wcsim.users.profiles import UserProfile
from wcsim.users.route_line import RoutePolyline
from wcsim.users.turning import ActiveTurn, AxlePose, TurnPlan, plan_turn

_LONGEST_STEP_S: Final = 0.05
_ARRIVED_M: Final = 0.5
_PROGRESS_M: Final = 0.25  # less than this is being blocked
# A user gives up so many times later where it waits for a light or a vehicle, or turns round.
_WAIT_FACTOR: Final = 12.0
_TURN_FACTOR: Final = 3.0
# In a hairpin both legs are equally near, and a turn there swings the chair's middle from one leg
# to the other. Going back less than this along the route is such a swing.
_HAIRPIN_M: Final = 1.0

# Turn rate for each radian of heading error. A delayed integrator is stable for gain * delay below
# pi / 2. Drivers stay well below: with a late answer, a strong turn would make the chair swing.
_GAIN_DELAY: Final = 0.6
_GAIN_MAX_PER_S: Final = 1.4
_TURN_MAX_RADPS: Final = 1.0
_DRIVE_DELAY_S: Final = 0.1  # of the chair's own drive
_TURN_IN_PLACE_RAD: Final = 1.0
_BEHIND_RAD: Final = 2.6
_LEAST_STICK: Final = 0.02

_BRAKE_MPS2: Final = 0.6
_CORNER_RADPS: Final = 1.0
_CORNER_AHEAD_M: Final = 5.0
_SLOPE_MPS: Final = 0.8
_SLOPE_AHEAD_M: Final = 4.0  # how far ahead a ramp is seen
_AT_KERB_MPS: Final = 0.3  # slower than this, the user waits at the kerb
# The look-ahead grows with the way that is driven until the chair answers: else it would weave.
_LOOKAHEAD_DELAYS: Final = 1.25
# A place nearer to the drive axle than this gives no direction, so farther ones are tried.
_NEAREST_GOAL_M: Final = 0.5
_GOAL_FARTHER_M: Final = tuple(0.25 * step for step in range(1, 11))

_CALM_STICK: Final = 0.2  # a user that steers more than this looks at the street
_STRAIGHT_S: Final = 0.5  # so long after the start of a look elsewhere the stick is straight
_CORRECTION_ERROR: Final = 0.25  # relative, of one corrective movement
_SCARED_MPS: Final = 0.3  # so much above the safe speed, something was seen late
_CALM_S: Final = 5.0  # so long without that, a scare is over

_STANDS_MPS: Final = 0.25  # a slower chair may plan a turn in place
_MOST_TURN_AHEAD_RAD: Final = 2.0
_CREEP_MPS: Final = 0.3
_BACK_STICK: Final = -0.5
# A chair that gets a command for so long and moves less than this hangs somewhere. Who feels that
# the chair stands lets go before.
_LET_GO_S: Final = 1.0
_STUCK_S: Final = 2.5
_STUCK_M: Final = 0.1
_STUCK_RAD: Final = 0.15
_FREE_M: Final = 0.5  # how far it is backed up then


class User(ABC):
    """The driver of a seat in one episode; the episode may have several destinations (`follow`).

    The world calls `move_hand` for the steps of a tick, and `look` at the tick's end.
    """

    def __init__(self, sticks: F64) -> None:
        """A user without a destination, whose stick is at the last of these (n, 2)."""
        self.arrived = False
        self.gave_up = False
        self.requests_help = False  # at the last look; it moves no stick
        self.sight_m = math.inf  # who is farther away is not shown to it
        self.patient = False  # never gives up: another driver drives, and this one knows the way
        self._sticks = sticks
        self._path: RoutePolyline | None = None
        self._arc_m = 0.0  # of the chair's middle along the route

    def follow(self, route: Route) -> None:
        """Take a new destination. Raises ConfigError for a route without points."""
        self._path = RoutePolyline(route)
        self._arc_m = 0.0
        self.arrived = self.gave_up = False

    @abstractmethod
    def move_hand(self, steps: int, dt_s: float) -> Joystick:
        """Move on by a tick of `steps` physics steps; the stick afterwards."""

    @abstractmethod
    def look(self, view: UserView) -> None:
        """See the street once, and how far the chair has come."""

    @property
    @abstractmethod
    def intent(self) -> Joystick:
        """The stick that the user intends, before delay and hand; never shown to the agent."""

    @property
    def joystick(self) -> Joystick:
        """The stick now, on the unit disc: what the agent is shown."""
        return Joystick(*self._sticks[-1].tolist())

    @property
    def sticks(self) -> F64:
        """The stick (steps, 2) after each step of the last `move_hand`, for measurements."""
        return self._sticks

    @property
    def route_progress_m(self) -> float:
        """How far along the present route the chair is."""
        return self._arc_m

    def _middle_arc_m(self, path: RoutePolyline, view: UserView, middle_x_m: float) -> float:
        """The place of the chair's middle on the route, searched around its last place."""
        x_m, y_m, yaw_rad = float(view.p_W_m[0]), float(view.p_W_m[1]), view.yaw_rad
        x_m += middle_x_m * math.cos(yaw_rad)
        y_m += middle_x_m * math.sin(yaw_rad)
        return path.project(x_m, y_m, self._arc_m).arc_m

    def _move_along(self, path: RoutePolyline, arc_m: float) -> None:
        """Set the place on the route; near its end the user has arrived."""
        self._arc_m = arc_m
        self.arrived = self.arrived or arc_m > path.length_m - _ARRIVED_M


class _StickRecording(Protocol):
    """A stick that was recorded in the place of a profile."""

    def user(self, episode: int, outline: Outline) -> User:
        """The user that replays it in an episode."""

    def require_driven_here(self, town: str, town_sha256: Callable[[], str]) -> None:
        """Refuse a stick of another town, or of another state of this one.

        Raises:
            ConfigError: With both towns.
        """


FindUser = Callable[[str], UserProfile | _StickRecording]
"""Finds a user by its name. Raises ConfigError for an unknown one."""


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
        """A user that stands still until `follow` and the first `look`.

        Args:
            profile: Parameters, used as they are (see `profiles.sample_profile`).
            rng: Source of all chance of this user.
            chair: What its drive makes of a joystick.
            outline: The chair's box.
            street: Kerbs and crossings as a person sees them. Without it the user stays within
                0.35 m of its route and knows no crossing.
        """
        super().__init__(np.zeros((1, 2)))
        self.profile = profile
        self._chair = chair
        self._outline = outline
        self._street = street
        # A generator for each part: what one part draws does not change what another does.
        attention_rng, hand_rng, self._miss_rng, self._law_rng, self._fear_rng = rng.spawn(5)
        self._perception = UserPerception(profile, attention_rng)
        self.sight_m = FARTHEST_SIGHT * profile.see_m
        self._hand = (
            SwitchHandModel(profile) if profile.discrete else StickHandModel(profile, hand_rng)
        )
        self._delay_s = profile.reaction_s + profile.lag_s
        self._intent = AT_REST
        self._time_s: float | None = None
        self._yaw_rad = 0.0
        self._yaw_rate_radps = 0.0
        self._correct_at_s = -math.inf
        self._scared_at_s = -math.inf
        self._witness: tuple[UserView, PerceivedObjects] | None = None
        self._moved: tuple[float, PredictedChairPose] | None = (
            None  # when and where the chair last moved
        )
        self._freed_m = _FREE_M

    def follow(self, route: Route) -> None:
        """Take a new destination; progress and its timeout start anew.

        Raises:
            ConfigError: The route has no points.
        """
        super().follow(route)
        path = RoutePolyline(route)
        street = self._street
        ground = None if street is None else street.grid
        # Whether the user obeys the law is drawn by a generator of each route: it does not depend
        # on how far the chair got on the route before. Attention, hand, misses and fear draw on.
        (law_rng,) = self._law_rng.spawn(1)
        self._stops = CrossingStopPlanner(
            () if street is None else find_route_crossings(route, street.walk),
            path,
            ground,
            self.profile.law_share,
            law_rng,
            self._outline.half_lw_m[0],
        )
        self._lanes = LateralOffsetPlanner(path, ground)
        self._stop_m: float | None = None  # where the chair's middle is to stop
        self._turn: ActiveTurn | None = None
        self._last_turn: ActiveTurn | None = None
        self._furthest_m = -math.inf
        self._blocked_s = 0.0
        self._wait_factor = 1.0  # the user gives up so many times later

    @property
    def intent(self) -> Joystick:
        """The stick that the user intends, before delay and hand; never shown to the agent."""
        return self._intent

    @property
    def witness(self) -> tuple[UserView, PerceivedObjects] | None:
        """What was there at the last look and what of it was detected; None of a look elsewhere.

        It is for tests.
        """
        return self._witness

    @property
    def obeys(self) -> Mapping[RouteCrossing, bool]:
        """The crossings reached so far on this route, and whether the user obeys the law there.

        It is for measurements.
        """
        return self._stops.obeys if self._path is not None else {}

    def move_hand(self, steps: int, dt_s: float) -> Joystick:
        """Move the hand on by a tick of `steps` physics steps; the stick afterwards.

        Raises:
            ConfigError: A step is too long for a hand (more than 0.05 s), or not positive, or there
                is none.
        """
        if steps < 1 or not 0.0 < dt_s <= _LONGEST_STEP_S:
            raise ConfigError(
                f"a hand cannot move in {steps} steps of {dt_s} s; "
                f"expected at least one, of 0 to {_LONGEST_STEP_S} s: change world.substeps"
            )
        self._sticks = self._hand.move(steps, dt_s)
        return self.joystick

    def look(self, view: UserView) -> None:
        """Do what a person does in a tick: look, plan, and send the intent to the hand."""
        # 1. Feel the turn since the last look.
        dt_s = 0.0 if self._time_s is None else max(0.0, view.time_s - self._time_s)
        if dt_s > 0.0:
            self._yaw_rate_radps = wrap_angle(view.yaw_rad - self._yaw_rad) / dt_s
        self._yaw_rad = view.yaw_rad
        self._time_s = view.time_s
        path = self._path
        if path is None:
            return

        # 2. Find the place on the route. A turn in a hairpin does not lead back along it.
        arc_m = self._middle_arc_m(path, view, self._outline.middle_x_m)
        went_back = arc_m < self._arc_m - _HAIRPIN_M
        self._move_along(path, arc_m if went_back else max(arc_m, self._arc_m))
        body = self._predicted_body(view, path)

        # 3. Look at the street or elsewhere. A stop under way goes on without a look; a user that
        # drives on towards a light keeps it in sight.
        self._witness = None
        self.requests_help = False
        heeds = self._stop_m is None and self._stops.heeds_light(self._arc_m)
        calm = abs(self._intent.x) < _CALM_STICK

        # 4. Plan the stick by what was seen, or let the steering go during a look elsewhere.
        if self._perception.step_attention(dt_s, calm, heeds):
            self._intent = self._draw_correction(self._plan(view, body, path), view.time_s)
        else:
            self._intent = self._unattended(body, dt_s)

        # 5. Let go where the chair stands against something. That is felt, without a look.
        if self._lets_go(body, view.time_s):
            self._intent = AT_REST

        # 6. Judge the progress: too long without any, and the user gives up.
        if self._arc_m > self._furthest_m + _PROGRESS_M:
            self._furthest_m = self._arc_m
            self._blocked_s = 0.0
        else:
            self._blocked_s += dt_s / self._wait_factor
        tired = not self.patient and self._blocked_s > self.profile.give_up_s
        self.gave_up = self.gave_up or (tired and not self.arrived)
        if self.arrived or self.gave_up:
            self._intent = AT_REST

        # 7. Send the intent on its way. The hand gets it after the reaction time.
        self._hand.send_intent(self._intent)

    def _plan(self, view: UserView, body: PredictedChairPose, path: RoutePolyline) -> Joystick:
        """The stick for what the user sees; sets stop, lane, turn and request for help."""
        profile = self.profile
        desired_mps = profile.speed_share * self._chair.v_max_mps
        self._wait_factor = 1.0

        # 1. Perceive.
        seen = self._perception.update(view)
        self._witness = (view, seen)

        # 2. Slow down for what the route has: corners, its end, a ramp, a kerb to wait at.
        rear_m = body.arc_m - 0.5 * self._outline.length_m
        slope_m = self._lanes.slope_ahead(rear_m, _SLOPE_AHEAD_M)
        speed_mps = min(
            desired_mps,
            path.speed_limit(body.arc_m, _CORNER_RADPS, _BRAKE_MPS2, _CORNER_AHEAD_M),
            _stopping_speed(path.length_m - body.arc_m),
            math.hypot(_SLOPE_MPS, _stopping_speed(slope_m - self._outline.length_m)),
        )
        kerb_m = self._stops.stop_m(self._arc_m, view.time_s, view.signals, seen.vehicles)
        self._stop_m = kerb_m
        if kerb_m is not None:
            speed_mps = min(speed_mps, _stopping_speed(kerb_m - body.arc_m))

        # 3. Slow down for what is in the way. What is seen late scares.
        safe_mps = body.safe_speed(seen.things, _BRAKE_MPS2, profile.reaction_s)
        self.requests_help = self._draw_help_request(body.speed_mps - safe_mps, view.time_s)
        if safe_mps < speed_mps:
            speed_mps = safe_mps
            self._stop_m = body.arc_m + 0.5 * safe_mps**2 / _BRAKE_MPS2

        # 4. Choose the lane and the point to steer to.
        answer_m = _LOOKAHEAD_DELAYS * (self._delay_s + _DRIVE_DELAY_S) * max(0.0, body.speed_mps)
        goal_m = body.arc_m + profile.lookahead_m + answer_m
        lane_mps = self._lanes.change_lane(body, seen.things, desired_mps, goal_m)
        speed_mps = min(speed_mps, lane_mps)
        goal = self._goal(body, path, goal_m)

        # 5. Wait at the kerb. A turn there would swing the footplate over it.
        if kerb_m is not None and speed_mps < _AT_KERB_MPS:
            self._moved = None
            self._wait_factor = _WAIT_FACTOR
            return self._straight_on(body, speed_mps)

        # 6. Turn in place, or drive on.
        turn = self._turn_in_place(body, goal, seen, view.time_s)
        return self._steer(body, goal, speed_mps) if turn is None else turn

    def _predicted_body(self, view: UserView, path: RoutePolyline) -> PredictedChairPose:
        """The chair's middle where it will be when the hand answers: drivers steer ahead of it."""
        delay_s = self._delay_s
        ahead_m = self._outline.middle_x_m
        turned_rad = delay_s * self._yaw_rate_radps
        driven_m = delay_s * view.speed_mps
        course_rad = view.yaw_rad + 0.5 * turned_rad
        yaw_rad = view.yaw_rad + turned_rad
        x_m = float(view.p_W_m[0])
        y_m = float(view.p_W_m[1])
        x_m += driven_m * math.cos(course_rad) + ahead_m * math.cos(yaw_rad)
        y_m += driven_m * math.sin(course_rad) + ahead_m * math.sin(yaw_rad)
        place = path.project(x_m, y_m, self._arc_m)
        return PredictedChairPose(
            x_m=x_m,
            y_m=y_m,
            yaw_rad=yaw_rad,
            speed_mps=view.speed_mps,
            arc_m=max(place.arc_m, self._arc_m),
            left_m=place.left_m,
            half_m=self._outline.half_lw_m,
        )

    def _unattended(self, body: PredictedChairPose, dt_s: float) -> Joystick:
        """The stick of a look elsewhere: the hand lets the steering go, and goes on with a stop."""
        x, y = self._intent.x, self._intent.y
        x = math.copysign(max(0.0, abs(x) - _CALM_STICK * dt_s / _STRAIGHT_S), x)
        if self._stop_m is not None and y > 0.0:
            y = min(y, self._straight_on(body, _stopping_speed(self._stop_m - body.arc_m)).y)
        return Joystick(x, y)

    def _draw_correction(self, stick: Joystick, time_s: float) -> Joystick:
        """The intent of a user that may steer in single corrections, which miss their size."""
        period_s = self.profile.correct_every_s
        if period_s <= 0.0:
            return stick
        if time_s < self._correct_at_s - 1e-9:
            return self._intent
        # Counted from when it was due: the grid of ticks would make every period longer.
        self._correct_at_s = max(self._correct_at_s, time_s - period_s) + period_s
        wrong_x, wrong_y = (1.0 + _CORRECTION_ERROR * self._miss_rng.standard_normal(2)).tolist()
        return Joystick(*clip_to_disc(stick.x * wrong_x, stick.y * wrong_y))

    def _draw_help_request(self, too_fast_mps: float, time_s: float) -> bool:
        """Whether a scare starts now and the user requests help, which is drawn for each scare."""
        if too_fast_mps < _SCARED_MPS:
            return False
        starts = time_s - self._scared_at_s > _CALM_S
        self._scared_at_s = time_s
        return starts and bool(self._fear_rng.random() < self.profile.ask_share)

    def _goal(
        self, body: PredictedChairPose, path: RoutePolyline, arc_m: float
    ) -> tuple[float, float]:
        """Where to steer at or beyond a place of the route: far enough off to give a direction.

        On the inside of a sharp bend, a place well ahead may be right beside the chair's axle. A
        turn towards it would change where to turn to, and never end.
        """
        axle = self._axle(body)
        goal = path.at(arc_m, self._lanes.offset_m)
        for farther_m in _GOAL_FARTHER_M:
            if math.dist(goal, (axle.x_m, axle.y_m)) >= _NEAREST_GOAL_M:
                break
            goal = path.at(arc_m + farther_m, self._lanes.offset_m)
        return goal

    def _lets_go(self, body: PredictedChairPose, time_s: float) -> bool:
        """Whether the hand rests because the chair hangs on something.

        It may be a kerb, a wall, or a caster that stands across. After the rest the user tries
        again: it backs up, or next time creeps on.
        """
        standing_s = 0.0 if self._moved is None else time_s - self._moved[0]
        # The chair cannot move before the hand does.
        rests = standing_s > _LET_GO_S + self._delay_s
        pushes = math.hypot(self._intent.x, self._intent.y) > _CALM_STICK
        if self._moved is None or not (pushes or rests) or _are_apart(self._moved[1], body):
            self._moved = (time_s, body)
            return False
        if standing_s <= _STUCK_S:
            return rests
        self._moved = (time_s, body)
        if not self.profile.discrete:
            self._freed_m = -self._freed_m
            way_out = TurnPlan(move_m=self._freed_m, turn_rad=0.0)
            self._turn = ActiveTurn(way_out, self._axle(body), time_s)
        return False

    def _turn_in_place(
        self,
        body: PredictedChairPose,
        goal: tuple[float, float],
        seen: PerceivedObjects,
        time_s: float,
    ) -> Joystick | None:
        """The stick of a turn in place, with room made for it before; None when none is needed."""
        axle = self._axle(body)
        if self._turn is None:
            # Seen from the axle, which a turn does not move: else the turn would change the error.
            error_rad = wrap_angle(
                math.atan2(goal[1] - axle.y_m, goal[0] - axle.x_m) - body.yaw_rad
            )
            far_off = abs(error_rad) >= _TURN_IN_PLACE_RAD
            if self._street is None or not far_off or abs(body.speed_mps) > _STANDS_MPS:
                return None
            tried = 0.0 if self._last_turn is None else self._last_turn.tried_side(axle)
            backwards = not self.profile.discrete
            plan = plan_turn(self._street.grid, self._outline, axle, error_rad, backwards, tried)
            self._turn = self._last_turn = ActiveTurn(plan, axle, time_s)
        remaining = self._turn.advance(axle, time_s)
        if remaining is None:
            self._turn = None
            return None
        if self._turn.turns:
            self._wait_factor = _TURN_FACTOR
        on_m, turn_rad = remaining
        if on_m < 0.0:
            return Joystick(0.0, _BACK_STICK)
        turn_rad = min(max(turn_rad, -_MOST_TURN_AHEAD_RAD), _MOST_TURN_AHEAD_RAD)
        safe_mps = body.safe_speed(seen.things, _BRAKE_MPS2, self.profile.reaction_s)
        return self._steer_along(
            body, body.yaw_rad + turn_rad, min(_CREEP_MPS, safe_mps) if on_m > 0.0 else 0.0
        )

    def _straight_on(self, body: PredictedChairPose, speed_mps: float) -> Joystick:
        return self._steer_along(body, body.yaw_rad, speed_mps)

    def _steer_along(self, body: PredictedChairPose, yaw_rad: float, speed_mps: float) -> Joystick:
        ahead = (body.x_m + math.cos(yaw_rad), body.y_m + math.sin(yaw_rad))
        return self._steer(body, ahead, speed_mps)

    def _steer(
        self, body: PredictedChairPose, goal: tuple[float, float], speed_mps: float
    ) -> Joystick:
        return plan_stick_to_goal(body, goal, speed_mps, self._chair, self._delay_s, self._intent.x)

    def _axle(self, body: PredictedChairPose) -> AxlePose:
        """The drive axle of a body. It may be near the chair's rear, and a body is the middle."""
        ahead_m, yaw_rad = self._outline.middle_x_m, body.yaw_rad
        return AxlePose(
            x_m=body.x_m - ahead_m * math.cos(yaw_rad),
            y_m=body.y_m - ahead_m * math.sin(yaw_rad),
            yaw_rad=yaw_rad,
        )


def plan_stick_to_goal(
    body: PredictedChairPose,
    goal: tuple[float, float],
    speed_mps: float,
    chair: ChairConfig,
    delay_s: float,
    before_x: float,
) -> Joystick:
    """The stick that turns towards `goal` and drives at `speed_mps`; in place when it is far off.

    Args:
        body: The chair's middle.
        goal: Point (x, y) in W to drive to.
        speed_mps: Speed when the goal is straight ahead.
        chair: Its limits, and how far a stick must be moved before anything happens: the user has
            learnt them.
        delay_s: How late the driver's hand answers.
        before_x: The stick's x of the plan before, for goals right behind.
    """
    error_rad = wrap_angle(math.atan2(goal[1] - body.y_m, goal[0] - body.x_m) - body.yaw_rad)
    # A goal right behind may be taken on either side: stay on the side of the plan before.
    if abs(error_rad) > _BEHIND_RAD and before_x * error_rad > 0.0:
        error_rad = -error_rad
    if abs(error_rad) > _TURN_IN_PLACE_RAD:
        speed_mps = 0.0
    else:
        speed_mps *= math.cos(error_rad) ** 2
    w_limit_radps = compute_yaw_rate_limit(
        max(abs(body.speed_mps), speed_mps), chair.yaw_rate_max_radps, chair.yaw_slowdown_s_per_m
    )
    stable_per_s = _GAIN_DELAY / (delay_s + _DRIVE_DELAY_S)
    gain_per_s = min(_GAIN_MAX_PER_S, stable_per_s)
    most = min(1.0, min(_TURN_MAX_RADPS, stable_per_s) / w_limit_radps)
    x = min(most, max(-most, -gain_per_s * error_rad / w_limit_radps))
    y = min(speed_mps / chair.v_max_mps, math.sqrt(1.0 - x * x))
    radius = math.hypot(x, y)
    if radius < _LEAST_STICK:
        return AT_REST
    scale = raw_radius_from_shaped(radius, chair) / radius
    return Joystick(x * scale, y * scale)


def _stopping_speed(distance_m: float) -> float:
    """The speed from which gentle braking stops within a distance; 0 when it is passed already."""
    return math.sqrt(2.0 * _BRAKE_MPS2 * max(0.0, distance_m))


def _are_apart(a: PredictedChairPose, b: PredictedChairPose) -> bool:
    return (
        math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) > _STUCK_M
        or abs(wrap_angle(a.yaw_rad - b.yaw_rad)) > _STUCK_RAD
    )
