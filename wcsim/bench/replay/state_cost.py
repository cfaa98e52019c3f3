"""States of a real drive in the replay memory on disk: how large they are, how long writing and reading takes.

A state is what a network sees of one tick: class ids and log depth of the whole picture, and a few numbers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gymnasium import spaces

from wcsim.agents.replay.buffer import FrameReplay, ReplaySettings
from wcsim.agents.replay.disk_store import DiskFrames
from wcsim.bridge.world import World, as_users_wish
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import ObservationSpec, observation_space, observe
from wcsim.towns.scenario.town import Town
from wcsim.types import U8, SeatSpec

MANY_STATES = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class StateCost:
    """One kind of camera; times in milliseconds of CPU time, medians over the states."""

    kb_per_state: float  # on disk, with its record
    write_ms: float
    read_ms: float  # from anywhere in the store
    memory_mb: float  # that a replay of MANY_STATES holds in memory, by counting its arrays
    states: int


def measure_states(
    town: Town, config: RunConfig, states: int, seed: int, folder: Path, progress: Callable[[int], object]
) -> StateCost:
    """Drive as the user wishes, keep so many states, and read each of them once in a random order.

    Raises:
        PolicyError: `folder` holds something else.
        SumoError: The world dies or hangs.
    """
    write_ms, read_ms = [], []
    size = 2 * config.cameras[0].width_px * config.cameras[0].height_px
    with DiskFrames(folder, states, 1, size, smooth=size // 2) as store:
        for number, frame in enumerate(_frames(town, config, states, seed)):
            began = time.thread_time()
            store.write(number, 0, frame)
            write_ms.append(1e3 * (time.thread_time() - began))
            progress(number + 1)
        seat = np.zeros(1, dtype=np.int64)
        for number in seeding.generator(seed, "bench", "replay").permutation(states):
            began = time.thread_time()
            store.read(np.array([number]), seat)
            read_ms.append(1e3 * (time.thread_time() - began))
        held = sum(path.stat().st_size for path in folder.glob("segment-*"))
    return StateCost(
        kb_per_state=held / 1e3 / states,
        write_ms=float(np.median(write_ms)),
        read_ms=float(np.median(read_ms)),
        memory_mb=counted_mb(config, folder.with_name(f"{folder.name}-counted")),
        states=states,
    )


def counted_mb(config: RunConfig, folder: Path) -> float:
    """Megabytes of the arrays in memory of a replay of MANY_STATES steps whose frames are on disk."""
    camera = config.cameras[0]
    space = observation_space("compact", camera.width_px, camera.height_px)
    actions = spaces.Discrete(len(action_set(config.env.actions)))
    chosen = ReplaySettings(memory="groups", folder=folder)
    replay = FrameReplay(MANY_STATES, space, actions, device="cpu", settings=chosen)
    try:
        index = 0 if replay.disk is None else replay.disk.index_bytes
        held = [part for owner in (replay, replay.windows) for part in vars(owner).values()]
        return (index + sum(part.nbytes for part in held if isinstance(part, np.ndarray))) / 1e6
    finally:
        replay.close()


def _frames(town: Town, config: RunConfig, states: int, seed: int) -> Iterator[U8]:
    """Images of one chair's ticks, class ids and depth side by side, (2 * H * W,)."""
    camera = config.cameras[0]
    seen = ObservationSpec(camera=camera.name, range_m=camera.range_m, fold=config.env.classes == "cityscapes")
    with World(town, config, (SeatSpec(),), seed) as world:
        for _ in range(states):
            client = world.snapshot.clients[0]
            image = observe("compact", client.sensors, client.user, seen)
            yield np.concatenate([image["depth"].reshape(-1), image["seg"].reshape(-1)])
            world.tick(as_users_wish(world.snapshot))
