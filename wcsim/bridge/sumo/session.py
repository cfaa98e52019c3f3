"""SUMO inside this process: the only file that speaks to libsumo.

libsumo holds one simulation a process; a second `start` silently resets the first one, so a session
refuses to start while another one is loaded. Whole-world reset is one drain step, then
`libsumo.load` (bit-identical; `loadState` is not). Nothing but `ActorState` and `SignalState`
leaves this file.

`open_session` starts it with the scenario of a town, staged and tried out. A session begins when
its traffic has warmed up: from a saved state (`warm_state.py`), or by ticks where a scenario's
states cannot be loaded.
"""

import locale
import logging
import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from wcsim.bridge.sumo.actors import ActorReader, SignalReader
from wcsim.bridge.sumo.open_scenario import open_scenario, try_state
from wcsim.bridge.sumo.signal_control import SignalControl
from wcsim.bridge.sumo.step_hook import HookChair, StepHook
from wcsim.bridge.sumo.vehicle_control import VehicleControl
from wcsim.bridge.sumo.warm_state import (
    COARSE_STEP_S,
    SAVING,
    coarse_warmup_s,
    mend_state,
    read_state,
    save_state,
    state_file,
)
from wcsim.config import RunConfig
from wcsim.config.world import JUPEDSIM
from wcsim.core import seeding
from wcsim.core.closing import ClosingContextBase
from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import SumoError, WorldInUseError
from wcsim.towns.scenario.overrides import JUMPING, PEOPLE, Settings, forced
from wcsim.towns.scenario.stage import Scenario
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.tools import UTF_8, missing_library
from wcsim.towns.sumo.warning_log import WarningLog
from wcsim.types import F64, ActorState, SignalState
from wcsim.types.episode import RunPlace

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
    warmup_s: float = 0.0
    digest: str = ""  # of a scenario whose states can be loaded

    def arguments(self, **more: str) -> list[str]:
        """The options of SUMO; all that follow the configuration override it, `more` the others."""
        values = dict(forced(self.settings, self.author_scale))
        values |= {name.replace("_", "-"): value for name, value in more.items()}
        pairs = ((f"--{name}", value) for name, value in values.items())
        return ["--configuration-file", str(self.sumocfg), *chain.from_iterable(pairs)]


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
        try:
            # `start` wants the program's name before the options, `load` takes these alone.
            self._begin(lambda words: libsumo.start(["sumo", *words]))
            self._signals = SignalReader(libsumo, options.origin_m)
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
        self._options = replace(self._options, settings=replace(self._options.settings, seed=seed))
        self._begin(self._load_anew)

    def _begin(self, load: Callable[[list[str]], object]) -> None:
        """Load the scenario, its traffic warmed up: from a state where there can be one."""
        options, tick_s = self._options, self._options.settings.world.tick_s
        coarse_s = coarse_warmup_s(options.warmup_s, tick_s) if options.digest else 0.0
        if not coarse_s:
            self._guarded(lambda: load(options.arguments()))
        else:
            place = state_file(options.digest, options.settings.seed, coarse_s)
            state = read_state(place)
            with create_temporary_folder() as folder:
                file = folder / "state.xml"
                # 1. Make the state where there is none.
                if state is None:
                    coarse = options.arguments(step_length=repr(COARSE_STEP_S), **SAVING)
                    self._guarded(lambda: load(coarse))
                    for _ in range(round(coarse_s / COARSE_STEP_S)):
                        self._guarded(libsumo.simulationStep)
                    self._guarded(lambda: libsumo.simulation.saveState(str(file)))
                    state, load = mend_state(file.read_bytes()), self._load_anew
                    save_state(place, state)
                # 2. Load it. SUMO leaves out a part of the saved people by a scale other than one,
                #    and dies of their absence; the scale of those who come is set afterwards.
                file.write_bytes(state)
                begin = options.arguments(scale="1", load_state=str(file))
                self._guarded(lambda: load(begin))
            scale = options.author_scale * options.settings.world.demand_scale
            if scale != 1.0:
                self._guarded(lambda: libsumo.simulation.setScale(scale))
        # 3. Forget what was of another run; a hook's object too, with what it has learned.
        self._reader.forget()
        self.pilot.forget()
        self.buttons.forget()
        self._reset_counts()
        people = libsumo.simulation.getOption(PEOPLE)
        self._jumpers, self._by_jupedsim = people == JUMPING, people == JUPEDSIM
        self._hook = StepHook(options.hook, libsumo) if options.hook else None
        # 4. The rest of the warm-up.
        for _ in range(round((options.warmup_s - coarse_s) / tick_s)):
            self.step()

    def _load_anew(self, words: list[str]) -> None:
        # A drain step: libsumo can crash when it is loaded over pending commands.
        libsumo.simulationStep()
        libsumo.load(words)

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
            if libsumo.isLoaded():
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
    """Start SUMO for a world with this seed, and let its traffic warm up.

    `held` ends it, `net_z_m` is the net's own height of W's z = 0.

    Raises:
        TownError: The scenario cannot be run.
        WorldInUseError: Another session lives in this process.
    """
    settings = Settings(world=config.world, seed=sumo_seed(seed))
    scenario = open_scenario(town, settings, place, held)
    for_s = warmup_s(town, config)
    # A hook takes part in the warm-up.
    is_saved = not place.hook and coarse_warmup_s(for_s, config.world.tick_s) > 0.0
    is_saved = is_saved and try_state(town, settings, scenario, for_s)
    options = SumoOptions(
        sumocfg=scenario.sumocfg,
        origin_m=town.file.origin_m,
        settings=settings,
        z_origin_m=net_z_m,
        author_scale=scenario.author_scale,
        warnings=scenario.warnings,
        hook=place.hook,
        warmup_s=for_s,
        digest=scenario.digest if is_saved else "",
    )
    return scenario, held.enter_context(SumoSession(options))


def warmup_s(town: Town, config: RunConfig) -> float:
    """How long the traffic runs before a world starts: as set, as in the town's file, or usual."""
    if config.world.warmup_s is not None:
        return config.world.warmup_s
    return _WARMUP_S if town.file.warmup_s is None else town.file.warmup_s
