"""The stopwatched world counts the processor time of all its threads, and knows who has spent it."""

import threading
import time

from benchmarks.tick.bridgeless_world import STAGES, StopwatchedWorld
from tests.support.worlds import quick_config
from wcsim.physics.sensors import camera
from wcsim.types import SeatSpec

PICTURE_S = 0.05


def test_a_tick_has_the_pictures_of_all_threads_and_calls_them_rendering(corner, monkeypatch):
    both = threading.Barrier(2, timeout=20.0)

    def take(shot):
        both.wait()  # each of the two threads draws one
        begun_s = time.thread_time()
        while time.thread_time() - begun_s < PICTURE_S:
            pass

    config = quick_config("world.draw_threads=2")
    world = StopwatchedWorld(next(corner.glob("*.sumocfg")), config, (SeatSpec(),) * 2, 1)
    try:
        monkeypatch.setattr(camera._Shot, "take", take)
        _, cpu_s, *rest = world.tick()
        spent = dict(zip(STAGES, rest, strict=False))
        assert cpu_s > 2 * PICTURE_S
        assert 2 * PICTURE_S < spent["render"] < cpu_s
        assert sum(spent.values()) <= cpu_s
    finally:
        world.close()
