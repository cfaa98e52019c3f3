"""What a world makes anew for each epoch: an engine with the bodies in it, and those who react to the wheelchairs."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.bridge.mirror_check import MirrorCheck
from wcsim.bridge.reaction.articulated import Articulation
from wcsim.bridge.reaction.attention import AttentionModel, street_habits
from wcsim.bridge.reaction.drivers import StreetReaction
from wcsim.bridge.reaction.pedestrians import PedestrianAvoidance
from wcsim.bridge.reaction.wide_turn_bodies import SwingOut
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
    drivers: StreetReaction
    people: PedestrianAvoidance
    wide_turns: SwingOut
    articulation: Articulation
    engine: Engine
    bodies: BodyPool
    check: MirrorCheck
    street: StreetBodies


def new_epoch(config: RunConfig, ground: Ground, seed: int) -> Epoch:
    """An epoch in which nothing has happened yet. Raises PhysicsError when PyBullet gives no engine."""
    tick_s = config.world.tick_s
    attention = street_habits(config.world, seeding.derive(seed, "street"))
    wide_turns = SwingOut(ground, tick_s)
    engine = Engine(tick_s / config.world.substeps)
    bodies = BodyPool(engine)
    return Epoch(
        attention=attention,
        drivers=StreetReaction(config.world, attention, wide_turns),
        people=PedestrianAvoidance(ground, tick_s, attention.people),
        wide_turns=wide_turns,
        articulation=Articulation(),
        engine=engine,
        bodies=bodies,
        check=MirrorCheck(bodies),
        street=StreetBodies(engine),
    )
