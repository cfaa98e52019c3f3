"""The seats of a world, each free or taken; in a taken one is a wheelchair with its user.

A seat also knows which of the others its cameras have shown lately, for a client that sees nothing
else.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from wcsim.bridge.ego.contact_ahead import find_plane, meets_edge
from wcsim.bridge.ego.crossing_watch import CrossingButton, CrossingWatch, OnRoad
from wcsim.bridge.ego.near_rows import near_rows
from wcsim.bridge.ego.randomization import DrawnChair, Randomization
from wcsim.bridge.ego.start_place import TakenNear, check_in_town, heading_rad, is_clear
from wcsim.bridge.ego.street_obstacles import ObstacleWatch
from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.bridge.reaction.commands import ROADWAY, ChairInStreet, GreenRequest
from wcsim.bridge.sumo.step_hook import HookChair
from wcsim.config import RunConfig, WorldConfig
from wcsim.core import seeding
from wcsim.core.boxes import Box
from wcsim.core.frames import sumo_from_yaw
from wcsim.errors import ProtocolError
from wcsim.physics.buffers import SeatBuffers
from wcsim.physics.engine import Engine
from wcsim.physics.renderer.instances import ChairPose, chair_pose
from wcsim.physics.sensors.base import Surroundings
from wcsim.physics.sensors.camera import CameraRig
from wcsim.physics.sensors.pixel_noise import child
from wcsim.physics.wheelchair.plant import plant_spec, refuse_cameras_inside
from wcsim.physics.wheelchair.rolling import Plane
from wcsim.physics.wheelchair.wheel_track import fell
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import NEAR
from wcsim.supervisor.oracle import CrashOracle
from wcsim.supervisor.rewards import describe_crash, find_crash_reason
from wcsim.towns.checks.validate import require_pavement
from wcsim.towns.scenario.town import Town, content_hash
from wcsim.towns.walking.routes import Router, edges_ahead
from wcsim.types import (
    F64,
    ActorKind,
    ActorState,
    ClientSnapshot,
    Events,
    Joystick,
    PlantState,
    Reading,
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
from wcsim.types.chair import AT_REST as AT_REST
from wcsim.users.profiles import UserProfile, sample_profile
from wcsim.users.user import FindUser, SimulatedUser, User

_GOAL_RANGE_M = (60.0, 400.0)
_SPAWN_TRIES = 400
_CLEAR_SPAWN_M = 2.0  # free around a chair when it appears
_LONGEST_ID = 60
_VISIBLE_PX = 16.0  # of 320x240, from which an actor counts as shown
_REMEMBERED_S = 1.0  # since it was shown

XY = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Start:
    """Where an episode starts; with a fixed start its user has exactly its profile."""

    p_W_m: F64  # (3,) on the ground
    yaw_rad: float
    route: Route


class Ego:
    """A wheelchair with its user; `World` calls its methods in the order of a tick."""

    def __init__(
        self,
        index: int,
        spec: SeatSpec,
        config: RunConfig,
        street: Street,
        router: Router,
        find_user: FindUser,
    ) -> None:
        """Nothing is in the world before `build`; ConfigError for a spec that cannot be used."""
        self.index = index
        self.spec = spec
        check_in_town(spec.start, router)
        self.person = find_user(spec.profile)
        self._config = config
        # Who gets what is near as rows sees no pictures; colours are for people, who may watch.
        self._drawn = not spec.near or any(camera.rgb for camera in config.cameras)
        self._street = street
        self._router = router
        self._variation = Randomization(config, index)
        self.chair: Wheelchair  # of this epoch: from `build` on
        self._rig: CameraRig
        self.user: User  # of this episode, as the rest: from `spawn` on
        self.route: Route
        self._start: _Start
        self._next_start: StartSpec | None = None  # of the next episode alone
        self.fitting: DrawnChair | None = None
        # Of the others towards this chair, when they were drawn.
        self.habits: AttentionModel | None = None
        self._waiting = deque[Joystick]()  # commands that the chair has not obeyed yet
        self._obstacles = ObstacleWatch(street.grid)
        self._crossing = CrossingWatch(street.grid, street.walk)
        self._seed = 0
        self._keys: dict[str, int] = {}  # of its sensors, by name
        self._episode = -1
        self.spawned = self._stands = False  # its chair has a place in the street; it stands there
        self._step = 0
        self._progress_m = self._progressed_m = 0.0
        self._shown: tuple[PlantState, ActorState] | None = None
        self._on_road = OnRoad()
        self._shown_actors = _ShownActors(config.world)
        self._button: CrossingButton  # of this route
        # The truth of the last tick that had one, as the others went on: `CrashOracle.reassess`.
        self.reassess: Callable[[Mapping[str, ActorState], float], F64]
        self.asks: GreenRequest | None = None  # of a light: its button has been pressed

    @cached_property
    def _oracle(self) -> CrashOracle:
        """Of this chair; most are asked for no truth."""
        chair, plant = self._config.chair, plant_spec(self._config.chair)
        wheels_m = np.column_stack([plant.stand_m(), plant.trails_m()])
        rims_m = np.array(plant.rims_m()).reshape(-1, 3)  # none of a high frame
        points, tick_s = action_set(self._config.env.lattice).points, self._config.world.tick_s
        return CrashOracle(
            self._street.grid, chair, plant.outline, wheels_m, rims_m, points, tick_s
        )

    @property
    def profile(self) -> UserProfile | None:
        """What its users are drawn of; None where a recording is replayed."""
        return self.person if isinstance(self.person, UserProfile) else None

    @property
    def plant(self) -> PlantState:
        """Where its chair is and how it moves; at rest until it has been put at its start."""
        plant = self.chair.state()
        if self._stands or not self.spawned:
            return plant
        start = self._start
        return replace(plant, p_WB_m=start.p_W_m, yaw_rad=start.yaw_rad, v_B_mps=np.zeros(3))

    @property
    def started(self) -> int:
        """How many episodes have started in this epoch, also those before the seat was taken."""
        return self._episode + 1

    def build(self, engine: Engine, rig: CameraRig, seed: int, started: int = 0) -> None:
        """Put a new wheelchair into an engine; `started` episodes of the epoch were others'."""
        self._seed = seed
        self._episode = started - 1
        self.spawned = self._stands = False
        self._rig = rig
        others = {"cameras": self._config.cameras, **self._config.sensors.on()}
        tick_s = self._config.world.tick_s
        self.chair = Wheelchair(
            engine, self._config.chair, self._config.imu, self.index, others, rig, tick_s
        )
        names = self.chair.sensors.names
        self._keys = {name: seeding.derive_rng_key(seed, name, self.index) for name in names}

    def spawn(self, taken: TakenNear, habits: AttentionModel) -> None:
        """Start the next episode: a clear place, where it has yet to `stand`, a user and a route.

        `habits` are those of the street.
        """
        # 1. The chair is what it is in this episode.
        delay = self._config.world.action_delay_ticks
        self.fitting = self._variation.fitting(self._seed, self._episode + 1)
        self.habits = None
        if self.fitting is not None:
            self.chair.become(self.fitting.spec, self.fitting.sensors)
            drawn = self.fitting.drawn.action_delay_ticks
            delay = delay if drawn is None else drawn
            self.habits = habits.towards(self.fitting.drawn)
        # Until the first command has come through, the stick is at rest.
        self._waiting = deque([AT_REST] * delay)
        # 2. A generator for each episode: its start does not depend on how much earlier ones drew.
        rng = seeding.make_rng(self._seed, "seat", self.index, self._episode + 1)
        fixed, self._next_start = self._next_start or self.spec.start, None
        if fixed is None:
            start = self._draw_start(rng, taken)
        else:
            start = self._start_at(fixed.p_W_m, fixed.yaw_rad, fixed.goal_W_m)
        self._episode += 1
        self.spawned, self._stands = True, False
        self._step = 0
        self._progress_m = 0.0
        self._start = start
        # 3. Its user. With a fixed start it has exactly its profile.
        exact = self.person
        if isinstance(exact, UserProfile):
            rng = seeding.make_rng(self._seed, "user", self.index, self._episode)
            profile = sample_profile(exact, rng) if self.spec.start is None else exact
            chair, outline = self._config.chair, self.chair.outline
            self.user = SimulatedUser(profile, rng, chair, outline, self._street)
        else:
            self.user = exact.user(self._episode, self.chair.outline)
        # 4. All that remembers anything starts anew.
        self._obstacles = ObstacleWatch(self._street.grid)
        self._crossing = CrossingWatch(self._street.grid, self._street.walk)
        self._shown_actors.forget()
        self._follow(start.route)

    def begin_next_at(self, start: StartSpec | None) -> None:
        """Let the next episode start there. Raises ConfigError for a start that cannot be."""
        check_in_town(start, self._router)
        self._next_start = start

    def start_facing(self, xy: XY, goal: XY, taken: TakenNear) -> StartSpec | None:
        """A start here that faces its way to the goal; None where others are in the way."""
        yaw_rad = heading_rad(self._router.route(xy, goal), 0.0, np.array(xy))
        # The chair leaves the place where it stands, so it is not in its own way.
        own, clear_m = chair_actor_id(self.index), _CLEAR_SPAWN_M

        def others(xy_W_m: F64, radius_m: float) -> list[ActorState]:
            return [actor for actor in taken(xy_W_m, radius_m) if actor.id != own]

        place = self._street.grid, self.chair.outline, np.array(xy), yaw_rad
        clear = is_clear(*place, clear_m, others)
        return StartSpec(p_W_m=xy, yaw_rad=yaw_rad, goal_W_m=goal) if clear else None

    def command(self, joystick: Joystick) -> None:
        """Take a command; the chair obeys it after the delay."""
        # In before out: with no delay the command of this tick is the one that is obeyed.
        self._waiting.append(joystick)
        self.chair.command(self._waiting.popleft())

    def meets_edge(self) -> bool:
        """Whether one of the chair's wheels is about to meet the edge of a kerb."""
        chair, tick_s = self.chair, self._config.world.tick_s
        return meets_edge(chair.state(), chair.wheels_m, self._street.grid, tick_s)

    def plane(self, reach: Box) -> Plane | None:
        """The plane that the chair can roll on without the engine, where that is all in reach."""
        plane = find_plane(self.plant, reach, self._street.grid)
        return plane if plane is not None and self.chair.can_roll(plane) else None

    def stand(self) -> None:
        """Put the chair at the start of this episode; its street has to be in the engine."""
        self._stands = True
        self.chair.place(self._start.p_W_m, self._start.yaw_rad)
        at = (self.index, "start", self._episode)
        keys = {name: seeding.derive_rng_key(self._seed, name, *at) for name in self._keys}
        self.chair.sensors.start(keys)

    def end_tick(self, tick: int) -> None:
        """Close the tick's measurements, with noise by seat, sensor and tick; move the hand."""
        self.chair.end_tick({name: child(key, tick) for name, key in self._keys.items()})
        world = self._config.world
        self.user.move_hand(world.finest_substeps, world.tick_s / world.finest_substeps)

    def look(
        self, time_s: float, others: tuple[ActorState, ...], signals: tuple[SignalState, ...]
    ) -> None:
        """Show the user the street, and see where in it the chair is."""
        self.user.look(self.view(time_s, others, signals))
        self._on_road = self._crossing.see(self.as_actor(), time_s, signals)
        arc_m = self.user.route_progress_m
        self.asks = self._button.see(arc_m, float(self.plant.v_B_mps[0]), time_s, signals)
        self._progressed_m = arc_m - self._progress_m
        self._progress_m = arc_m

    def next_destination(self) -> None:
        """After an arrival, or when the user gave up: the episode goes on to another place."""
        x, y, _ = self.chair.state().p_WB_m.tolist()
        # By step, as one episode may have several destinations.
        rng = seeding.make_rng(self._seed, "goal", self.index, self._episode, self._step)
        self._follow(self._router.route((x, y), self._draw_goal(rng, (x, y))))

    def surroundings(
        self,
        tick: int,
        actors: Sequence[ActorState],
        chairs: Sequence[ChairPose],
        signals: Sequence[SignalState],
        buffers: SeatBuffers | None = None,
    ) -> Surroundings:
        """What there is to see in this tick; the images are made in `buffers` if given."""
        return Surroundings(
            tick=tick,
            plant=self.chair.state(),
            actors=actors,
            chairs=chairs,
            signals=signals,
            buffers=buffers,
            drawn=self._drawn,
            counted=self.spec.truth_visible,
        )

    def observe(self, scene: Surroundings, others: Sequence[ActorState]) -> SensorFrame:
        """All sensors of this tick, and what is near where the seat has requested it."""
        frame = self.chair.sensors.observe(scene)
        if scene.counted:
            self._shown_actors.see(scene.tick, self._rig.shown_px(self.index))
        if not self.spec.near:
            return frame
        user, grid = self.user, self._street.grid
        way = self.route, user.route_progress_m
        rows = near_rows(self.chair.state(), user.joystick, *way, grid, others)
        return replace(frame, readings=(*frame.readings, Reading(name=NEAR, values=rows.ravel())))

    def events(self, jam_teleports: int, first: bool) -> Events:
        """What this tick did to the episode; the first frame of an episode has no events."""
        self._step += not first
        reason = crash = ""
        if not first:
            chair, street, config = self.chair, self._street, self._config.reward
            dropped = config.drop and fell(*chair.wheel_track(), street.grid)
            felt = chair.imu(), chair.state(), chair.contacts()
            reason = find_crash_reason(*felt, config, dropped=dropped)
        if reason:
            east_m, north_m, _ = chair.state().p_WB_m + street.net_origin_m
            (edge, *_) = edges_ahead(street.walk, self.route, self.user.route_progress_m)
            words = describe_crash(reason, chair.contacts(), config)
            place = f"x {east_m:.1f} y {north_m:.1f} in the net, edge {edge[:_LONGEST_ID]}"
            crash = f"{words}, at {place}"
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
            on_carriageway=self._on_road.on_carriageway,
            crossed=self._on_road.crossed,
            entered_red=self._on_road.entered_red,
            crash=crash,
            help_asked=not first and self.user.requests_help,
        )

    def truth(self, others: Sequence[ActorState]) -> Truth | None:
        """Danger, and when each action goes wrong, for a seat that has requested the truth."""
        if not (self.spec.truth or self.spec.truth_visible):
            return None
        plant, stick, waiting = self.chair.state(), self.user.joystick, tuple(self._waiting)
        known = self._shown_actors.known(others) if self.spec.truth_visible else None
        accel_mps2 = self.chair.drive_accel_mps2()
        seen = self._oracle.assess(plant, stick, others, waiting, known, accel_mps2)
        ids = frozenset(actor.id for actor in others)
        counted = others if known is None else known
        self.reassess = partial(self._oracle.reassess, plant, counted, ids, waiting, accel_mps2)
        return replace(seen, intent=self.user.intent, progress_m=self._progressed_m)

    def snapshot(
        self, tick: int, sensors: SensorFrame, events: Events, truth: Truth | None
    ) -> ClientSnapshot:
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
            drawn=None if self.fitting is None else self.fitting.drawn,
        )

    def pose(self) -> ChairPose:
        """Where the cameras see this chair."""
        return chair_pose(self.index, self.chair.state(), self.chair.outline)

    def as_actor(self) -> ActorState:
        """This chair as other users and the street see it, made once for each of its states."""
        plant = self.plant
        # By identity: the chair makes a new state whenever it has moved.
        if self._shown is not None and self._shown[0] is plant:
            return self._shown[1]
        outline, cos, sin = self.chair.outline, math.cos(plant.yaw_rad), math.sin(plant.yaw_rad)
        (x, y, z), (ahead_mps, left_mps, _) = plant.p_WB_m.tolist(), plant.v_B_mps.tolist()
        vx, vy = ahead_mps * cos - left_mps * sin, ahead_mps * sin + left_mps * cos
        actor = ActorState(
            id=chair_actor_id(self.index),
            kind=ActorKind.WHEELCHAIR,
            p_W_m=np.array([x + outline.middle_x_m * cos, y + outline.middle_x_m * sin, z]),
            yaw_rad=plant.yaw_rad,
            pitch_rad=plant.pitch_rad,
            v_W_mps=np.array([vx, vy, 0.0]),
            size_lwh_m=outline.size_lwh_m,
        )
        self._shown = plant, actor
        return actor

    def in_street(self) -> ChairInStreet:
        """This chair as drivers and people see it, with their habits towards it."""
        chair = self.as_actor()
        x, y, z = chair.p_W_m.tolist()
        return ChairInStreet(
            p_W_m=chair.p_W_m[:2],
            v_W_mps=chair.v_W_mps[:2],
            on_road=self._street.grid.class_here(x, y) in ROADWAY,
            yaw_rad=chair.yaw_rad,
            z_m=z,
            half_m=(0.5 * chair.size_lwh_m[0], 0.5 * chair.size_lwh_m[1]),
            habits=self.habits,
        )

    def for_hook(self) -> HookChair:
        """This chair as a user's step hook sees it."""
        plant, route, street = self.plant, self.route, self._street
        arc_m, (x, y, z) = self.user.route_progress_m, plant.p_WB_m.tolist()
        east_m, north_m, up_m = street.net_origin_m
        ahead = [(x, y), *route.points_W_m[route.arc_m > arc_m].tolist()]
        return HookChair(
            seat=self.index,
            p_net_m=(x + east_m, y + north_m, z + up_m),
            angle_deg=sumo_from_yaw(plant.yaw_rad),
            speed_mps=float(plant.v_B_mps[0]),
            way_net_m=tuple((px + east_m, py + north_m) for px, py in ahead),
            edges=edges_ahead(street.walk, route, arc_m),
            button_tls_id="" if self.asks is None else self.asks.tls_id,
        )

    def _follow(self, route: Route) -> None:
        self.route = route
        self.user.follow(route)
        half_m = 0.5 * self.chair.outline.length_m
        self._button = CrossingButton(route, self._street, half_m, self._config.world)
        self.asks = None
        self._progress_m = self.user.route_progress_m

    def view(
        self, time_s: float, others: tuple[ActorState, ...], signals: tuple[SignalState, ...]
    ) -> UserView:
        """What the user of this seat may know of the street now; it notices only who is near."""
        plant = self.chair.state()
        return UserView(
            time_s=time_s,
            p_W_m=plant.p_WB_m,
            yaw_rad=plant.yaw_rad,
            speed_mps=float(plant.v_B_mps[0]),
            route=self.route,
            actors=others,
            signals=signals,
            obstacles_W_m=self._obstacles.on_way(self.route, self.user.route_progress_m),
        )

    def _start_at(self, xy: XY, yaw_rad: float, goal: XY) -> _Start:
        p_W_m = np.array([*xy, float(self._street.grid.height_at(np.array(xy)))])
        return _Start(p_W_m=p_W_m, yaw_rad=yaw_rad, route=self._router.route(xy, goal))

    def _draw_start(self, rng: np.random.Generator, taken: TakenNear) -> _Start:
        """A start on flat walkable ground, `_CLEAR_SPAWN_M` from all that moves if possible."""
        clear_m = _CLEAR_SPAWN_M
        for attempt in range(1, _SPAWN_TRIES + 1):
            xy, yaw_rad = self._router.random_start(rng)
            place = self._street.grid, self.chair.outline, np.array(xy), yaw_rad
            if is_clear(*place, clear_m, taken):
                break
            # A crowded town gets a start in the end: a little less room after every hundred tries.
            clear_m *= 0.7 if attempt % 100 == 0 else 1.0
        return self._start_at(xy, yaw_rad, self._draw_goal(rng, xy))

    def _draw_goal(self, rng: np.random.Generator, xy: XY) -> XY:
        return self._router.random_goal(rng, xy, *_GOAL_RANGE_M, self._config.world.crossing_share)


class EgoSlots:
    """The places of a world; `present` holds the taken seats in the order of their numbers."""

    def __init__(
        self,
        specs: tuple[SeatSpec | None, ...],
        config: RunConfig,
        street: Street,
        town: Town,
        find_user: FindUser,
    ) -> None:
        """One place for each of `specs`, free where it is None.

        Raises:
            ConfigError: a camera is inside the chair's body, or a spec holds something that cannot
                be used.
            TownError: there are places, but the town has no pavement to drive on.
        """
        self.present: tuple[Ego, ...] = ()
        self._config, self._street, self._town, self._find_user = config, street, town, find_user
        self._started = [0] * len(specs)  # episodes of the epoch, by place
        self._seed = 0
        if specs:
            refuse_cameras_inside(config.cameras, plant_spec(config.chair))
            require_pavement(street, town)
            self._router = Router(street.walk)
            taken = [(number, spec) for number, spec in enumerate(specs) if spec is not None]
            self.present = tuple(self._seat(number, spec) for number, spec in taken)

    def at(self, number: int) -> Ego:
        """The seat of this number. Raises ProtocolError when it is free or not there."""
        self._check(number)
        seat = self._find(number)
        if seat is None:
            taken = [seat.index for seat in self.present]
            raise ProtocolError(f"seat {number} is free; expected one of {taken}")
        return seat

    def build(self, engine: Engine, rig: CameraRig, seed: int) -> None:
        """Start an epoch: a new wheelchair in a new engine for each seat that is taken."""
        self._seed = seed
        self._started = [0] * len(self._started)
        for seat in self.present:
            seat.build(engine, rig, seed)

    def admit(self, engine: Engine, rig: CameraRig, number: int, spec: SeatSpec) -> Ego:
        """Take a free seat; its chair is parked in the engine until its first episode starts.

        Raises:
            ProtocolError: the seat is taken or not there.
            ConfigError: the spec holds something that cannot be used.
        """
        self._check(number)
        if self._find(number) is not None:
            free = [place for place in range(len(self._started)) if self._find(place) is None]
            raise ProtocolError(
                f"seat {number} is taken; expected one of the free ones {free or '(none)'}"
            )
        seat = self._seat(number, spec)
        seat.build(engine, rig, self._seed, self._started[number])
        # Commands and snapshots are in the order of the seats.
        self.present = tuple(sorted((*self.present, seat), key=lambda item: item.index))
        return seat

    def dismiss(self, number: int) -> None:
        """Free a seat: its wheelchair leaves the engine. ProtocolError unless it is taken."""
        self._started[number] = self.at(number).started
        self.revoke(number)

    def revoke(self, number: int) -> None:
        """The same for a seat whose first episode could not start, which then does not count."""
        freed = self.at(number)
        self.present = tuple(seat for seat in self.present if seat is not freed)
        freed.chair.remove()
        for seat in self.present:
            # The next chair in this seat has the same id, and no part in who touched whom before.
            seat.chair.forget(chair_actor_id(number))

    def _seat(self, number: int, spec: SeatSpec) -> Ego:
        ego = Ego(number, spec, self._config, self._street, self._router, self._find_user)
        if not isinstance(ego.person, UserProfile):
            ego.person.require_driven_here(self._town.name, lambda: content_hash(self._town))
        return ego

    def _find(self, number: int) -> Ego | None:
        return next((seat for seat in self.present if seat.index == number), None)

    def _check(self, number: int) -> None:
        if not 0 <= number < len(self._started):
            raise ProtocolError(
                f"there is no seat {number}; expected 0 or more and less than {len(self._started)}"
            )


class _ShownActors:
    """The actors that the cameras of one seat have shown, with the last tick of each."""

    def __init__(self, world: WorldConfig) -> None:
        """`world` says how long a tick is."""
        self._ticks = round(_REMEMBERED_S / world.tick_s)
        self._last: dict[str, int] = {}

    def forget(self) -> None:
        """Forget everybody: another episode starts."""
        self._last.clear()

    def see(self, tick: int, shown_px: Mapping[str, float]) -> None:
        """Take what the cameras show in this tick: pixels by actor, as in a picture of 320x240."""
        seen = {name: tick for name, pixels in shown_px.items() if pixels >= _VISIBLE_PX}
        recent = {name: last for name, last in self._last.items() if tick - last <= self._ticks}
        # What is seen now comes last, as it replaces an older tick.
        self._last = {**recent, **seen}

    def known(self, actors: Sequence[ActorState]) -> tuple[ActorState, ...]:
        """Those of the actors that were shown lately enough, where they are now."""
        return tuple(actor for actor in actors if actor.whole_id in self._last)
