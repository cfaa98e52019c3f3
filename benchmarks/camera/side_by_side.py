"""Six wheelchairs' cameras drawn one after the other, and by threads: wall time of the whole call, in turns."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from benchmarks.camera.random_scenes import Scene
from wcsim.config import CameraConfig
from wcsim.core import frames
from wcsim.errors import ConfigError
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.sensors.base import Surroundings
from wcsim.physics.sensors.camera import CameraRig
from wcsim.physics.sensors.drawing_threads import cores
from wcsim.types import F64, ActorState, PlantState
from wcsim.types.street import joined_mesh

CAMERAS = 6
_TURNS = 300


@dataclass(frozen=True, slots=True, kw_only=True)
class SideBySide:
    """Wall milliseconds of one call that draws the pictures of all cameras, best of all turns."""

    threads: int
    alone_ms: float  # by one thread
    together_ms: float

    @property
    def gain(self) -> float:
        """How many times as fast the threads are."""
        return self.alone_ms / self.together_ms


def side_by_side(
    store: GeometryStore, camera: CameraConfig, scene: Scene, threads: int = 0, turns: int = _TURNS
) -> SideBySide:
    """Draw what six chairs of a scene see, by one thread and by `threads` (0: one a core) in turns.

    Raises:
        ConfigError: when there is no turn, or no place in the scene.
    """
    if turns < 1 or not scene.places:
        raise ConfigError(f"got {turns} turns and {len(scene.places)} places; expected at least one of each")
    plants = [_standing(*scene.places[seat % len(scene.places)]) for seat in range(CAMERAS)]
    best_s = [float("inf"), float("inf")]
    with ExitStack() as held:
        rigs = [CameraRig(joined_mesh(()), (camera,), CAMERAS, threads=count) for count in (1, threads)]
        for rig in rigs:
            held.enter_context(rig).show(store)
        for turn in range(turns):
            seen = _scenes(plants, scene.actors, turn)
            for k, rig in enumerate(rigs):
                start = time.perf_counter()
                rig.shoot_all(seen)
                best_s[k] = min(best_s[k], time.perf_counter() - start)
    return SideBySide(threads=threads or cores(), alone_ms=1e3 * best_s[0], together_ms=1e3 * best_s[1])


def _standing(p_W_m: F64, yaw_rad: float) -> PlantState:
    return PlantState(
        p_WB_m=p_W_m,
        q_WB=np.array(frames.quaternion(yaw_rad)),
        v_B_mps=np.zeros(3),
        w_B_radps=np.zeros(3),
        wheel_radps=np.zeros(2),
        roll_rad=0.0,
        pitch_rad=0.0,
        yaw_rad=yaw_rad,
    )


def _scenes(plants: Sequence[PlantState], actors: tuple[ActorState, ...], tick: int) -> dict[int, Surroundings]:
    anew = tuple(list(actors))  # another object, so that they are read again as in every tick
    return {
        seat: Surroundings(tick=tick, plant=plant, actors=anew, chairs=(), signals=(), buffers=None, counted=False)
        for seat, plant in enumerate(plants)
    }
