"""A given number of faults, spread over a run: so many kills and stops, of clients, masters and worlds, by a seed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.soak.faults import TOLD_S, WORLD, Fault, Striker, What
from wcsim.core import seeding
from wcsim.server.launch.states import LaunchProcessStates

_TARGETS = (("client", 0.6), ("master", 0.2), (WORLD, 0.2))
_STOP_LEASES = (0.4, 1.8)  # a stopped client wakes after so many leases: half of them find that they were given up
_FIRST, _LAST = 0.05, 0.9  # shares of the run between which faults come
_GAP_S = 5.0  # least time between two faults
_PATIENCE_S = 90.0  # the next fault comes although somebody is still away


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultOrder:
    """What is to be done, and how it is spread."""

    kills: int
    stops: int
    lease_s: float
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovered:
    """How long a fault was felt."""

    fault: Fault
    after_s: float  # to the first word of two more ticks than were heard of in the first TOLD_S, or of a new epoch
    ticks: int  # that the world had done in its epoch, and does again to recover by replay


class PlannedFaults:
    """Does what was planned, one fault after the other, each when everybody is there; see the module's text."""

    def __init__(self, order: FaultOrder, progress: Callable[[LaunchProcessStates], float]) -> None:
        """`progress` says how much of the run is over, 0..1."""
        self._rng = seeding.make_rng(order.seed, "planned faults")
        self._lease_s, self._progress, self._most = order.lease_s, progress, 0.0
        kill: What = "kill"
        stop: What = "stop"
        deck = [(self._target(), what) for what in (*([kill] * order.kills), *([stop] * order.stops))]
        self.planned = tuple(deck[int(k)] for k in self._rng.permutation(len(deck)))
        self._striker = Striker()
        self._felt: tuple[Fault, tuple[int, int]] | None = None  # a fault, and epoch and tick that it struck at
        self.recovered: list[Recovered] = []

    @property
    def faults(self) -> list[Fault]:
        """What was done so far."""
        return self._striker.faults

    def wake_all(self) -> None:
        """Let every stopped process go on."""
        self._striker.wake(float("inf"))

    def act(self, state: LaunchProcessStates) -> None:
        """Do what is due now; called a few times a second."""
        now_s = time.monotonic()
        self._striker.wake(now_s)
        self._watch(state, now_s)
        self._most = max(self._most, self._progress(state))
        done = len(self.faults)
        if state.stopping or done >= len(self.planned):
            return
        due = _FIRST + (_LAST - _FIRST) * (done + 0.5) / len(self.planned)
        last_s = self.faults[-1].time_s if self.faults else 0.0
        if self._most < due or now_s - last_s < _GAP_S or state.world is None or state.world_standing != "running":
            return
        all_here = len(state.world.members) == sum(c.standing not in ("done", "given up") for c in state.clients)
        if (all_here and self._felt is None) or now_s - last_s > _PATIENCE_S:
            self._strike(state, self.planned[done], now_s)

    def _target(self) -> str:
        """Whom a fault is for."""
        return _TARGETS[int(self._rng.choice(len(_TARGETS), p=[share for _, share in _TARGETS]))][0]

    def _strike(self, state: LaunchProcessStates, plan: tuple[str, What], now_s: float) -> None:
        world, (who, what) = state.world, plan
        if world is None or not world.members:
            return
        self._felt = None
        base = (world.epoch, world.tick)
        if who == WORLD:
            fault = Fault(time_s=now_s, what=what, who=WORLD, others=world.members)
            self._striker.strike(fault, state.world_pid)
        else:
            there = [c for c in state.clients if c.pid and c.name in world.members]
            chosen = [c for c in there if (c.name == world.master) == (who == "master")] or there
            if not chosen:
                return
            client = chosen[int(self._rng.integers(len(chosen)))]
            others = tuple(name for name in world.members if name != client.name)
            is_master = client.name == world.master
            fault = Fault(time_s=now_s, what=what, who=client.name, master=is_master, others=others)
            low, high = _STOP_LEASES
            wakes_s = self._lease_s * float(self._rng.uniform(low, high)) if what == "stop" else None
            self._striker.strike(fault, client.pid, wakes_s)
        self._felt = (fault, base) if fault.others else None

    def _watch(self, state: LaunchProcessStates, now_s: float) -> None:
        """Whether the last fault was got over."""
        world = state.world
        if self._felt is None or world is None or state.world_standing != "running":
            return
        fault, base = self._felt
        here = (world.epoch, world.tick)
        if now_s - fault.time_s < TOLD_S:  # this may be word from before the fault
            self._felt = fault, max(base, here)
            return
        epoch, tick = base
        made_again = fault.who == WORLD and world.ticks == 0  # up to where it was, and nobody has gone on yet
        if not made_again and ((here[0] > epoch and here[1] > 0) or (here[0] == epoch and here[1] >= tick + 2)):
            self.recovered.append(Recovered(fault=fault, after_s=now_s - fault.time_s, ticks=tick))
            self._felt = None
