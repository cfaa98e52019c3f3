"""Small worlds for tests: tiny cameras, no warm-up."""

from dataclasses import replace
from pathlib import Path

from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig, resolve
from wcsim.towns.scenario.town import find_town
from wcsim.types import ClientSnapshot, Command, Joystick, SeatSpec, Snapshot
from wcsim.types.chair import AT_REST
from wcsim.users.recordings.recorded_user import find_user

QUICK = ("world.warmup_s=0", "cameras.0.width_px=32", "cameras.0.height_px=24")


def quick_config(*overrides: str) -> RunConfig:
    """Preset quick with the smallest useful cameras and no warm-up."""
    return resolve("quick", (*QUICK, *overrides))


def dqn_config(*overrides: str) -> RunConfig:
    """The same of preset dqn: for what learns, and chooses its head itself."""
    return resolve("dqn", (*QUICK, *overrides))


def open_world(town: Path, *overrides: str, seats: int = 1, seed: int = 1, spec: SeatSpec | None = None) -> World:
    """A world in a town's folder."""
    return World(
        find_town(str(town)), quick_config(*overrides), (spec or SeatSpec(),) * seats, seed, find_user=find_user
    )


def follow(world: World) -> Snapshot:
    """One tick in which everybody gets what their user asks for."""
    return next(rollout(world)).after


def push(world: World, stick: Joystick = AT_REST) -> ClientSnapshot:
    """What becomes of a chair that is alone in its world in one tick with this stick."""
    return world.tick((Command(seat=0, tick=world.snapshot.tick, joystick=stick),)).clients[0]


def hashes(world: World, ticks: int) -> list[str]:
    """State hashes of the coming ticks, whatever epoch they are in."""
    return [replace(follow(world), epoch=0).digest() for _ in range(ticks)]
