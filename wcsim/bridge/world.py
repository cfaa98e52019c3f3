"""One world: SUMO moves the city, PyBullet the wheelchairs; `World.tick` holds them together.

Time: tick n -> n + 1 is one SUMO step and `substeps` Bullet steps. SUMO plans against the chairs of
tick n (it sees them one tick late); bodies, sensors and pictures all show tick n + 1.

A world also brings the street near the wheelchairs into memory: tiles for engine and pictures.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np

from wcsim.bridge import mirror
from wcsim.bridge.ego.contact_ahead import meets_body
from wcsim.bridge.ego.ego import XY, Ego, EgoSlots
from wcsim.bridge.epoch import Epoch
from wcsim.bridge.stage_timer import Stopwatch
from wcsim.bridge.sumo.actors import moved
from wcsim.bridge.sumo.session import (
    open_session,
    refuse_second_world,
    sumo_seed,
)
from wcsim.config import RunConfig
from wcsim.core.boxes import box_from_actor, boxes_touch
from wcsim.core.closing import ClosingContextBase
from wcsim.core.frames import forward_vector
from wcsim.errors import ProtocolError
from wcsim.physics.buffers import ImageSink
from wcsim.physics.engine import StreetBodies
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.sensors.base import Surroundings
from wcsim.physics.sensors.camera import CameraRig
from wcsim.physics.wheelchair.drive_controller import stopping_distance_m
from wcsim.physics.wheelchair.rolling import Plane
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.scenario.town import Town
from wcsim.towns.street import load_street
from wcsim.types import (
    F64,
    ActorState,
    ClientSnapshot,
    Command,
    SeatSpec,
    Snapshot,
    StartSpec,
    TileKey,
    UserView,
)
from wcsim.types.episode import RunPlace
from wcsim.types.street import StreetTiles, join_meshes
from wcsim.users.profiles import find_profile
from wcsim.users.user import FindUser

_ENGINE_REACH_M = 10.0  # the street so far around a chair is in the engine
_SIGHT_MORE_M = 30.0  # and so far beyond its cameras' range in sight
_TILE_MORE_M = 100.0  # and so much more is loaded whenever the pictures need another part
# In the engine: a body costs a step 0.05 us wherever it is, so these cost a tenth of a chair.
MOST_TILES = 64
ENGINE_STAY_M = 250.0  # but what is so near a chair stays
_MOST_STORES = 512  # tiles that are ready to be drawn, 0.1 MB each
_ASIDE_M = 0.3  # around what a chair may reach
_MOVED_M = 1.0  # who has moved less since tiles were looked for needs no others


class World(ClosingContextBase):
    """A town with traffic and wheelchairs that come and go between ticks.

    Images are written into `out` where it is given.
    """

    def __init__(
        self,
        town: Town,
        config: RunConfig,
        specs: tuple[SeatSpec | None, ...],
        seed: int,
        place: RunPlace = RunPlace(),  # noqa: B008 - frozen
        *,
        epoch: int = 0,
        report: Callable[[str], object] | None = None,
        find_user: FindUser = find_profile,
    ) -> None:
        """Load the town and warm its traffic up.

        Args:
            town: The town.
            config: Of the world and its chairs.
            specs: One for each seat; None where it is free.
            seed: Of all chance.
            place: Where the outputs of the SUMO scenario go.
            epoch: The number of the first epoch.
            report: Gets how far the street is, as `load_street` reports it.
            find_user: Takes the names of users; without it those of profiles.

        Raises:
            TownError: The net cannot be used.
            ConfigError: A camera is inside the chair's body.
            WorldInUseError: Another world lives in this process.
        """
        refuse_second_world()
        validate_net(town.net, border=town.border)
        self.town = town
        self.config = config
        self.street = load_street(town, report)
        self._seating = EgoSlots(specs, config, self.street, town, find_user)
        self.stopwatch = Stopwatch()
        self.epoch = epoch - 1
        self._epoch: Epoch | None = None
        self._tick = 0
        self._bodied: tuple[ActorState, ...] = ()  # who has a body in the engine in this tick
        self._planes: dict[int, Plane] = {}  # by seat, of the chairs that roll in this tick
        self._blind = False
        self._held = ExitStack()
        try:
            cameras, world = config.cameras, config.world
            seats, heads = max(1, len(specs)), self.street.signal_heads
            rig = CameraRig(
                join_meshes(()), cameras, seats, heads, world.draw_threads, world.tick_s
            )
            self._rig = self._held.enter_context(rig)
            range_m = max(camera.range_m for camera in cameras)
            self._loader = _TileLoader(self.street.tiles, rig, range_m)
            net_z_m = self.street.net_origin_m[2]
            self.scenario, self.sumo = open_session(town, config, seed, place, net_z_m, self._held)
            self.snapshot = self._begin(seed)
        except BaseException:
            self.close()
            raise

    @property
    def seats(self) -> tuple[Ego, ...]:
        """The seats that are taken, in the order of their numbers."""
        return self._seating.present

    def tick(self, commands: Sequence[Command], out: ImageSink | None = None) -> Snapshot:
        """Carry the world from tick n to n + 1.

        `commands` are of tick n: one for every taken seat, in seat order. Raises ProtocolError for
        others.
        """
        self._react(commands)
        self._step()
        self._mirror()
        self._drive(commands)
        return self._sense(out)

    def rebuild(self, seed: int, out: ImageSink | None = None) -> Snapshot:
        """A new epoch: everything as in a new world with this seed and these chairs."""
        self.sumo.rebuild(sumo_seed(seed))
        self.snapshot = self._begin(seed, out)
        return self.snapshot

    def respawn(
        self, seat: int, out: ImageSink | None = None, start: StartSpec | None = None
    ) -> ClientSnapshot:
        """Put one seat's chair at the start of its next episode, now.

        Costs no tick and stops nobody. The start is the seat's own, or `start` for this episode.

        Raises:
            ProtocolError: The seat is free or not there.
            ConfigError: The start cannot be.
        """
        ego = self._seating.at(seat)
        ego.begin_next_at(start)
        return self._joined(ego, out)

    def start_facing(self, seat: int, places_W_m: Sequence[XY], goal_W_m: XY) -> StartSpec | None:
        """The first clear place, as a start that faces its way to the goal; None without one.

        Raises:
            ProtocolError: The seat is free or not there.
        """
        ego = self._seating.at(seat)
        starts = (ego.start_facing(xy, goal_W_m, self._taken) for xy in places_W_m)
        return next((start for start in starts if start is not None), None)

    def admit(self, seat: int, spec: SeatSpec, out: ImageSink | None = None) -> ClientSnapshot:
        """Put a new chair into the street for a free seat, now.

        Its episodes go on from those the seat has had. If it raises, nothing has changed.

        Raises:
            ProtocolError: The seat is taken or not there.
            ConfigError: The spec holds something that cannot be used.
        """
        new = self._seating.admit(self._open.engine, self._rig, seat, spec)
        traffic = self._open.traffic
        actors, signals = traffic.actors, traffic.signals
        try:
            return self._joined(new, out)
        except BaseException:
            self._seating.revoke(seat)
            traffic.actors, traffic.signals = actors, signals
            raise

    def dismiss(self, seat: int) -> None:
        """Take a seat's chair out of the street. ProtocolError when the seat is not taken."""
        self._seating.dismiss(seat)
        # Its last images may be in somebody's buffers.
        self._rig.reset(seat)
        self._open.traffic.look_again(self._places())
        self.snapshot = self._published(tuple(c for c in self.snapshot.clients if c.seat != seat))

    def put_chair(self, seat: int, xy_W_m: F64, yaw_rad: float) -> None:
        """Put one seat's chair on the ground of another place, at rest; its episode goes on."""
        p_W_m = np.array([*xy_W_m[:2], float(self.street.grid.height_at(xy_W_m))])
        moved, places_W_m = self._seating.at(seat), self._places()
        places_W_m[self.seats.index(moved)] = p_W_m[:2]
        # The ground first: a chair that is put where no tile lies falls.
        self._load_tiles(places_W_m)
        moved.chair.place(p_W_m, yaw_rad)
        self._open.traffic.look_again(self._places())

    def view_of(self, seat: int) -> UserView:
        """What the user of a seat may know now. ProtocolError when the seat is not taken."""
        ego = self._seating.at(seat)
        return ego.view(self.sumo.time_s(), self._others(ego), self._open.traffic.signals)

    def go_blind(self) -> None:
        """Draw no pictures from now on and give no truth: for a street where only users drive."""
        self._blind = True
        self._rig.freeze_pictures()

    def drop_step_limits(self) -> None:
        """Let no episode end by its steps any more: to see how a street goes on."""
        for seat in self.seats:
            seat.spec = replace(seat.spec, max_steps=1 << 30)

    def close(self) -> None:
        """End both simulators; a second call does nothing."""
        self._held.close()
        if self._epoch is not None:
            self._epoch.engine.close()
            self._epoch = None

    def _react(self, commands: Sequence[Command]) -> None:
        """The street sees the chairs of tick n: drivers brake, people stop, lights react."""
        received = [(c.seat, c.tick) for c in commands]
        # Commands for another tick are refused before anything has moved.
        if received != [(seat.index, self._tick) for seat in self.seats]:
            raise ProtocolError(
                f"commands (seat, tick) {received} do not fit tick {self._tick}; "
                "expected one a seat"
            )
        with self.stopwatch.measure("react"):
            self._open.traffic.react(tuple(seat.in_street() for seat in self.seats))
            self.sumo.buttons.request([seat.asks for seat in self.seats if seat.asks is not None])

    def _step(self) -> None:
        """SUMO moves the city to tick n + 1."""
        with self.stopwatch.measure("sumo"):
            self.sumo.step(lambda: tuple(seat.for_hook() for seat in self.seats))

    def _mirror(self) -> None:
        """The engine gets bodies for the actors in reach of a chair, and the street around it."""
        traffic, places_W_m = self._open.traffic, self._places()
        with self.stopwatch.measure("read"):
            near = traffic.read(places_W_m)
        with self.stopwatch.measure("mirror"):
            traffic.move(near, places_W_m)
            tick_s = self.config.world.tick_s
            self._bodied = mirror.in_reach(traffic.actors, places_W_m, tick_s)
            if self.config.world.rolling:
                self._planes = self._find_planes()
                for seat in self._engine_seats():
                    seat.chair.stop_rolling()
                driven = [seat.plant.p_WB_m[:2] for seat in self._engine_seats()]
                self._bodied = mirror.in_reach(self._bodied, np.reshape(driven, (-1, 2)), tick_s)
            self._choose_step()
            self._open.bodies.place(mirror.moves(traffic.before, self._bodied, tick_s))
        self._load_tiles(places_W_m)

    def _drive(self, commands: Sequence[Command]) -> None:
        """The chairs are driven, substep by substep."""
        engine = self._open.engine
        with self.stopwatch.measure("physics"):
            for seat, command in zip(self.seats, commands, strict=True):
                seat.command(command.joystick)
            # All chairs before each step and all after it: none depends on another's same step.
            steps = round(self.config.world.tick_s / engine.step_s)
            for seat in self.seats:
                plane = self._planes.get(seat.index)
                if plane is not None:
                    seat.chair.roll(seat.chair.rolled(plane, steps))
            driven = self._engine_seats()
            for _ in range(steps if driven else 0):
                for seat in driven:
                    seat.chair.before_step()
                engine.step()
                for seat in driven:
                    seat.chair.after_step()

    def _sense(self, out: ImageSink | None) -> Snapshot:
        """Measure tick n + 1, have users look and move their hands, and start new episodes."""
        # 1. The bodies have to be where the actors are.
        self._check_mirror()
        self._tick += 1
        for seat in self.seats:
            seat.end_tick(self._tick)
        # 2. Users look while the pictures are drawn: neither changes what the other one sees.
        scenes = self._shoot(self.seats, out, first=False, meanwhile=self._users_look)
        clients = []
        for seat in self.seats:
            client = self._seen(seat, scenes[seat.index], first=False)
            if client.events.arrived or client.events.gave_up:
                seat.next_destination()
            clients.append(client)
        # 3. New episodes are last: what ends an episode is seen in the street as it was then.
        over = {c.seat for c in clients if c.events.crashed or c.events.truncated}
        ended = tuple(seat for seat in self.seats if seat.index in over)
        first = {client.seat: client for client in self._open_episodes(ended, out)}
        self.snapshot = self._published(tuple(replace(c, first=first.get(c.seat)) for c in clients))
        return self.snapshot

    def _find_planes(self) -> dict[int, Plane]:
        """What chairs stand on that need no engine in this tick: nothing is in reach of them."""
        traffic, tick_s = self._open.traffic, self.config.world.tick_s
        limits = self.config.chair
        way_m = limits.v_max_mps * tick_s
        way_m += stopping_distance_m(limits.v_max_mps, limits.decel_mps2, limits.jerk_mps3)
        reaches = [_reach(seat, way_m) for seat in self.seats]
        boxes = [box_from_actor(reach) for reach in reaches]
        planes = {}
        for seat, reach, box in zip(self.seats, reaches, boxes, strict=True):
            if any(boxes_touch(*box, *other) for other in boxes if other is not box):
                continue
            plane = seat.plane(box)
            if plane and not meets_body([reach], traffic.before, self._bodied, tick_s):
                planes[seat.index] = plane
        return planes

    def _engine_seats(self) -> list[Ego]:
        """The seats whose chairs are in the engine in this tick."""
        return [seat for seat in self.seats if seat.index not in self._planes]

    def _choose_step(self) -> None:
        """Set fine physics steps for a tick in which a wheel meets a kerb, or somebody a chair."""
        world, engine, traffic = self.config.world, self._open.engine, self._open.traffic
        seats = self._engine_seats()
        chairs = [seat.as_actor() for seat in seats]
        fine = any(seat.meets_edge() for seat in seats)
        fine = fine or meets_body(chairs, traffic.before, self._bodied, world.tick_s)
        step_s = world.tick_s / (world.finest_substeps if fine else world.usual_substeps)
        if step_s != engine.step_s:
            engine.set_step(step_s)
            for seat in self._seating.present:
                seat.chair.follow_step()

    def _begin(self, seed: int, out: ImageSink | None = None) -> Snapshot:
        """Warm the traffic up, build an engine for this epoch, and put every chair at a start."""
        self.epoch += 1
        self._tick = 0
        if self._epoch is not None:
            self._epoch.engine.close()
        self._planes = {}
        self._epoch = Epoch(self.config, self.street.grid, self.sumo, seed)
        self._rig.begin(seed)
        self._seating.build(self._epoch.engine, self._rig, seed)
        return self._published(self._open_episodes(self.seats, out))

    def _joined(self, seat: Ego, out: ImageSink | None) -> ClientSnapshot:
        """Start a seat's next episode and show it in the snapshot of now."""
        (client,) = self._open_episodes((seat,), out)
        others = [c for c in self.snapshot.clients if c.seat != seat.index]
        self.snapshot = self._published(tuple(sorted((*others, client), key=lambda c: c.seat)))
        return client

    def _open_episodes(
        self, seats: Sequence[Ego], out: ImageSink | None
    ) -> tuple[ClientSnapshot, ...]:
        """Start the next episode of these seats; all stand before any of them looks around."""
        for seat in seats:
            seat.spawn(self._taken, self._open.attention)
            if seat.fitting is not None:
                self._rig.mount(seat.index, seat.fitting.cameras, seat.fitting.drawn.light or 1.0)
        if seats:
            self._load_tiles(self._places())
        for seat in seats:
            seat.stand()
        if seats:
            self._open.traffic.look_again(self._places())
        self._look_around(seats)
        scenes = self._shoot(seats, out, first=True)
        return tuple(self._seen(seat, scenes[seat.index], first=True) for seat in seats)

    def _users_look(self) -> None:
        """All users see what is around now."""
        with self.stopwatch.measure("user"):
            self._look_around(self.seats)

    def _shoot(
        self,
        seats: Sequence[Ego],
        out: ImageSink | None,
        first: bool,
        meanwhile: Callable[[], object] | None = None,
    ) -> dict[int, Surroundings]:
        """Take the pictures of all these seats together; returns what each sees, by seat."""
        if not seats:
            return {}
        traffic = self._open.traffic
        with self.stopwatch.measure("render"):
            # A single chair is in nobody's picture, as its own cameras never show it.
            poses = tuple(seat.pose() for seat in self.seats) if len(self.seats) > 1 else ()
            scenes = {}
            for seat in seats:
                buffers = None if out is None else out.buffers(seat.index, first)
                seen = traffic.actors, poses, traffic.signals
                scenes[seat.index] = seat.surroundings(self._tick, *seen, buffers)
            drawn = {seat: scene for seat, scene in scenes.items() if scene.drawn}
            self._rig.shoot_all(drawn, meanwhile)
        return scenes

    def _seen(self, seat: Ego, scene: Surroundings, first: bool) -> ClientSnapshot:
        with self.stopwatch.measure("render"):
            sensors = seat.observe(scene, self._others(seat) if seat.spec.near else ())
        with self.stopwatch.measure("truth"):
            requested = not self._blind and (seat.spec.truth or seat.spec.truth_visible)
            truth = seat.truth(self._others(seat)) if requested else None
        return seat.snapshot(self._tick, sensors, seat.events(self.sumo.teleports, first), truth)

    def _look_around(self, seats: Sequence[Ego]) -> None:
        """The users of these seats see what is around now: those whom they could notice."""
        if not seats:
            return
        actors, places_W_m = self._open.traffic.actors, self._places()
        everyone = (*actors, *(seat.as_actor() for seat in self.seats))
        at_W_m = np.concatenate([actor.p_W_m for actor in everyone]).reshape(-1, 3)[:, :2]
        long_m = np.array([actor.size_lwh_m[0] for actor in everyone])
        for number, seat in enumerate(self.seats):
            if seat not in seats:
                continue
            away_m = np.hypot(*(at_W_m - places_W_m[number]).T)
            seen = np.flatnonzero(away_m < seat.user.sight_m + long_m).tolist()
            others = tuple(everyone[k] for k in seen if k != len(actors) + number)
            seat.look(self.sumo.time_s(), others, self._open.traffic.signals)

    def _check_mirror(self) -> None:
        """Raises PhysicsError when the bodies are not where the actors are."""
        with self.stopwatch.measure("mirror"):
            self._open.check.check(self._bodied)

    def _load_tiles(self, places_W_m: F64) -> None:
        self._loader.load(places_W_m, self._open.street, self.stopwatch)

    def _places(self) -> F64:
        """Where the chairs are, (n, 2)."""
        return np.array([seat.plant.p_WB_m[:2] for seat in self.seats]).reshape(-1, 2)

    def _others(self, seat: Ego) -> tuple[ActorState, ...]:
        """Everything that moves around a seat, the other wheelchairs among it."""
        chairs = [other.as_actor() for other in self.seats if other is not seat]
        return self._open.traffic.actors + tuple(chairs)

    def _taken(self, xy_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """What stands or moves near a place that may become a start."""
        chairs = tuple(seat.as_actor() for seat in self.seats if seat.spawned)
        return self.sumo.actors_at(xy_W_m[None, :2], radius_m) + chairs

    def _published(self, clients: tuple[ClientSnapshot, ...]) -> Snapshot:
        bare = Snapshot(
            epoch=self.epoch,
            tick=self._tick,
            time_s=self.sumo.time_s(),
            actors=self._open.traffic.actors,
            signals=self._open.traffic.signals,
            clients=clients,
        )
        # Put in last, as the hash is taken of all the rest.
        return replace(bare, state_hash=bare.digest())

    @property
    def _open(self) -> Epoch:
        if self._epoch is None:
            raise ProtocolError("this world is closed; make a new one")
        return self._epoch


def _reach(seat: Ego, way_m: float) -> ActorState:
    """The ground that a chair may come to within `way_m`, as an actor that stands there."""
    chair, ahead_mps = seat.as_actor(), float(seat.plant.v_B_mps[0])
    length_m, width_m, height_m = chair.size_lwh_m
    # Ahead, or back, as it moves now.
    shift_m = math.copysign(0.5 * way_m, ahead_mps) * forward_vector(chair.yaw_rad, 0.0)
    size_lwh_m = length_m + way_m + 2.0 * _ASIDE_M, width_m + 2.0 * _ASIDE_M, height_m
    return replace(chair, p_W_m=chair.p_W_m + shift_m, v_W_mps=np.zeros(3), size_lwh_m=size_lwh_m)


class _TileLoader:
    """Knows which tiles the cameras have; what an engine has, the caller says."""

    def __init__(self, tiles: StreetTiles, rig: CameraRig, range_m: float) -> None:
        """Nothing is loaded yet; cameras see `range_m` far."""
        self._tiles, self._rig = tiles, rig
        self._sight_m = range_m + _SIGHT_MORE_M
        # For which engine and from where, the last time.
        self._looked: tuple[StreetBodies, F64] | None = None
        self._drawn: tuple[TileKey, ...] = ()
        self._stores: dict[TileKey, GeometryStore] = {}

    def load(self, places_W_m: F64, laid: StreetBodies, stopwatch: Stopwatch) -> None:
        """Have the street around these places (n, 2) there; `laid` are the tiles in the engine.

        Which tiles are there depends on where the chairs were, and on nothing else. The time that
        loading takes is measured as "street".
        """
        last = self._looked
        if last is not None and last[0] is laid and not moved(places_W_m, last[1], _MOVED_M):
            return
        self._looked = laid, places_W_m
        close = self._tiles.near(places_W_m, _ENGINE_REACH_M)
        under = [key for key in close if key not in laid.keys]
        drawn = set(self._drawn) >= set(self._tiles.near(places_W_m, self._sight_m))
        if drawn and not under:
            return
        with stopwatch.measure("street"):
            for key in under:
                laid.lay(key, partial(self._tiles.mesh, key))
            if len(laid.keys) > MOST_TILES:
                far = laid.keys.difference(self._tiles.near(places_W_m, ENGINE_STAY_M))
                # Sorted: the ids of bodies must not depend on the order of a set.
                for key in sorted(far):
                    laid.lift(key)
            if not drawn:
                # Stores are used again, also by worlds to come: making one takes many times as
                # long as joining them.
                self._drawn = tuple(self._tiles.near(places_W_m, self._sight_m + _TILE_MORE_M))
                if len(self._stores) > _MOST_STORES:
                    self._stores.clear()
                for key in self._drawn:
                    if key not in self._stores:
                        self._stores[key] = GeometryStore(self._tiles.mesh(key))
                self._rig.show(GeometryStore.joined([self._stores[key] for key in self._drawn]))
