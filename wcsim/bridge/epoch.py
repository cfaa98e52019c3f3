"""What a world makes anew for each epoch: an engine with the bodies in it, and those who react to the wheelchairs."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.bridge.mirror_check import MirrorCheck
from wcsim.bridge.reacting_traffic import ReactingTraffic
from wcsim.bridge.reaction.attention import AttentionModel, street_habits
from wcsim.bridge.sumo.session import SumoSession
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.physics.engine import Engine
from wcsim.physics.kinematic_bodies import BodyPool
from wcsim.physics.street_bodies import StreetBodies
from wcsim.types import Ground


@dataclass(frozen=True, slots=True, kw_only=True)
class Epoch:
    """Lives from one `World.rebuild` to the next; `engine` has to be closed then."""

    attention: AttentionModel
    traffic: ReactingTraffic
    engine: Engine
    bodies: BodyPool
    check: MirrorCheck
    street: StreetBodies


def new_epoch(config: RunConfig, ground: Ground, sumo: SumoSession, seed: int) -> Epoch:
    """An epoch in which nothing has happened yet. Raises PhysicsError when PyBullet gives no engine."""
    attention = street_habits(config.world, seeding.derive(seed, "street"))
    engine = Engine(config.world.tick_s / config.world.usual_substeps)
    bodies = BodyPool(engine)
    sight_m = max(camera.range_m for camera in config.cameras)
    return Epoch(
        attention=attention,
        traffic=ReactingTraffic(config.world, ground, sumo, attention, sight_m),
        engine=engine,
        bodies=bodies,
        check=MirrorCheck(bodies),
        street=StreetBodies(engine),
    )
