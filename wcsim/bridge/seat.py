"""One seat of a world: a wheelchair, its user, its episode. A world holds any number of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wcsim import seeding
from wcsim.bridge.sight import ObstacleWatch
from wcsim.config import RunConfig
from wcsim.physics.camera import CameraRig
from wcsim.physics.chair import Wheelchair
from wcsim.physics.engine import Engine
from wcsim.physics.renderer.instances import ChairPose, chair_pose
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.oracle import Oracle
from wcsim.supervisor.profiles import profile, sample
from wcsim.supervisor.rewards import crash_reason
from wcsim.supervisor.user import SimulatedUser
from wcsim.towns.routes import Router
from wcsim.types import (
    F64,
    ActorKind,
    ActorState,
    ClientSnapshot,
    Events,
    Ground,
    Route,
    SeatSpec,
    SensorFrame,
    SignalState,
    StartSpec,
    Street,
    Truth,
    UserView,
    chair_actor_id,
)

CHAIR_SIZE_LWH_M = (1.10, 0.62, 1.25)
CHAIR_MIDDLE_M = 0.23  # from the drive axle forward to the middle of the chair's length
FOOTPRINT_B_M = np.array([(x, y) for x in (-0.34, 0.23, 0.80) for y in (-0.31, 0.0, 0.31)])
SIGHT_M = 25.0
GOAL_RANGE_M = (60.0, 400.0)
SPAWN_TRIES = 400

XY = tuple[float, float]
TakenNear = Callable[[F64, float], Sequence[ActorState]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where an episode begins; a seat with a fixed start keeps its user's exact parameters too."""

    p_W_m: F64  # (3,) on the ground
    yaw_rad: float
    route: Route


class Seat:
    """A wheelchair with its user; `World` calls its methods in the order of a tick."""

    def __init__(self, index: int, spec: SeatSpec, config: RunConfig, street: Street, router: Router) -> None:
        self.index = index
        self.spec = spec
        self._config = config
        self._street = street
        self._router = router
        self._oracle = Oracle(street.grid, config.chair, action_set(config.env.actions).points)
        self._seed = 0
        self._episode = -1
        self._step = 0
        self._progress_m = self._progressed_m = 0.0

    @property
    def spawned(self) -> bool:
        """Whether this seat's chair stands in the street."""
        return self._episode >= 0

    def build(self, engine: Engine, seed: int) -> None:
        """Put a new wheelchair into a new engine; the old one has gone with its engine."""
        self._seed = seed
        self._episode = -1
        self.chair = Wheelchair(engine, self._config.chair, self._config.imu, self.index)

    def spawn(self, taken: TakenNear) -> None:
        """Begin the next episode: a start clear of everything, a user and a route of its own."""
        rng = seeding.generator(self._seed, "seat", self.index, self._episode + 1)
        start = self._draw_start(rng, taken) if self.spec.start is None else self._fixed_start(self.spec.start)
        self._episode += 1
        self._step = 0
        self._progress_m = 0.0
        self._place = start
        self.stand()
        self.user = self._new_user()
        self._obstacles = ObstacleWatch(self._street.grid)
        self._follow(start.route)

    def stand(self) -> None:
        """Put the chair at the start of this episode; where the street was not there yet, once more when it is."""
        self.chair.place(self._place.p_W_m, self._place.yaw_rad)

    def after_substep(self, dt_s: float) -> None:
        """IMU sample, contacts, the user's hand."""
        self.chair.after_step()
        self.user.hand(dt_s)

    def end_tick(self, tick: int) -> None:
        """Close the tick's measurements; noise is keyed by seat, sensor and tick, not drawn in sequence."""
        self.chair.end_tick(seeding.generator(self._seed, "imu", self.index, tick))

    def look(self, time_s: float, others: tuple[ActorState, ...], signals: tuple[SignalState, ...]) -> None:
        """Show the user the street."""
        self.user.look(self._view(time_s, others, signals))
        self._progressed_m = self.user.route_progress_m - self._progress_m
        self._progress_m = self.user.route_progress_m

    def next_destination(self) -> None:
        """After an arrival, or when the user gave up: the episode goes on to another place."""
        x, y, _ = self.chair.state().p_WB_m.tolist()
        rng = seeding.generator(self._seed, "goal", self.index, self._episode, self._step)
        self._follow(self._router.route((x, y), self._router.random_goal(rng, (x, y), *GOAL_RANGE_M)))

    def observe(
        self,
        tick: int,
        rig: CameraRig,
        actors: Sequence[ActorState],
        chairs: Sequence[ChairPose],
        signals: Sequence[SignalState],
    ) -> SensorFrame:
        """Cameras and IMU of this tick."""
        cameras = rig.shoot(self.index, tick, self.chair.state(), actors, chairs, signals=signals)
        return SensorFrame(tick=tick, cameras=cameras, imu=self.chair.imu())

    def events(self, jam_teleports: int, first: bool) -> Events:
        """What this tick did to the episode; the first frame of an episode has no events."""
        self._step += not first
        reason = "" if first else crash_reason(self.chair.imu(), self.chair.contacts(), self._config.reward)
        return Events(
            episode=self._episode,
            step=self._step,
            crashed=bool(reason),
            crash_reason=reason,
            truncated=not first and not reason and self._step >= self.spec.max_steps,
            arrived=not first and self.user.arrived,
            gave_up=not first and self.user.gave_up,
            progress_m=0.0 if first else self._progressed_m,
            jam_teleports=jam_teleports,
        )

    def truth(self, others: Sequence[ActorState]) -> Truth | None:
        """Danger and safe actions on the true geometry, when the seat asked for them."""
        if not self.spec.truth:
            return None
        plant = self.chair.state()
        seen = self._oracle.assess(plant, self.user.joystick, others)
        return Truth(
            intent=self.user.intent,
            danger=seen.danger,
            safe_actions=seen.safe_actions,
            clearance_m=seen.clearance_m,
            progress_m=self._progressed_m,
        )

    def snapshot(self, tick: int, sensors: SensorFrame, events: Events, truth: Truth | None) -> ClientSnapshot:
        """This seat's share of the world's snapshot."""
        return ClientSnapshot(
            seat=self.index,
            tick=tick,
            plant=self.chair.state(),
            sensors=sensors,
            user=self.user.joystick,
            contacts=self.chair.contacts(),
            events=events,
            truth=truth,
        )

    def pose(self) -> ChairPose:
        """Where the cameras see this chair."""
        return chair_pose(self.index, self.chair.state())

    def as_actor(self) -> ActorState:
        """This chair as other users and the street see it."""
        plant = self.chair.state()
        ahead = np.array([math.cos(plant.yaw_rad), math.sin(plant.yaw_rad), 0.0])
        left = np.array([-ahead[1], ahead[0], 0.0])
        return ActorState(
            id=chair_actor_id(self.index),
            kind=ActorKind.WHEELCHAIR,
            p_W_m=plant.p_WB_m + CHAIR_MIDDLE_M * ahead,
            yaw_rad=plant.yaw_rad,
            pitch_rad=plant.pitch_rad,
            v_W_mps=plant.v_B_mps[0] * ahead + plant.v_B_mps[1] * left,
            size_lwh_m=CHAIR_SIZE_LWH_M,
        )

    def _new_user(self) -> SimulatedUser:
        rng = seeding.generator(self._seed, "user", self.index, self._episode)
        exact = profile(self.spec.profile)
        world, chair = self._config.world, self._config.chair
        return SimulatedUser(
            sample(exact, rng) if self.spec.start is None else exact,
            rng,
            chair.v_max_mps,
            chair.yaw_rate_max_radps,
            world.tick_s / world.substeps,
            self._street,
        )

    def _follow(self, route: Route) -> None:
        self.route = route
        self.user.follow(route)
        self._progress_m = self.user.route_progress_m

    def _view(self, time_s: float, others: tuple[ActorState, ...], signals: tuple[SignalState, ...]) -> UserView:
        plant = self.chair.state()
        here = plant.p_WB_m[:2]
        return UserView(
            time_s=time_s,
            p_W_m=plant.p_WB_m,
            yaw_rad=plant.yaw_rad,
            speed_mps=float(plant.v_B_mps[0]),
            route=self.route,
            actors=tuple(a for a in others if float(((a.p_W_m[:2] - here) ** 2).sum()) < SIGHT_M**2),
            signals=signals,
            obstacles_W_m=self._obstacles.on_way(self.route, self.user.route_progress_m),
        )

    def _fixed_start(self, spec: StartSpec) -> Start:
        return self._start(spec.p_W_m, spec.yaw_rad, spec.goal_W_m)

    def _start(self, xy: XY, yaw_rad: float, goal: XY) -> Start:
        p_W_m = np.array([*xy, float(self._street.grid.height_at(np.array(xy)))])
        return Start(p_W_m=p_W_m, yaw_rad=yaw_rad, route=self._router.route(xy, goal))

    def _draw_start(self, rng: np.random.Generator, taken: TakenNear) -> Start:
        """A start on flat walkable ground, `clear_spawn_m` from everything that moves; relaxed when nothing is free."""
        clear_m = self._config.world.clear_spawn_m
        for attempt in range(1, SPAWN_TRIES + 1):
            xy, yaw_rad = self._router.random_start(rng)
            if is_clear(self._street.grid, np.array(xy), yaw_rad, clear_m, taken):
                break
            clear_m *= 0.7 if attempt % 100 == 0 else 1.0
        return self._start(xy, yaw_rad, self._router.random_goal(rng, xy, *GOAL_RANGE_M))


def is_clear(grid: Ground, xy_W_m: F64, yaw_rad: float, clear_m: float, taken: TakenNear) -> bool:
    """Whether a chair can start there: level ground, nothing solid within 0.2 m of its hull, nobody within clear_m."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    hull = xy_W_m + FOOTPRINT_B_M @ np.array([[cos, sin], [-sin, cos]])
    if float(np.ptp(grid.raised_at(hull))) > 0.011 or float(grid.clearance_at(hull).min()) < 0.2:
        return False
    middle = xy_W_m + CHAIR_MIDDLE_M * np.array([cos, sin])
    reach_m = clear_m + 0.5 * CHAIR_SIZE_LWH_M[0]
    return all(
        float(np.hypot(*(a.p_W_m[:2] - middle))) > reach_m + 0.5 * max(a.size_lwh_m[:2])
        for a in taken(middle, reach_m + 10.0)
    )
