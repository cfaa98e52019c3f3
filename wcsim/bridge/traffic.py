"""A town's traffic with no wheelchair in it: SUMO alone, for which no street has to be built."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np

from wcsim.bridge.recording.trace import state_hash
from wcsim.bridge.sumo.open_scenario import open_scenario
from wcsim.bridge.sumo.run_place import RunPlace
from wcsim.bridge.sumo.session import SumoOptions, SumoSession, refuse_second_world
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.scenario.overrides import settings_of
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import read_net
from wcsim.types import ActorState, Snapshot


class TownTraffic:
    """SUMO with a town's scenario, one tick after the other; what a world without seats does, without its street."""

    def __init__(self, town: Town, config: RunConfig, seed: int, place: RunPlace) -> None:
        """Start SUMO and let the traffic warm up.

        Raises TownError for a scenario that cannot be run, WorldInUseError while a world lives in this process.
        """
        refuse_second_world()
        validate_net(town.net, border=town.border)
        self.net_z_m = read_net(town.net, town.file.origin_m).z_origin_m
        self._held = ExitStack()
        self._tick = 0
        sumo_seed = seeding.derive(seed, "sumo")
        try:
            self.scenario = open_scenario(town, settings_of(config, sumo_seed), place, self._held)
            options = SumoOptions(
                sumocfg=self.scenario.sumocfg,
                origin_m=town.file.origin_m,
                step_s=config.world.tick_s,
                seed=sumo_seed,
                demand_scale=config.world.demand_scale,
                jam_teleport_s=config.world.jam_teleport_s,
                z_origin_m=self.net_z_m,
                author_scale=self.scenario.author_scale,
                hook=place.hook,
            )
            self._sumo = self._held.enter_context(SumoSession(options))
            warmup_s = config.world.warmup_s if town.file.warmup_s is None else town.file.warmup_s
            for _ in range(round(warmup_s / config.world.tick_s)):
                self._sumo.step()
        except BaseException:
            self.close()
            raise
        self.snapshot = self._published()

    def tick(self) -> Snapshot:
        """Carry the traffic on by one tick; the snapshot holds no actors, for there is no chair near which they are."""
        self._sumo.step()
        self._tick += 1
        self.snapshot = self._published()
        return self.snapshot

    def everyone(self) -> tuple[ActorState, ...]:
        """Every vehicle and person of the town, sorted by id."""
        return self._sumo.actors_at(np.zeros((1, 2)), math.inf)

    def mishaps(self) -> tuple[int, int]:
        """Vehicles that SUMO took out of a jam during the last step, and collisions that began in it."""
        return self._sumo.teleports, self._sumo.collisions()

    def close(self) -> None:
        """End SUMO; a second call does nothing."""
        self._held.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _published(self) -> Snapshot:
        bare = Snapshot(epoch=0, tick=self._tick, time_s=self._sumo.time_s(), actors=(), signals=(), clients=())
        return replace(bare, state_hash=state_hash(bare))
