"""The whole naive loop: SUMO asked thing by thing through libsumo, everything mirrored, TinyRenderer as the camera.

It runs in a process of its own, in turns with the product, on the same scenario with the same demand and plant.
"""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from pathlib import Path

import libsumo
import numpy as np

from benchmarks.tick.naive import NaiveLoop
from wcsim.bridge.sumo.open_scenario import open_scenario
from wcsim.bridge.sumo.session import sumo_seed, warmup_s
from wcsim.config import RunConfig
from wcsim.towns.scenario.overrides import Settings, forced
from wcsim.towns.scenario.town import open_town
from wcsim.towns.street import load_street
from wcsim.towns.walking.routes import Router
from wcsim.types import ActorKind, ActorState
from wcsim.types.episode import RunPlace

WHEEL_RADPS = 6.0


class NaiveWorld:
    """SUMO, PyBullet and its camera without any of the product's thoughts; see `benchmarks.interleave.Runner`."""

    def __init__(self, sumocfg: Path, config: RunConfig, chairs: int, seed: int, looks: bool = True) -> None:
        town = open_town(sumocfg)
        street = load_street(town)
        self.origin_m = town.file.origin_m
        self._held = ExitStack()
        settings = Settings(world=config.world, seed=sumo_seed(seed))
        scenario = open_scenario(town, settings, RunPlace(), self._held)
        words = ["sumo", "--configuration-file", str(scenario.sumocfg)]
        for name, value in forced(settings, scenario.author_scale):
            words += [f"--{name}", value]
        libsumo.start(words)
        for _ in range(round(warmup_s(town, config) / config.world.tick_s)):
            libsumo.simulationStep()
        router, rng = Router(street.walk), np.random.default_rng(seed)
        starts = []
        for _ in range(chairs):
            (x, y), yaw_rad = router.random_start(rng)
            starts.append((np.array([x, y, street.grid.height_at(np.array([x, y]))]), yaw_rad))
        camera = config.cameras[0] if looks else None
        self.loop = NaiveLoop(street.mesh, camera, starts, config.world.usual_substeps, config.world.tick_s)

    def tick(self) -> tuple[float, ...]:
        """Wall and processor seconds of the tick, and the number of actors."""
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        libsumo.simulationStep()
        actors = self._everybody()
        self.loop.tick(actors, (WHEEL_RADPS, WHEEL_RADPS))
        return time.perf_counter() - wall_s, time.process_time() - cpu_s, float(len(actors))

    def close(self) -> None:
        """End both engines."""
        self.loop.close()
        libsumo.close()
        self._held.close()

    def _everybody(self) -> list[ActorState]:
        """Every vehicle and person, one question at a time."""
        found = []
        for domain, kind in ((libsumo.vehicle, ActorKind.CAR), (libsumo.person, ActorKind.PEDESTRIAN)):
            for name in domain.getIDList():
                x, y, z = domain.getPosition3D(name)
                yaw_rad = math.radians(90.0 - domain.getAngle(name))
                length, width, height = domain.getLength(name), domain.getWidth(name), domain.getHeight(name)
                speed = domain.getSpeed(name)
                back_m = 0.5 * length if kind is ActorKind.CAR else 0.0
                west_m, south_m = self.origin_m
                place = (x - west_m - back_m * math.cos(yaw_rad), y - south_m - back_m * math.sin(yaw_rad))
                found.append(
                    ActorState(
                        id=name,
                        kind=kind,
                        p_W_m=np.array([*place, z]),
                        yaw_rad=yaw_rad,
                        pitch_rad=0.0,
                        v_W_mps=np.array([speed * math.cos(yaw_rad), speed * math.sin(yaw_rad), 0.0]),
                        size_lwh_m=(length, width, height),
                    )
                )
        return found
