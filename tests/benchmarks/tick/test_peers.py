"""The product's tick beside the loop that one would write first, interleaved in one run, in CPU time."""

import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.tick.naive import NaiveLoop
from wcsim.bridge.world import World
from wcsim.config import resolve
from wcsim.towns.scenario.town import find_town
from wcsim.types import ActorState, Command, SeatSpec

SIZE = ("cameras.0.width_px=320", "cameras.0.height_px=240")
EVERYWHERE_M = 1e5
WHEEL_RADPS = 9.0  # of a stick that is pushed to its end


def spent(town: str, ticks: int, warmup_s: float) -> tuple[list[float], list[float], int]:
    """CPU seconds of every tick of the product and of the naive loop, and the number of actors in the town."""
    config = resolve("quick", (*SIZE, f"world.warmup_s={warmup_s}"))
    ours, theirs = [], []
    with World(find_town(town), config, (SeatSpec(profile="competent"),), 3) as world:
        plant = world.snapshot.clients[0].plant
        starts, steps = [(plant.p_WB_m, plant.yaw_rad)], config.world.usual_substeps  # as many as the product's
        naive = NaiveLoop(world.street.mesh, config.cameras[0], starts, steps, config.world.tick_s)
        try:
            for tick in range(-5, ticks):  # the first ones compile and fill caches
                client = world.snapshot.clients[0]
                command = Command(seat=0, tick=world.snapshot.tick, joystick=(client.first or client).user)
                start = time.process_time()
                world.tick((command,))
                between = time.process_time()
                everybody = actors_of(world)
                ((depth_m, bodies),) = naive.tick(everybody, (command.joystick.y * WHEEL_RADPS,) * 2)
                end = time.process_time()
                if tick >= 0:
                    ours.append(between - start)
                    theirs.append(end - between)
            assert depth_m.shape == bodies.shape == (240, 320)
            assert depth_m.min() < 10.0 < depth_m.max(), "the naive camera must see the street"
            assert len(np.unique(bodies)) > 2
        finally:
            naive.close()
        return ours, theirs, len(everybody)


def actors_of(world: World) -> tuple[ActorState, ...]:
    """Everything that SUMO moves, wherever it is: whoever has no mirror radius mirrors it all."""
    return world.sumo.actors(np.zeros((1, 2)), EVERYWHERE_M)


@pytest.mark.proof
def test_a_tick_with_camera_is_five_times_faster_than_the_naive_loop():
    ours, theirs, actors = spent("helsinki", 30, 60.0)
    assert actors > 30
    assert np.median(theirs) >= 5.0 * np.median(ours), f"{np.median(theirs)} s against {np.median(ours)} s"


def test_even_at_a_bare_street_corner_it_is_faster(corner: Path):
    """Nothing is there to be saved: 380 triangles, four actors, all of them near the chair."""
    ours, theirs, actors = spent(str(corner), 40, 5.0)
    assert actors > 0
    assert np.median(theirs) >= 2.0 * np.median(ours), f"{np.median(theirs)} s against {np.median(ours)} s"
