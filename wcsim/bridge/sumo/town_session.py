"""SUMO with the scenario of a town: staged, tried out, started, and its traffic warmed up."""

from __future__ import annotations

from contextlib import ExitStack

from wcsim.bridge.sumo.open_scenario import open_scenario
from wcsim.bridge.sumo.run_place import RunPlace
from wcsim.bridge.sumo.session import SumoOptions, SumoSession
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.towns.scenario.overrides import settings_of
from wcsim.towns.scenario.stage import Scenario
from wcsim.towns.scenario.town import Town


def sumo_seed(seed: int) -> int:
    """SUMO's own seed in a world with this one."""
    return seeding.derive(seed, "sumo")


def open_session(
    town: Town, config: RunConfig, seed: int, place: RunPlace, net_z_m: float, held: ExitStack
) -> tuple[Scenario, SumoSession]:
    """Start SUMO for a world with this seed; `held` ends it, `net_z_m` is the net's own height of W's z = 0.

    Raises TownError for a scenario that cannot be run, WorldInUseError while another session lives in this process.
    """
    scenario = open_scenario(town, settings_of(config, sumo_seed(seed)), place, held)
    options = SumoOptions(
        sumocfg=scenario.sumocfg,
        origin_m=town.file.origin_m,
        step_s=config.world.tick_s,
        seed=sumo_seed(seed),
        demand_scale=config.world.demand_scale,
        jam_teleport_s=config.world.jam_teleport_s,
        z_origin_m=net_z_m,
        author_scale=scenario.author_scale,
        hook=place.hook,
    )
    return scenario, held.enter_context(SumoSession(options))


def warmup_s(town: Town, config: RunConfig) -> float:
    """How long the traffic runs before a world begins: as the user set it, as the town says, or as usual."""
    own_s = town.file.warmup_s if config.world.town_warmup else None
    return config.world.warmup_s if own_s is None else own_s


def warm_up(sumo: SumoSession, for_s: float, tick_s: float) -> None:
    """Let the traffic run alone."""
    for _ in range(round(for_s / tick_s)):
        sumo.step()
