"""A town's traffic with no wheelchair in it: SUMO alone, for which no street has to be built."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

from wcsim.bridge.recording.trace import state_hash
from wcsim.bridge.sumo.run_place import RunPlace
from wcsim.bridge.sumo.session import refuse_second_world
from wcsim.bridge.sumo.town_session import open_session, warm_up, warmup_s
from wcsim.config import RunConfig
from wcsim.core.closing import Closing
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import read_net
from wcsim.types import ActorState, Snapshot


class TownTraffic(Closing):
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
        try:
            self.scenario, self._sumo = open_session(town, config, seed, place, self.net_z_m, self._held)
            warm_up(self._sumo, warmup_s(town, config), config.world.tick_s)
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
        return self._sumo.everyone()

    @property
    def mishaps_so_far(self) -> tuple[int, int]:
        """`mishaps` since the scenario began, while the traffic warmed up too."""
        return self._sumo.so_far

    def mishaps(self) -> tuple[int, int]:
        """Vehicles that SUMO took out of a jam during the last step, and collisions that began in it."""
        return self._sumo.mishaps()

    def close(self) -> None:
        """End SUMO; a second call does nothing."""
        self._held.close()

    def _published(self) -> Snapshot:
        bare = Snapshot(epoch=0, tick=self._tick, time_s=self._sumo.time_s(), actors=(), signals=(), clients=())
        return replace(bare, state_hash=state_hash(bare))
