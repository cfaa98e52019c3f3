"""A small kinematic world for user and oracle: the drive's limits on a flat plane, no physics engine."""

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from tests.support.plants import plant_state
from tests.support.samples import ACTIONS, strip_street
from tests.users.actors import user_view
from wcsim.config import ChairConfig
from wcsim.types import ActorState, Joystick, PlantState, Route, SignalState, UserView
from wcsim.users.user import SimulatedUser

TICK_S = 0.1
SUBSTEPS = 24
MIDDLE_M = 0.23
GROUND = strip_street().grid


@dataclass
class Chair:
    """Pose and speed of a chair that obeys its drive at once, within its limits."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    v: float = 0.0
    w: float = 0.0
    a: float = 0.0
    config: ChairConfig = field(default_factory=ChairConfig)

    def drive(self, stick: Joystick, dt_s: float) -> None:
        c = self.config
        radius = math.hypot(stick.x, stick.y)
        out = max(0.0, min(radius, 1.0) - c.deadband) / (1.0 - c.deadband) / max(radius, 1e-9)
        x, y = stick.x * out, stick.y * out
        v_to = y * c.v_max_mps * (c.reverse_share if y < 0 else 1.0)
        w_to = -x * c.yaw_rate_max_radps / (1 + 0.6 * max(abs(v_to), abs(self.v)))
        gap = v_to - self.v
        limit = c.decel_mps2 if self.v * gap < 0 else c.accel_mps2
        a_to = math.copysign(min(limit, math.sqrt(2 * c.jerk_mps3 * abs(gap))), gap)
        self.a += clip(a_to - self.a, c.jerk_mps3 * dt_s)
        move = self.a * dt_s
        if abs(gap) <= abs(move) or abs(gap) < 1e-4:
            self.v, self.a = v_to, 0.0
        else:
            self.v += move
        self.w += clip(w_to - self.w, c.yaw_accel_radps2 * dt_s)
        self.yaw += self.w * dt_s
        self.x += self.v * math.cos(self.yaw) * dt_s
        self.y += self.v * math.sin(self.yaw) * dt_s

    def middle(self) -> tuple[float, float]:
        return self.x + MIDDLE_M * math.cos(self.yaw), self.y + MIDDLE_M * math.sin(self.yaw)

    def plant(self) -> PlantState:
        return plant(self.x, self.y, self.yaw, self.v, self.w)


def clip(value: float, most: float) -> float:
    return min(max(value, -most), most)


def plant(x: float, y: float, yaw: float, v: float = 0.0, w: float = 0.0) -> PlantState:
    """A chair that stands on the ground of the sample street."""
    state = plant_state(x, y, yaw=yaw, ahead_mps=v, turn_radps=w)
    return replace(state, p_WB_m=np.array([x, y, GROUND.height_here(x, y)]))


@dataclass
class Track:
    """What a run left behind, one entry a tick."""

    xy: list[tuple[float, float]] = field(default_factory=list)  # the chair's middle
    sticks: list[Joystick] = field(default_factory=list)
    speed: list[float] = field(default_factory=list)
    yaw_rate: list[float] = field(default_factory=list)

    def array(self) -> np.ndarray:
        return np.array(self.xy)


class Sim:
    """One user in one chair on a plane; `actors`, `signals` and `obstacles` are functions of time or constants."""

    def __init__(self, user: SimulatedUser, route: Route, chair: Chair, quantised: bool = False):
        self.user, self.route, self.chair = user, route, chair
        self.actors: tuple[ActorState, ...] = ()
        self.signals: tuple[SignalState, ...] = ()
        self.obstacles = np.zeros((0, 3))
        self.time_s = 0.0
        self.track = Track()
        self._points = ACTIONS if quantised else None
        self.frozen = False
        user.follow(route)
        user.look(self.view())

    def view(self) -> UserView:
        c = self.chair
        return user_view(self.route, self.time_s, (c.x, c.y, c.yaw), c.v, self.actors, self.signals, self.obstacles)

    def tick(self) -> None:
        """One tick: the stick of its beginning is driven, as an agent that follows would."""
        stick = self.user.joystick
        if self._points is not None:
            x, y = self._points.points[self._points.nearest((stick.x, stick.y))]
            stick = Joystick(float(x), float(y))
        for _ in range(SUBSTEPS):
            if not self.frozen:
                self.chair.drive(stick, TICK_S / SUBSTEPS)
        self.user.move_hand(SUBSTEPS, TICK_S / SUBSTEPS)
        self.time_s += TICK_S
        self.user.look(self.view())
        self.track.xy.append(self.chair.middle())
        self.track.sticks.append(self.user.joystick)
        self.track.speed.append(self.chair.v)
        self.track.yaw_rate.append(self.chair.w)

    def goes_on(self, longest_s: float) -> bool:
        """Whether the user is on the way, and the time is not over."""
        return self.time_s < longest_s and not (self.user.arrived or self.user.gave_up)

    def run(self, longest_s: float) -> Track:
        """Until the user arrived, gave up, or the time is over."""
        while self.goes_on(longest_s):
            self.tick()
        return self.track


def polyline(*corners: tuple[float, float], step_m: float = 1.0) -> Route:
    """A route through corners with a point about every `step_m`."""
    points = [np.array(corners[0], float)]
    for a, b in pairwise(corners):
        n = max(1, round(math.dist(a, b) / step_m))
        points += [np.array(a) + (np.array(b) - np.array(a)) * i / n for i in range(1, n + 1)]
    xy = np.array(points)
    arc = np.r_[0.0, np.cumsum(np.hypot(*np.diff(xy, axis=0).T))]
    return Route(points_W_m=xy, arc_m=arc, edge_index=np.zeros(len(xy), np.int32))


def lateral(track: np.ndarray, route: Route) -> np.ndarray:
    """Distance (N,) of points from a route."""
    a, b = route.points_W_m[:-1], route.points_W_m[1:]
    along = b - a
    share = ((track[:, None] - a) * along).sum(-1) / (along**2).sum(-1)
    foot = a + np.clip(share, 0, 1)[..., None] * along
    return np.hypot(*np.moveaxis(track[:, None] - foot, -1, 0)).min(1)
