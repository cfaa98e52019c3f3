"""Faults at random for real processes: which process is killed or stopped when, by a seed."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from dataclasses import dataclass
from typing import Literal

from wcsim.core import seeding
from wcsim.server.launch.states import ClientProcessState, LaunchProcessStates

WORLD = "world"
What = Literal["kill", "stop", "pause"]
# Shares of faults: a pause is shorter than any usual lease, a stop is longer.
_MENU: tuple[tuple[str, What, float], ...] = (
    ("client", "kill", 0.26),
    ("client", "stop", 0.14),
    ("client", "pause", 0.14),
    ("master", "kill", 0.14),
    ("master", "stop", 0.12),
    (WORLD, "kill", 0.10),
    (WORLD, "stop", 0.05),
    (WORLD, "pause", 0.05),
)
_FORWARD_TICKS = 5  # the world has gone on by so much before the next fault comes
TOLD_S = 0.8  # after a fault, until the world's word of how far it is cannot be from before
GAP_S = (0.5, 3.0)  # ... and then so long
_HASTE = 0.25  # share of faults on which the next one follows before anybody has got over them
_HASTE_GAP_S = (0.1, 2.5)
_PAUSE_S = (0.3, 1.5)
_STOP_LEASES = (4.0 / 3.0, 8.0 / 3.0)  # a stopped client wakes after so many, and finds that it was given up
PATIENCE_S = 60.0  # the next fault comes although nothing went on; no sooner than after two leases


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Something that was done to a process."""

    time_s: float  # of the monotonic clock
    what: What
    who: str  # name of a client, or WORLD
    master: bool = False
    others: tuple[str, ...] = ()  # clients that had a seat beside the one that was hit, and have to go on without it


class Striker:
    """Kills and stops processes, and wakes those that were stopped."""

    def __init__(self) -> None:
        self._wakes: list[tuple[float, int]] = []  # (when, process) of stopped ones
        self.faults: list[Fault] = []

    def strike(self, fault: Fault, pid: int, wakes_s: float | None = None) -> None:
        """Do it; what is stopped goes on after so long, or never."""
        _send(pid, signal.SIGKILL if fault.what == "kill" else signal.SIGSTOP)
        self.faults.append(fault)
        if wakes_s is not None:
            self._wakes.append((fault.time_s + wakes_s, pid))

    def wake(self, now_s: float) -> None:
        """Let those go on whose time has come."""
        for due_s, pid in self._wakes:
            if now_s >= due_s:
                _send(pid, signal.SIGCONT)
        self._wakes = [wake for wake in self._wakes if now_s < wake[0]]


class Chaos:
    """Does one fault after another; `act` is called a few times a second with the state of the processes."""

    def __init__(self, seed: int, until_s: float, lease_s: float) -> None:
        """Go on until this time of the monotonic clock; clients are given up after `lease_s`."""
        self._rng = seeding.make_rng(seed, "chaos")
        self.until_s, self._lease_s = until_s, lease_s
        self._striker = Striker()
        self._base = (-1, -1)  # epoch and tick at the last fault
        self._due_s: float | None = None

    @property
    def faults(self) -> list[Fault]:
        """What was done so far."""
        return self._striker.faults

    def act(self, state: LaunchProcessStates) -> None:
        """Do what is due now."""
        now_s = time.monotonic()
        self._striker.wake(now_s)
        if state.stopping or now_s > self.until_s or state.world is None or state.world_standing != "running":
            return
        here = (state.world.epoch, state.world.tick)
        if self.faults and now_s - self.faults[-1].time_s < TOLD_S:
            self._base = here
        new = here[0] > self._base[0]
        went_on = here[1] >= (0 if new else self._base[1]) + _FORWARD_TICKS
        last_s = self.faults[-1].time_s if self.faults else now_s
        if self._due_s is None and (went_on or now_s - last_s > max(PATIENCE_S, 2.0 * self._lease_s)):
            self._due_s = now_s + float(self._rng.uniform(*GAP_S))
        if self._due_s is not None and now_s >= self._due_s:
            hasty = self._rng.random() < _HASTE
            self._due_s = now_s + float(self._rng.uniform(*_HASTE_GAP_S)) if hasty else None
            self._base = here
            self._strike(state, now_s)

    def wake_all(self) -> None:
        """Let every stopped process go on."""
        self._striker.wake(float("inf"))

    def _strike(self, state: LaunchProcessStates, now_s: float) -> None:
        shares = [share for _, _, share in _MENU]
        who, what, _ = _MENU[int(self._rng.choice(len(_MENU), p=[share / sum(shares) for share in shares]))]
        seated = () if state.world is None else state.world.members
        if who == WORLD:
            self._do(what, state.world_pid, Fault(time_s=now_s, what=what, who=WORLD, others=seated))
            return
        master = "" if state.world is None else state.world.master
        there = [c for c in state.clients if c.pid and c.name in seated]
        chosen = [c for c in there if (c.name == master) == (who == "master")]
        if chosen:
            client: ClientProcessState = chosen[int(self._rng.integers(len(chosen)))]
            others = tuple(name for name in seated if name != client.name)
            fault = Fault(time_s=now_s, what=what, who=client.name, master=client.name == master, others=others)
            self._do(what, client.pid, fault)

    def _do(self, what: What, pid: int, fault: Fault) -> None:
        wakes_s = None
        if what == "pause":
            wakes_s = float(self._rng.uniform(*_PAUSE_S))
        elif what == "stop" and fault.who != WORLD:
            wakes_s = self._lease_s * float(self._rng.uniform(*_STOP_LEASES))
        self._striker.strike(fault, pid, wakes_s)


def _send(pid: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)
