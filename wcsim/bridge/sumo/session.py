"""SUMO inside this process: the only file that speaks to libsumo.

libsumo holds one simulation a process; a second `start` silently resets the first one, so a session
refuses to start while another one is loaded. Whole-world reset is one drain step, then
`libsumo.load` (bit-identical; `loadState` is not). Nothing but `ActorState` and `SignalState`
leaves this file.

`open_session` starts it with the scenario of a town, staged and tried out; `warm_up` lets the
traffic run alone.
"""

import locale
import logging
import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wcsim.bridge.sumo.actors import ActorReader, SignalReader
from wcsim.bridge.sumo.open_scenario import open_scenario
from wcsim.bridge.sumo.run_place import RunPlace
from wcsim.bridge.sumo.signal_control import SignalControl
from wcsim.bridge.sumo.step_hook import HookChair, StepHook
from wcsim.bridge.sumo.vehicle_control import VehicleControl
from wcsim.config import RunConfig
from wcsim.config.world import JUPEDSIM
from wcsim.core import seeding
from wcsim.core.closing import ClosingContextBase
from wcsim.errors import SumoError, WorldInUseError
from wcsim.towns.scenario.overrides import JUMPING, PEOPLE, Settings, forced
from wcsim.towns.scenario.stage import Scenario
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.tools import UTF_8, missing_library
from wcsim.towns.sumo.warning_log import WarningLog
from wcsim.types import F64, ActorState, SignalState

try:
    import libsumo
except ImportError as error:
    if not (cure := missing_library(str(error))):
        raise
    raise SumoError(f"libsumo cannot be loaded: {cure}") from error

log = logging.getLogger("wcsim.bridge.sumo.session")
_WARMUP_S = 240.0  # where neither the settings nor the town say it


@dataclass(frozen=True, slots=True, kw_only=True)
class SumoOptions:
    """What a session runs, and what a world overrides of a scenario's own options."""

    sumocfg: Path
    origin_m: tuple[float, float]
    settings: Settings
    z_origin_m: float = 0.0  # the net's own height of W's z = 0
    author_scale: float = 1.0  # the scenario's own, which demand_scale multiplies
    warnings: str = ""  # the file that SUMO writes them into
    hook: str = ""  # a user's own module:Class, see `bridge/sumo/step_hook.py`

    def arguments(self) -> list[str]:
        """The command line for libsumo; all that follows the configuration overrides it."""
        words = ["sumo", "--configuration-file", str(self.sumocfg)]
        for name, value in forced(self.settings, self.author_scale):
            words += [f"--{name}", value]
        return words


class SumoSession(ClosingContextBase):
    """The one SUMO simulation of this process."""

    def __init__(self, options: SumoOptions) -> None:
        """Start SUMO.

        Raises:
            WorldInUseError: Another session lives in this process.
            SumoError: SUMO fails.
        """
        refuse_second_world()
        self._options = options
        self._reset_counts()
        self._open = True
        self.pilot = VehicleControl(libsumo, options.origin_m)
        self.buttons = SignalControl(libsumo)
        origin_m = *options.origin_m, options.z_origin_m
        self._reader = ActorReader(libsumo, origin_m, options.settings.world.tick_s)
        # SUMO reads the names of files in the locale's letters; that of LC_ALL=C has ASCII's alone.
        if locale.nl_langinfo(locale.CODESET) != "UTF-8":
            locale.setlocale(locale.LC_CTYPE, UTF_8)
        self._guarded(lambda: libsumo.start(options.arguments()))
        try:
            self._hook = self._new_hook()
            self._signals = SignalReader(libsumo, options.origin_m)
            people = libsumo.simulation.getOption(PEOPLE)
            self._jumpers, self._by_jupedsim = people == JUMPING, people == JUPEDSIM
        except BaseException:
            self.close()
            raise

    def _reset_counts(self) -> None:
        self.teleports = 0  # vehicles that SUMO took out of a jam during the last step
        # In the last step, as in `ActorState.id`: departed, or off a teleport.
        self.spawned: frozenset[str] = frozenset()
        # Since the scenario's start, warm-up included: teleports, and new collisions.
        self.mishaps = 0, 0
        self._colliding: frozenset[frozenset[str]] = frozenset()
        self.warnings = WarningLog(self._options.warnings)

    def step(self, chairs: Callable[[], tuple[HookChair, ...]] = tuple) -> None:
        """Advance SUMO by one step, with the user's hook around it, and log jams that it dissolved.

        `chairs` are those before the step; they are made only where there is a hook.
        """
        # 1. The step, with the hook around it.
        hook_chairs = () if self._hook is None else chairs()
        if self._hook is not None:
            self._hook.before_step(self.time_s(), hook_chairs)
        self._guarded(libsumo.simulationStep)
        if self._hook is not None:
            self._hook.after_step(self.time_s(), hook_chairs)
        self.warnings.read()
        # 2. Who is new. After a jump an actor may be nearer than its speed allows: the reader looks
        #    at all of them again.
        simulation = libsumo.simulation
        jammed = simulation.getStartingTeleportIDList()
        landed = simulation.getEndingTeleportIDList()
        vehicles = simulation.getDepartedIDList()
        people = simulation.getDepartedPersonIDList()
        unsure = bool(jammed or landed or self._jumpers or self._hook is not None)
        self._reader.stepped(vehicles, people, unsure=unsure)
        new_vehicles = ["v:" + name for name in (*vehicles, *landed)]
        self.spawned = frozenset([*new_vehicles, *("p:" + name for name in people)])
        # 3. Mishaps. SUMO lists a collision in every step that it lasts: only new pairs count,
        #    whichever of them SUMO blames.
        self.teleports = len(jammed)
        hits = simulation.getCollisions()
        pairs = frozenset(frozenset((hit.collider, hit.victim)) for hit in hits)
        teleports, collisions = self.mishaps
        new_pairs = len(pairs - self._colliding)
        self.mishaps = teleports + self.teleports, collisions + new_pairs
        self._colliding = pairs
        for name in sorted(jammed):
            try:
                edges, now = libsumo.vehicle.getRoute(name), libsumo.vehicle.getRouteIndex(name)
            # It was taken out of the street for good.
            except libsumo.TraCIException:
                edges, now = (), 0
            # SUMO has put it onto the next edge of its route already.
            place = f" on edge {edges[max(0, now - 1)]}" if edges else ""
            message = "jam: SUMO teleported %s, which stood too long%s, at %.1f s"
            log.warning(message, name, place, self.time_s())

    def rebuild(self, seed: int) -> None:
        """Start the scenario again from its beginning with another seed."""
        # A drain step: libsumo can crash when it is loaded over pending commands.
        self._guarded(libsumo.simulationStep)
        self._options = replace(self._options, settings=replace(self._options.settings, seed=seed))
        self._reader.forget()
        self.pilot.forget()
        self.buttons.forget()
        self._reset_counts()
        # `load` takes options alone, where `start` wants the program's name before them.
        self._guarded(lambda: libsumo.load(self._options.arguments()[1:]))
        # Another object: what a hook has learned is of the run that is over.
        self._hook = self._new_hook()

    def _new_hook(self) -> StepHook | None:
        return StepHook(self._options.hook, libsumo) if self._options.hook else None

    def time_s(self) -> float:
        """Simulated seconds since the scenario's beginning."""
        return float(libsumo.simulation.getTime())

    def actors(self, near_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """All within `radius_m` of any of the chairs (n, 2), sorted by id; for once a step."""
        return self._reader.near(near_W_m, radius_m)

    def actors_at(self, place_W_m: F64, radius_m: float) -> tuple[ActorState, ...]:
        """The same around a place (1, 2), for a single look."""
        return self._reader.at(place_W_m, radius_m)

    def everyone(self) -> tuple[ActorState, ...]:
        """Every vehicle and person of the town, sorted by id."""
        return self.actors_at(np.zeros((1, 2)), math.inf)

    def turn_away(self, actor_id: str) -> bool:
        """Take an actor off the street that SUMO has put on top of somebody; whether it could."""
        # JuPedSim goes on with people who have been removed: SUMO 1.28 dies of it in the next step.
        if self._by_jupedsim and actor_id.startswith("p:"):
            return False
        self.pilot.turn_away(actor_id)
        self._reader.forget_actor(actor_id)
        return True

    def counts(self) -> tuple[int, int]:
        """Vehicles and persons that are in the street now."""
        return len(libsumo.vehicle.getIDList()), len(libsumo.person.getIDList())

    def signals(self, near_W_m: F64, radius_m: float) -> tuple[SignalState, ...]:
        """The colours of all traffic lights with a stop line so near to any point, by id."""
        return self._signals.near(near_W_m, radius_m)

    def close(self) -> None:
        """End SUMO; a second call does nothing."""
        if self._open:
            self._open = False
            libsumo.close()
            self.warnings.read()

    def _guarded(self, call: Any) -> None:
        """Run a libsumo call and turn its exceptions into SumoError."""
        try:
            call()
        except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
            raise SumoError(
                f"SUMO stopped on {self._options.sumocfg}: {str(error).strip()[:300]}; "
                "open it in sumo-gui for details"
            ) from None


def world_in_this_process() -> bool:
    """Whether a SUMO simulation is loaded in this process."""
    return bool(libsumo.isLoaded())


def refuse_second_world() -> None:
    """Raise WorldInUseError while a simulation is loaded in this process."""
    if world_in_this_process():
        raise WorldInUseError(
            "this process already has a SUMO world, and libsumo allows one per process; "
            "close it first, or open this world in a process of its own (wcsim.server.links.socket)"
        )


def sumo_seed(seed: int) -> int:
    """SUMO's own seed in a world with this one."""
    return seeding.derive_seed(seed, "sumo")


def open_session(
    town: Town, config: RunConfig, seed: int, place: RunPlace, net_z_m: float, held: ExitStack
) -> tuple[Scenario, SumoSession]:
    """Start SUMO for a world with this seed.

    `held` ends it, `net_z_m` is the net's own height of W's z = 0.

    Raises:
        TownError: The scenario cannot be run.
        WorldInUseError: Another session lives in this process.
    """
    settings = Settings(world=config.world, seed=sumo_seed(seed))
    scenario = open_scenario(town, settings, place, held)
    options = SumoOptions(
        sumocfg=scenario.sumocfg,
        origin_m=town.file.origin_m,
        settings=settings,
        z_origin_m=net_z_m,
        author_scale=scenario.author_scale,
        warnings=scenario.warnings,
        hook=place.hook,
    )
    return scenario, held.enter_context(SumoSession(options))


def warmup_s(town: Town, config: RunConfig) -> float:
    """How long the traffic runs before a world starts: as set, as in the town's file, or usual."""
    if config.world.warmup_s is not None:
        return config.world.warmup_s
    return _WARMUP_S if town.file.warmup_s is None else town.file.warmup_s


def warm_up(sumo: SumoSession, for_s: float, tick_s: float) -> None:
    """Let the traffic run alone."""
    for _ in range(round(for_s / tick_s)):
        sumo.step()
