"""What a world makes anew for each epoch: an engine with bodies, and the traffic near the chairs.

The traffic brakes or stands for the wheelchairs tick by tick, and is shown as it really moves.
It needs no engine: a world mirrors it into one, a bench leads chairs through it by hand.
"""

import numpy as np

from wcsim.bridge import mirror
from wcsim.bridge.mirror import MirrorCheck
from wcsim.bridge.reaction.articulated import Articulation
from wcsim.bridge.reaction.attention import AttentionModel
from wcsim.bridge.reaction.commands import Blocked, ChairInStreet
from wcsim.bridge.reaction.drivers import StreetReaction
from wcsim.bridge.reaction.pedestrians import PedestrianAvoidance
from wcsim.bridge.reaction.wide_turns import SwingOut
from wcsim.bridge.sumo.session import SumoSession
from wcsim.config import RunConfig, WorldConfig
from wcsim.core import seeding
from wcsim.core.constants import OTHER_LEVEL_M
from wcsim.physics.engine import Engine, StreetBodies
from wcsim.physics.kinematic_bodies import BodyPool
from wcsim.types import F64, ActorState, Ground, SignalState
from wcsim.types.street import FLAT

_SIGNAL_REACH_M = 60.0  # what a user or a driver has to know of a traffic light is nearer
_SIGNAL_MORE_M = 20.0  # from a stop line, which says how far off a light is, to its farthest head


class ReactingTraffic:
    """Drivers and people of one epoch. In a tick: `react`, SUMO's step, `read`, `move`."""

    def __init__(
        self,
        config: WorldConfig,
        ground: Ground,
        sumo: SumoSession,
        attention: AttentionModel,
        sight_m: float = 0.0,
    ) -> None:
        """Nobody is near a chair yet; `attention` says who looks, cameras see `sight_m` far."""
        self.chairs: tuple[ChairInStreet, ...] = ()  # as the traffic sees them in this tick
        self.actors: tuple[ActorState, ...] = ()  # near the chairs now, as they are shown
        self.before: dict[str, ActorState] = {}  # the same a tick ago, by id
        self.signals: tuple[SignalState, ...] = ()
        self._config, self._ground, self._sumo = config, ground, sumo
        # Without relief all are taken to be on one level, and nobody has to be left out.
        self._hilly = ground.around(np.zeros(2)).relief is not FLAT
        self._wide_turns = SwingOut(ground, config.tick_s)
        self._articulation = Articulation()
        self._signals_m = max(_SIGNAL_REACH_M, sight_m + _SIGNAL_MORE_M)
        self._drivers = StreetReaction(config, attention, self._wide_turns)
        self._people = PedestrianAvoidance(ground, config.tick_s, attention.people)

    def react(self, chairs: tuple[ChairInStreet, ...]) -> None:
        """The traffic sees these chairs of tick n: drivers brake or pass, people stop."""
        self.chairs = chairs
        pilot = self._sumo.pilot
        here = self._level(self.actors)
        commands = self._drivers.react(here, chairs, pilot)
        for command in (*commands, *self._people.holds(here, chairs)):
            pilot.apply(command)

    def read(self, places_W_m: F64) -> tuple[ActorState, ...]:
        """The actors near the chairs (n, 2) after SUMO's step, but for those put on a chair."""
        near = self._near(places_W_m)
        on_top = self._drivers.turned_away(self._level(near), self.chairs, self._sumo.spawned)
        away = [actor_id for actor_id in on_top if self._sumo.turn_away(actor_id)]
        if away:
            near = tuple(actor for actor in near if actor.id not in away)
        return self._shown(near)

    def move(self, near: tuple[ActorState, ...], places_W_m: F64) -> None:
        """Move people's side steps by a tick, and make those of `read` the actors of now."""
        self.before = {actor.id: actor for actor in self.actors}
        # The offsets first: `_take` shows people where these put them.
        self._people.update(self._level(near), self.chairs)
        self._take(near, places_W_m)

    def look_again(self, places_W_m: F64) -> None:
        """See the actors near the chairs anew, after a chair was put elsewhere; none moves."""
        self._take(self._shown(self._near(places_W_m)), places_W_m)

    def blocked(self) -> tuple[Blocked, ...]:
        """Who stands because of a chair now."""
        return (*self._drivers.blocked(), *self._people.blocked())

    def passing(self) -> tuple[str, ...]:
        """The vehicles that have a way round a chair now."""
        return self._drivers.passing()

    def _near(self, places_W_m: F64) -> tuple[ActorState, ...]:
        """The actors near any chair as SUMO has them."""
        return self._sumo.actors(places_W_m, self._config.mirror_radius_m)

    def _shown(self, near: tuple[ActorState, ...]) -> tuple[ActorState, ...]:
        """The same actors with long vehicles as they take a bend: wide, in rigid pieces."""
        # The swing-out first: the pieces of a vehicle follow the way on which its front is shown.
        return self._articulation.bent(self._wide_turns.shown(near, self._sumo.pilot))

    def _take(self, near: tuple[ActorState, ...], places_W_m: F64) -> None:
        """Make these the actors of now, on the ground and stepped aside; read the signals."""
        there = mirror.on_ground(self._people.shifted(near), self._ground)
        self.actors = mirror.walked(self.before, there, self._config.tick_s)
        self.signals = self._sumo.signals(places_W_m, self._signals_m)

    def _level(self, actors: tuple[ActorState, ...]) -> tuple[ActorState, ...]:
        """Those on the level of a chair: who is on a bridge above it has nothing to do with it."""
        if not self._hilly:
            return actors
        heights_m = [chair.z_m for chair in self.chairs]
        level = []
        for actor in actors:
            z_m = float(actor.p_W_m[2])
            if any(abs(z_m - height_m) < OTHER_LEVEL_M for height_m in heights_m):
                level.append(actor)
        return actors if len(level) == len(actors) else tuple(level)


class Epoch:
    """Lives from one `World.rebuild` to the next; `engine` has to be closed then."""

    def __init__(self, config: RunConfig, ground: Ground, sumo: SumoSession, seed: int) -> None:
        """Nothing has happened yet. Raises PhysicsError when PyBullet gives no engine."""
        self.attention = AttentionModel(config.world, seeding.derive_seed(seed, "street"))
        self.engine = Engine(config.world.tick_s / config.world.usual_substeps)
        self.bodies = BodyPool(self.engine)
        sight_m = max(camera.range_m for camera in config.cameras)
        self.traffic = ReactingTraffic(config.world, ground, sumo, self.attention, sight_m)
        self.check = MirrorCheck(self.bodies)
        self.street = StreetBodies(self.engine)
