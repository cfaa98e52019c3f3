"""Properties of the whole bridge: frames, soak, exact replay, and what a run may not depend on."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.support.worlds import follow, open_world

SAME = """
import hashlib, sys, time
from pathlib import Path
from tests.support.worlds import hashes, open_world
with open_world(Path(sys.argv[1]), seed=5) as world:
    found = []
    for _ in range(3):
        time.sleep(float(sys.argv[2]))
        found += hashes(world, 8)
    image = world.snapshot.clients[0].sensors.cameras[0]
    print(*found, hashlib.sha256(image.depth_m.tobytes() + image.class_id.tobytes()).hexdigest())
"""


def test_a_run_depends_on_neither_string_hashes_nor_delays(corner):
    told = []
    for hash_seed, delay_s in (("0", "0"), ("12345", "0.1")):
        run = subprocess.run(
            [sys.executable, "-c", SAME, str(corner), delay_s],
            env={**_environment(), "PYTHONHASHSEED": hash_seed},
            capture_output=True,
            text=True,
            check=True,
            timeout=200,
        )
        told.append(run.stdout)
    assert told[0] == told[1]
    assert len(set(told[0].split()[:24])) == 24


def test_every_frame_is_of_its_tick_for_every_client(corner):
    with open_world(corner, seats=3) as world:
        for _ in range(12):
            snapshot = follow(world)
            for client in snapshot.clients:
                now = client.first or client
                assert client.tick == client.sensors.tick == now.sensors.tick == snapshot.tick
                assert all(frame.taken_tick == snapshot.tick for frame in now.sensors.cameras)


def test_rebuilding_a_world_again_and_again_leaves_no_memory_behind(corner):
    _soak(corner, resets=25, allowed_mb=8.0)


@pytest.mark.proof
def test_two_hundred_resets_leave_no_memory_behind(corner):
    _soak(corner, resets=200, allowed_mb=20.0)


def _soak(corner: Path, resets: int, allowed_mb: float) -> None:
    gc.freeze()  # what the tests before have left is not looked through again and again
    try:
        with open_world(corner) as world:
            used = []
            for number in range(resets + 10):
                world.rebuild(number)
                follow(world)
                gc.collect()
                used.append(psutil.Process().memory_info().rss / 1e6)
    finally:
        gc.unfreeze()
    warm = used[10:]  # the first ones fill pools and caches
    slope = float(np.polyfit(np.arange(len(warm)), warm, 1)[0])
    assert slope * resets < allowed_mb, f"{slope:.3f} MB a reset"


def _environment() -> dict[str, str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    return kept | {"PYTHONPATH": str(Path(__file__).parents[3])}
