"""Real processes under faults at random, then the proof that no step was lost: `python -m benchmarks soak`.

A world with its simulators, clients without learners, one launcher. Faults come one after another for most of the time,
then it is calm, so that memory can be watched. What is measured comes from what the clients wrote down (when they saw
which frame), their ledgers, and the world's journal.
"""

from __future__ import annotations

import math
import secrets
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.soak.faults import WORLD, Chaos, Fault
from benchmarks.soak.growth import GrowthLog, LongRun, SettledPace, Slope, long_run, predicted_s
from benchmarks.soak.stub_client import StubSight, read_sights
from wcsim.config import RunConfig
from wcsim.core.own_folder import create_runtime_folder, world_endpoint_from_folder
from wcsim.log.reader import iter_journal_inputs
from wcsim.log.writer import JOURNAL
from wcsim.server.launch.launcher import ProcessLauncher
from wcsim.server.launch.states import ClientLaunchPlan, LauncherTimeouts, LaunchProcessStates, LaunchResult
from wcsim.server.ledger import LedgerAuditResult, audit_ledgers, iter_ledger_frames
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import SeatRequest, WorldProcessSpec, encode_json_line, make_world_launch_plan
from wcsim.types import SeatSpec
from wcsim.users.profiles import filter_user_file_names

_LEASE_S = 3.0
_CALM_SHARE = 0.25  # of the time, at the end
_LEAST_CALM_S = 11.0  # beyond a lease
_WORLD_LEASE_S = 6.0  # longer than any step, and than a pause
_WAITED_LEASES = 3.0  # for clients that are stopped one after the other while the world is not there
_NOTICED_S = 2.0  # after a lease, till the others have gone on
_MADE_AGAIN_S = 30.0  # for a world that died to be started again


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakOrder:
    """What to soak."""

    town: str
    config: RunConfig
    seconds: float
    folder: Path  # run folder
    clients: int = 3
    seed: int = 0
    lease_s: float = _LEASE_S


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryBars:
    """What 99 % of the recoveries have to be below, in seconds, by what was hit."""

    client_s: float
    world_s: float
    overlap_s: float  # any of them may be the world's, and it may wait for a client that is stopped


def recovery_bars(order: SoakOrder) -> RecoveryBars:
    """The bars of a soak: a client is given up after its lease."""
    waits_s = _WAITED_LEASES * max(0.0, order.lease_s - _LEASE_S)
    return RecoveryBars(client_s=order.lease_s + _NOTICED_S, world_s=_MADE_AGAIN_S, overlap_s=_MADE_AGAIN_S + waits_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryTimes:
    """Seconds from each fault to the others' next tick; empty where there was no such fault."""

    client_s: tuple[float, ...]
    world_s: tuple[float, ...]
    overlap_s: tuple[float, ...]  # of faults that struck while another one was being got over, and of those others
    rejoin_s: tuple[float, ...]  # until the client that was hit saw a frame again


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakFacts:
    """What a soak showed."""

    audit: LedgerAuditResult
    faults: tuple[Fault, ...]
    times: RecoveryTimes
    bars: RecoveryBars
    orphans: int
    leaked: int  # folders of shared memory
    memory: dict[str, Slope]  # MB, by process
    disk: Slope  # MB
    bounds: LongRun
    outcome: LaunchResult


def soak(order: SoakOrder, progress: Callable[[float], object] = lambda done_s: None) -> SoakFacts:
    """Run a soak; `progress` hears of the seconds that are over.

    Raises:
        WcsimError: The town or the configuration cannot be used.
    """
    names = [f"c{seat}" for seat in range(order.clients)]
    watch = _Watch(order, progress)
    with create_runtime_folder() as place:
        world = _server_order(order, place)
        plans = [_plan(order, world, name, seat, place) for seat, name in enumerate(names)]
        rules = LauncherTimeouts(world_lease_s=_WORLD_LEASE_S, client_lease_s=30.0)
        launcher = ProcessLauncher(
            make_world_launch_plan(world, place, order.folder / "logs" / "world.log"),
            plans,
            order.folder,
            rules,
            watch.show,
        )
        watch.launcher = launcher
        outcome = launcher.run()
    ledgers = [(seat, iter_ledger_frames(_ledger(order, name))) for seat, name in enumerate(names)]
    times = _recovery_times(watch.chaos.faults, {name: read_sights(_sights(order, name)) for name in names})
    return SoakFacts(
        audit=audit_ledgers(iter_journal_inputs(order.folder / JOURNAL), ledgers)[0],
        faults=tuple(watch.chaos.faults),
        times=times,
        bars=recovery_bars(order),
        orphans=watch.growth.orphans(),
        leaked=int(place.exists()),
        memory=watch.growth.memory,
        disk=watch.growth.disk,
        bounds=_bounds(order, watch, times),
        outcome=outcome,
    )


def _calm_s(seconds: float, lease_s: float = _LEASE_S) -> float:
    """How long nothing is done at the end of a soak, so that the last fault can be got over: of the world, too.

    >>> [_calm_s(seconds) for seconds in (15.0, 30.0, 1800.0)] == [7.5, 14.0, _CALM_SHARE * 1800.0]
    True
    """
    return max(_CALM_SHARE * seconds, min(_LEAST_CALM_S + lease_s, 0.5 * seconds))


def _recovery_times(faults: Sequence[Fault], sights: dict[str, list[StubSight]]) -> RecoveryTimes:
    """How long each fault was felt, by what was hit; one that struck while another was felt is a case of its own."""
    took = [recovery_s(fault, sights) for fault in faults]
    rejoined = [rejoin_s(fault, sights) for fault in faults]
    spans_s = [(f.time_s, f.time_s + (t or r or 0.0)) for f, t, r in zip(faults, took, rejoined, strict=True)]
    shared = overlapping(spans_s)
    known = [(f.who == WORLD, s, t) for f, s, t in zip(faults, shared, took, strict=True) if t is not None]
    return RecoveryTimes(
        client_s=tuple(t for is_world, is_shared, t in known if not is_world and not is_shared),
        world_s=tuple(t for is_world, is_shared, t in known if is_world and not is_shared),
        overlap_s=tuple(t for _, is_shared, t in known if is_shared),
        rejoin_s=tuple(filter(None, rejoined)),
    )


def recovery_s(fault: Fault, sights: dict[str, list[StubSight]]) -> float | None:
    """Seconds from a fault to the others' next tick that cannot have been under way already; None without others.

    The tick that was waited for, or being done, at the time of the fault may still reach the others: two ticks more
    than anybody had seen is one that was done without the client that was hit, or after it.
    """
    before = [s for seen in sights.values() for s in seen if s.time_s <= fault.time_s]
    if not before or not fault.others:
        return None
    newest = max((s.epoch, s.tick) for s in before)
    after = [
        s.time_s
        for name, seen in sights.items()
        if name in fault.others
        for s in seen
        if s.time_s > fault.time_s and (s.epoch > newest[0] or (s.epoch == newest[0] and s.tick >= newest[1] + 2))
    ]
    return min(after) - fault.time_s if after else None


def overlapping(spans_s: Sequence[tuple[float, float]]) -> tuple[bool, ...]:
    """Which of these spans of time (begin, end) share a moment with another one."""
    shared, last = [False] * len(spans_s), -1  # the one that ends last of those begun
    for k in sorted(range(len(spans_s)), key=lambda k: spans_s[k]):
        begin, end = spans_s[k]
        if last >= 0 and begin < spans_s[last][1] and spans_s[last][0] < end:
            shared[k] = shared[last] = True
        if last < 0 or end > spans_s[last][1]:
            last = k
    return tuple(shared)


def rejoin_s(fault: Fault, sights: dict[str, list[StubSight]]) -> float | None:
    """Seconds from a fault until the client that was hit saw a frame again, where it has to join for that."""
    if fault.who == WORLD or fault.what == "pause":
        return None
    after = [s.time_s for s in sights[fault.who] if s.time_s > fault.time_s]
    return min(after) - fault.time_s if after else None


class _Watch:
    """What happens while the launcher runs: faults, samples of memory, the end."""

    def __init__(self, order: SoakOrder, progress: Callable[[float], object]) -> None:
        self.chaos, self.growth = Chaos(order.seed, math.inf, order.lease_s), GrowthLog(order.folder)
        self.launcher: ProcessLauncher | None = None
        self.pace = SettledPace()
        self._end_s = math.inf  # known from the first tick on: a world may take its time to load
        self._seconds, self._progress = order.seconds, progress
        self._calm_s = _calm_s(order.seconds, order.lease_s)

    def show(self, state: LaunchProcessStates) -> None:
        """Called a few times a second."""
        now_s = time.monotonic()
        if self._end_s == math.inf and state.world is not None and state.world.ticks > 0:
            self._end_s = now_s + self._seconds
            self.chaos.until_s = self._end_s - self._calm_s
        self._progress(max(0.0, min(self._seconds, self._seconds - (self._end_s - now_s))))
        self.growth.look(state, now_s)  # before a fault: who is dead holds nothing
        self.pace.look(state, now_s)
        self.chaos.act(state)
        if now_s > self._end_s and self.launcher is not None and not state.stopping:
            self.chaos.wake_all()
            self.launcher.stop()


def _bounds(order: SoakOrder, watch: _Watch, times: RecoveryTimes) -> LongRun:
    """For a run of many hours."""
    epoch_h = (order.config.epoch_ticks or math.inf) / max(watch.pace.ticks_per_s, 1e-3) / 3600.0
    return long_run(watch.growth.memory, watch.growth.disk, epoch_h, predicted_s(times.world_s))


def _server_order(order: SoakOrder, place: Path) -> WorldProcessSpec:
    rules = ServerRules(
        capacity=order.clients,
        config=order.config.world_digest(),
        expected=order.clients,
        lease_s=order.lease_s,
        recordings=filter_user_file_names([order.config.env.profile]),
    )
    return WorldProcessSpec(
        town=order.town,
        config=order.config,
        seed=order.seed,
        rules=rules,
        endpoint=world_endpoint_from_folder(place),
        ring=str(place),
        name="soak",
        run=str(order.folder),
        epoch_ticks=order.config.epoch_ticks,
    )


def _plan(order: SoakOrder, world: WorldProcessSpec, name: str, seat: int, place: Path) -> ClientLaunchPlan:
    join = SeatRequest(
        endpoint=world.endpoint,
        name=name,
        claim=secrets.token_hex(16),
        spec=SeatSpec(profile=order.config.env.profile, max_steps=300),
        seat=seat,
        config=world.rules.config,
        ledger=str(_ledger(order, name)),
    )
    file = place / f"{name}.json"
    file.write_bytes(encode_json_line(join))
    argv = (sys.executable, "-m", "benchmarks.soak.stub_client", str(file), "--sights", str(_sights(order, name)))
    return ClientLaunchPlan(name=name, seat=seat, argv=argv, log=order.folder / "logs" / f"{name}.log")


def _ledger(order: SoakOrder, name: str) -> Path:
    return order.folder / "ledgers" / f"{name}.ledger"


def _sights(order: SoakOrder, name: str) -> Path:
    return order.folder / f"{name}.sights"
