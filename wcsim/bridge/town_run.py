"""Lets a town's traffic run with wheelchairs that their users drive, records and checks it.

Without a wheelchair it is SUMO alone, for which no street has to be built.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import count, islice
from pathlib import Path

import numpy as np

from wcsim.bridge.sumo.session import open_session, refuse_second_world, warmup_s
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import RolloutStep, rollout
from wcsim.config import ChairConfig, RunConfig
from wcsim.core.closing import ClosingContextBase
from wcsim.errors import SumoError
from wcsim.log.fingerprint import make_software_fingerprint
from wcsim.log.records import Header, world_state_from_snapshot
from wcsim.log.writer import TRACE, LogWriter
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.rewards import judge_crash_fault
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.scenario.stage import Scenario, files_of
from wcsim.towns.scenario.town import Town
from wcsim.towns.street import load_street
from wcsim.towns.sumo.net import read_net
from wcsim.types import F64, ActorState, SeatSpec, Snapshot
from wcsim.types.episode import RunPlace
from wcsim.users.recordings.recorded_user import find_user

# Within a tick a chair drives on, and actors pass the edge of its surroundings.
_BORDER_M = 3.0
# A recorded town is rounded to an eighth of a millimetre, which packs five times as tight.
_GRID_M = 2.0**-13
Progress = Callable[[int, int], None]  # (ticks done, all ticks)
Stage = Callable[[str], None]  # what starts now, in words


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOrder:
    """What to run."""

    seconds: float
    seed: int
    chairs: int
    folder: Path
    outputs: tuple[str, ...] = ()
    hook: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class CrashFact:
    """A crash of a wheelchair."""

    seat: int
    reason: str  # as in `Events`
    time_s: float  # SUMO's own time
    at_m: tuple[float, float]  # in the net's coordinates
    fault: str  # own or other
    told: str  # as `Events.crash`


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficFacts:
    """What happened."""

    ticks: int
    begin_s: float  # SUMO's own time
    end_s: float
    vehicles: int  # different ones that were in the street
    persons: int
    mirrored: int  # different ones that were near a wheelchair
    mirrored_most: int  # at once
    teleports: int  # since the scenario began
    teleports_warming: int  # of these while the traffic warmed up, before the first tick
    # That SUMO saw among its own since the scenario began, each once however long it lasts.
    collisions: int
    collisions_warming: int  # of these while the traffic warmed up
    episodes: int
    crashes: int  # of wheelchairs
    crashed: tuple[CrashFact, ...] = ()  # the same, one by one
    warnings: int = 0  # SUMO's own, since the scenario began
    warned: tuple[str, ...] = ()  # the first of each kind


def record_town(
    town: Town,
    config: RunConfig,
    order: RecordOrder,
    opened: Callable[[Scenario], None],
    progress: Progress = lambda done, ticks: None,
    stage: Stage = lambda text: None,
) -> TrafficFacts:
    """Run and record a town; without a chair no street is built.

    Args:
        town: The town.
        config: Its world and chairs.
        order: What to run; `folder` gets a trace, and SUMO's outputs in its subfolder sumo/.
        opened: Called once the scenario runs, before the first tick.
        progress: Called after every tick.
        stage: Called with what starts now, before anything that may take long.

    Raises:
        TownError: the scenario cannot be run.
        SumoError: the mirror shows somebody who is not there, or misses somebody who is.
    """
    place = RunPlace(folder=order.folder, outputs=order.outputs, hook=order.hook)
    ticks = round(order.seconds / config.world.tick_s)
    stage(f"reading the scenario files of {town.name}")
    files_of(town, config)
    with ExitStack() as held:
        world: World | _TownTraffic
        if order.chairs:
            validate_net(town.net, border=town.border)
            load_street(town, stage)
            spec = SeatSpec(profile=config.env.profile, max_steps=config.env.max_steps)
            stage(f"starting SUMO; traffic warm-up of {warmup_s(town, config):g} s")
            specs = (spec,) * order.chairs
            world = World(town, config, specs, order.seed, place, find_user=find_user)
            held.enter_context(world)
            steps, net_z_m = rollout(world), world.street.net_origin_m[2]
        else:
            stage("starting SUMO")
            world = held.enter_context(_TownTraffic(town, config, order.seed, place))
            steps, net_z_m = world.steps(), world.net_z_m
        opened(world.scenario)
        header = Header(
            town=town.name,
            seed=order.seed,
            tick_s=config.world.tick_s,
            seats=order.chairs,
            fingerprint=make_software_fingerprint(),
            origin_m=town.file.origin_m,
            origin_z_m=net_z_m,
            chair_box_m=chair_box_m(config.chair),
        )
        writer = held.enter_context(LogWriter(order.folder / TRACE, header))
        meter = _Meter(world, town, config)
        for done, step in enumerate(islice(steps, ticks), start=1):
            everyone = world.sumo.everyone()
            actors = as_recorded(step.after, everyone)
            writer.append(world_state_from_snapshot(step.after, step.commands, actors))
            meter.add(step.after, everyone)
            progress(done, ticks)
        facts = meter.facts(ticks, order.chairs)
    # SUMO writes the last of its warnings when it ends.
    log = world.sumo.warnings
    return replace(facts, warnings=log.count, warned=tuple(log.first.values()))


def chair_box_m(chair: ChairConfig) -> tuple[float, float]:
    """What a header has of the wheelchairs: their length, and their middle ahead of the axle."""
    outline = plant_spec(chair).outline
    return outline.length_m, outline.middle_x_m


def as_recorded(snapshot: Snapshot, everyone: Sequence[ActorState]) -> list[ActorState]:
    """Everybody in town: near a wheelchair as it sees them, in all pieces, elsewhere as in SUMO.

    Places and speeds are rounded.
    """
    shown: dict[str, list[ActorState]] = {}
    for actor in snapshot.actors:
        shown.setdefault(actor.whole_id, []).append(actor)
    return [
        replace(
            piece,
            p_W_m=np.round(piece.p_W_m / _GRID_M) * _GRID_M,
            v_W_mps=np.round(piece.v_W_mps / _GRID_M) * _GRID_M,
            yaw_rad=round(piece.yaw_rad / _GRID_M) * _GRID_M,
        )
        for actor in everyone
        for piece in shown.get(actor.id, (actor,))
    ]


class _TownTraffic(ClosingContextBase):
    """SUMO with a town's scenario, as a world without seats, but without its street."""

    def __init__(self, town: Town, config: RunConfig, seed: int, place: RunPlace) -> None:
        """Start SUMO and let the traffic warm up.

        Raises:
            TownError: The scenario cannot be run.
            WorldInUseError: A world lives in this process.
        """
        refuse_second_world()
        validate_net(town.net, border=town.border)
        self.net_z_m = read_net(town.net, town.file.origin_m).z_origin_m
        self._held = ExitStack()
        try:
            where = place, self.net_z_m, self._held
            self.scenario, self.sumo = open_session(town, config, seed, *where)
        except BaseException:
            self.close()
            raise
        self.snapshot = self._published(0)

    def steps(self) -> Iterator[RolloutStep]:
        """Carry the traffic on as `rollout` does; without a chair no actor is near one."""
        for tick in count(1):
            self.sumo.step()
            self.snapshot = self._published(tick)
            yield RolloutStep(commands=(), after=self.snapshot)

    def close(self) -> None:
        """End SUMO; a second call does nothing."""
        self._held.close()

    def _published(self, tick: int) -> Snapshot:
        time_s = self.sumo.time_s()
        bare = Snapshot(epoch=0, tick=tick, time_s=time_s, actors=(), signals=(), clients=())
        return replace(bare, state_hash=bare.digest())


def _check_mirrored(
    mirrored: Sequence[ActorState], everyone: Sequence[ActorState], chairs_W_m: F64, radius_m: float
) -> None:
    """Compare who is mirrored with who SUMO has near the chairs (n, 2).

    Raises:
        SumoError: a ghost, mirrored but not there, or somebody there who is not mirrored.
    """
    shown = {actor.id for actor in mirrored if not actor.piece}
    there = {actor.id for actor in everyone}
    near = set()
    for actor in everyone:
        gap_m = float(np.hypot(*(chairs_W_m - actor.p_W_m[:2]).T).min(initial=np.inf))
        if gap_m + 0.5 * actor.size_lwh_m[0] < radius_m - _BORDER_M:
            near.add(actor.id)
    ghosts, missing = sorted(shown - there), sorted(near - shown)
    if ghosts or missing:
        raise SumoError(
            "the mirror differs from SUMO: "
            f"mirrored but not in SUMO: {', '.join(ghosts[:5]) or 'none'}; "
            f"in SUMO but not mirrored: {', '.join(missing[:5]) or 'none'}; "
            "this is a bug of wcsim: report it"
        )


class _Meter:
    """Counts what is in the facts, and checks the mirror of a world with chairs."""

    def __init__(self, world: World | _TownTraffic, town: Town, config: RunConfig) -> None:
        self._world, self._origin_m, self._config = world, town.file.origin_m, config
        self._begin_s, self._warming = world.snapshot.time_s, world.sumo.mishaps
        self._crashed: list[CrashFact] = []
        self._seen: set[str] = set()
        self._mirrored: set[str] = set()
        self._most = self._ended = 0

    def add(self, after: Snapshot, everyone: Sequence[ActorState]) -> None:
        """One tick. Raises SumoError as `_check_mirrored`."""
        clients = after.clients
        ended = sum(client.first is not None for client in clients)
        # A chair that was moved sees others now.
        if clients and not ended:
            places_W_m = np.array([client.plant.p_WB_m[:2] for client in clients])
            _check_mirrored(after.actors, everyone, places_W_m, self._config.world.mirror_radius_m)
        mirrored = [actor.id for actor in after.actors if not actor.piece]
        self._seen.update(actor.id for actor in everyone)
        self._mirrored.update(mirrored)
        self._most = max(self._most, len(mirrored))
        self._ended += ended
        for client in clients:
            if not client.events.crashed:
                continue
            x_m, y_m = (client.plant.p_WB_m[:2] + self._origin_m).tolist()
            reason = client.events.crash_reason
            crash = CrashFact(
                seat=client.seat,
                reason=reason,
                time_s=after.time_s,
                at_m=(round(x_m, 2), round(y_m, 2)),
                fault=judge_crash_fault(reason, client.contacts, self._config.reward),
                told=client.events.crash,
            )
            self._crashed.append(crash)

    def facts(self, ticks: int, chairs: int) -> TrafficFacts:
        """The sums."""
        teleports, collisions = self._world.sumo.mishaps
        persons = sum(name.startswith("p:") for name in self._seen)
        return TrafficFacts(
            ticks=ticks,
            begin_s=self._begin_s,
            end_s=self._world.snapshot.time_s,
            vehicles=len(self._seen) - persons,
            persons=persons,
            mirrored=len(self._mirrored),
            mirrored_most=self._most,
            teleports=teleports,
            teleports_warming=self._warming[0],
            collisions=collisions,
            collisions_warming=self._warming[1],
            episodes=self._ended + chairs,
            crashes=len(self._crashed),
            crashed=tuple(self._crashed),
        )
