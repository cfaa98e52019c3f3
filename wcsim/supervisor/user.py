"""The simulated user: the person whose joystick the agent follows, or corrects.

It knows its route, sees the street with limited attention, plans like a person who drives (slows down before corners,
goes around what it noticed, waits at a red light, gives up when nothing moves for long), and moves a stick with a hand
that answers late and not quite exactly. Only the stick is shown to the agent; the clean intent is for metrics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.errors import ConfigError
from wcsim.frames import wrap
from wcsim.supervisor import avoidance
from wcsim.supervisor.avoidance import HALF_LENGTH_M, Body
from wcsim.supervisor.crossing import Crossing, crossings, has_light, is_red, vehicle_comes
from wcsim.supervisor.hand import Hand, SwitchHand
from wcsim.supervisor.path import Path
from wcsim.supervisor.perception import Perception, Seen
from wcsim.supervisor.profiles import UserProfile
from wcsim.supervisor.steering import steer, stopping_speed
from wcsim.types import Joystick, Route, Street, UserView

# The drive axle is near the chair's rear end; who steers thinks of its middle.
MIDDLE_AHEAD_M = 0.23
LOOKAHEAD_S = 0.6  # the look-ahead grows with speed
BRAKE_MPS2 = 0.6
CORNER_RADPS = 1.0
CORNER_AHEAD_M = 5.0
CORRECTION_ERROR = 0.25  # relative, of one corrective movement
CALM_STICK = 0.2  # who steers more than this looks at the street
ARRIVED_M = 0.5
PROGRESS_M = 0.25  # less than this is being blocked
WAIT_PATIENCE = 8.0  # at a light or for a vehicle the user waits this many times longer
LONGEST_STEP_S = 0.05
KERB_GAP_M = 0.3  # left between footplate and road while waiting
LIGHT_SEEN_M, TRAFFIC_SEEN_M = 8.0, 3.0  # before the kerb, where the user looks for them


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What the user has decided on."""

    wish: Joystick
    waiting: bool  # at a kerb, which costs little patience


class SimulatedUser:
    """One user during one episode; the episode may have several destinations (`follow`).

    The world calls `look` once a tick and `hand` once a physics step.
    """

    def __init__(
        self,
        profile: UserProfile,
        rng: np.random.Generator,
        v_max_mps: float,
        yaw_rate_max_radps: float,
        step_s: float,
        street: Street | None = None,
    ) -> None:
        """A user who stands still until `follow` and the first `look`.

        Args:
            profile: Parameters, used as they are (see `profiles.sample`).
            rng: Source of all chance of this user.
            v_max_mps: Top speed of the chair.
            yaw_rate_max_radps: Fastest turn in place.
            step_s: Length of a physics step.
            street: What a person sees of kerbs and crossings; without it the user keeps within 0.35 m of its route and
                knows no crossing.

        Raises:
            ConfigError: The step is too long for a hand (more than 0.05 s), or not positive.
        """
        if not 0.0 < step_s <= LONGEST_STEP_S:
            raise ConfigError(f"step_s is {step_s}; expected 0 < step_s <= {LONGEST_STEP_S}: call hand() more often")
        self.profile = profile
        self.arrived = False
        self.gave_up = False
        attention_rng, hand_rng, self._rng = rng.spawn(3)  # what one part draws does not change what another does
        self._limits = (v_max_mps, yaw_rate_max_radps)
        self._delay_s = profile.reaction_s + profile.lag_s
        self._street = street
        self._perception = Perception(profile, attention_rng)
        self._hand = SwitchHand(profile) if profile.discrete else Hand(profile, hand_rng)
        self._stick = Joystick(0.0, 0.0)
        self._intent = Joystick(0.0, 0.0)
        self._time_s: float | None = None
        self._yaw_rad = self._yaw_rate_radps = 0.0
        self._correct_at_s = -math.inf
        self._path: Path | None = None

    def follow(self, route: Route) -> None:
        """Take a new destination; patience and progress begin anew. Raises ConfigError for a route without points."""
        self._path = Path(route)
        self._crossings = crossings(route, self._street.walk) if self._street is not None else ()
        self._obeys: dict[Crossing, bool] = {}
        self._arc_m = 0.0
        self._furthest_m = -math.inf
        self._blocked_s = 0.0
        self._lane_m = 0.0
        self.arrived = self.gave_up = False

    @property
    def joystick(self) -> Joystick:
        """The stick now, on the unit disc: what the agent is shown."""
        return self._stick

    @property
    def intent(self) -> Joystick:
        """What the user wants, before delay and the hand; never shown to the agent."""
        return self._intent

    @property
    def route_progress_m(self) -> float:
        """How far along the present route the chair is."""
        return self._arc_m if self._path is not None else 0.0

    def hand(self, dt_s: float) -> Joystick:
        """Move the hand on by one physics step; the stick afterwards."""
        self._stick = self._hand.move(dt_s)
        return self._stick

    def look(self, view: UserView) -> None:
        """Look at the street once: attention, perception, plan. The hand learns of it after its delay."""
        dt_s = 0.0 if self._time_s is None else max(0.0, view.time_s - self._time_s)
        if dt_s > 0.0:
            self._yaw_rate_radps = wrap(view.yaw_rad - self._yaw_rad) / dt_s
        self._yaw_rad, self._time_s = view.yaw_rad, view.time_s
        if self._path is None:
            return
        body = self._body(view, self._path)
        waiting = False
        if self._perception.attend(dt_s, abs(self._intent.x) < CALM_STICK):
            plan = self._plan(view, body, self._path)
            waiting = plan.waiting
            self._intent = self._corrected(plan.wish, view.time_s)
        self._judge_progress(self._path, dt_s / WAIT_PATIENCE if waiting else dt_s)
        if self.arrived or self.gave_up:
            self._intent = Joystick(0.0, 0.0)
        self._hand.want(self._intent)

    def _body(self, view: UserView, path: Path) -> Body:
        """The chair's middle where it will be when the hand answers: drivers steer ahead of their own delay."""
        x, y, yaw = float(view.p_W_m[0]), float(view.p_W_m[1]), view.yaw_rad
        now = path.project(x + MIDDLE_AHEAD_M * math.cos(yaw), y + MIDDLE_AHEAD_M * math.sin(yaw), self._arc_m)
        self._arc_m = now.arc_m
        delay_s = self._delay_s
        turned = delay_s * self._yaw_rate_radps
        x += delay_s * view.speed_mps * math.cos(yaw + 0.5 * turned) + MIDDLE_AHEAD_M * math.cos(yaw + turned)
        y += delay_s * view.speed_mps * math.sin(yaw + 0.5 * turned) + MIDDLE_AHEAD_M * math.sin(yaw + turned)
        there = path.project(x, y, self._arc_m)
        return Body(
            x_m=x,
            y_m=y,
            yaw_rad=yaw + turned,
            speed_mps=view.speed_mps,
            arc_m=there.arc_m,
            left_m=there.left_m,
        )

    def _plan(self, view: UserView, body: Body, path: Path) -> Plan:
        seen = self._perception.look(view)
        speed = self.profile.speed_share * self._limits[0]
        speed = min(speed, path.speed_limit(body.arc_m, CORNER_RADPS, BRAKE_MPS2, CORNER_AHEAD_M))
        speed = min(speed, stopping_speed(path.length_m - body.arc_m, BRAKE_MPS2))
        kerb_m = self._kerb_to_wait_at(view, body, seen)
        if kerb_m is not None:
            speed = min(speed, stopping_speed(kerb_m - body.arc_m, BRAKE_MPS2))
        speed = min(speed, avoidance.safe_speed(body, seen.things, BRAKE_MPS2, self.profile.reaction_s))
        speed = self._change_lane(body, path, seen, speed)
        ahead_m = self.profile.lookahead_m + LOOKAHEAD_S * max(0.0, body.speed_mps)
        goal = path.at(body.arc_m + ahead_m, self._lane_m)
        wish = steer(body, goal, speed, self._limits, self._delay_s, self._intent.x)
        waiting = kerb_m is not None and speed < 0.3
        return Plan(wish=wish, waiting=waiting)

    def _change_lane(self, body: Body, path: Path, seen: Seen, speed_mps: float) -> float:
        """Pick the offset from the route; the speed that goes with it."""
        blocked = avoidance.blocked_lanes(path, body, seen.things, self.profile.speed_share * self._limits[0])
        if not blocked:
            self._lane_m = 0.0
            return speed_mps
        room = (avoidance.DEFAULT_ROOM_M, avoidance.DEFAULT_ROOM_M)
        if self._street is not None:
            room = avoidance.side_room(self._street.grid, path, body.arc_m)
        lane = avoidance.choose_lane(blocked, room, self._lane_m)
        if lane is not None:
            self._lane_m = lane
        off = abs(body.left_m - self._lane_m) > 0.15
        return min(speed_mps, 0.6 * self.profile.speed_share * self._limits[0]) if off or lane is None else speed_mps

    def _kerb_to_wait_at(self, view: UserView, body: Body, seen: Seen) -> float | None:
        """Arc where the chair's middle must stop because of a light or a vehicle; None when the way is free."""
        behind_m = -math.inf
        for item in self._crossings:
            stop_m = item.start_m - HALF_LENGTH_M - KERB_GAP_M
            island = stop_m > behind_m + HALF_LENGTH_M  # too short a refuge is no place to wait
            behind_m = item.end_m
            to_go_m = stop_m - body.arc_m
            if not -0.4 < to_go_m < LIGHT_SEEN_M or not island:
                continue
            if item not in self._obeys:
                self._obeys[item] = bool(self._rng.random() < self.profile.law_share)
            if not self._obeys[item]:
                continue
            if is_red(item, view.signals):
                return stop_m
            watched = to_go_m < TRAFFIC_SEEN_M and not has_light(item, view.signals)
            if watched and vehicle_comes(item, seen.vehicles):
                return stop_m
        return None

    def _corrected(self, wish: Joystick, time_s: float) -> Joystick:
        """Who steers in single corrections changes the plan only now and then, and misses its size."""
        period_s = self.profile.correct_every_s
        if period_s <= 0.0:
            return wish
        if time_s < self._correct_at_s:
            return self._intent
        self._correct_at_s = time_s + period_s
        wrong_x, wrong_y = (1.0 + CORRECTION_ERROR * self._rng.standard_normal(2)).tolist()
        return Joystick(wish.x * wrong_x, wish.y * wrong_y)

    def _judge_progress(self, path: Path, patience_s: float) -> None:
        self.arrived = self.arrived or self._arc_m > path.length_m - ARRIVED_M
        if self._arc_m > self._furthest_m + PROGRESS_M:
            self._furthest_m, self._blocked_s = self._arc_m, 0.0
        else:
            self._blocked_s += patience_s
        self.gave_up = self.gave_up or (self._blocked_s > self.profile.give_up_s and not self.arrived)
