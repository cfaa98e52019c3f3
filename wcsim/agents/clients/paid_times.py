"""What sharing a world costs each client of a run: its waits for others, and where its time went.

Saved in the run folder as waits.json, over all lives of all processes and over `wcsim resume`. What
a process did in the half second before it was killed is not in it, nor the last minute of a
launcher that was.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final, Self

from wcsim.agents.runs.run_folder import read_run_json
from wcsim.core import files
from wcsim.errors import DiskFullError, PolicyError
from wcsim.server.launch.states import ClientStatusReport, LaunchProcessStates, WorldStatusReport

WAITS: Final = "waits.json"
SAVE_EVERY_S: Final = 60.0  # a launcher that is killed loses so much at most


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientTimeTotals:
    """Where a client's time went, in seconds."""

    acting_s: float = 0.0
    learning_s: float = 0.0
    overlap_s: float = 0.0  # of that, while it waited
    world_s: float = 0.0  # waiting for the world's own work
    others_s: float = 0.0  # waiting for other clients, and for messages

    @property
    def waiting_s(self) -> float:
        """Waiting in which nothing else was done."""
        return max(0.0, self.world_s + self.others_s - self.overlap_s)

    def plus(self, now: Self, before: Self) -> Self:
        """This, and what has been added from `before` to `now`, two readings of one life."""
        names = [each.name for each in fields(self)]
        return type(self)(
            **{k: getattr(self, k) + getattr(now, k) - getattr(before, k) for k in names}
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupRunTimes:
    """The times of all clients; `waited_s` by the one that waited, then by the awaited one."""

    clients: dict[str, ClientTimeTotals]
    waited_s: dict[str, dict[str, float]]


def read_group_run_times(run: Path) -> GroupRunTimes | None:
    """The times of a run; None for an older one. Raises PolicyError when they are damaged."""
    if not (run / WAITS).is_file():
        return None
    data = read_run_json(run, WAITS)
    try:
        clients = {
            name: ClientTimeTotals(**_seconds(shares)) for name, shares in data["clients"].items()
        }
        waited_s = {name: _seconds(row) for name, row in data["waited_s"].items()}
        return GroupRunTimes(clients=clients, waited_s=waited_s)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise PolicyError(
            f"{run / WAITS}: is damaged ({str(error)[:80]}); expected the file as a run wrote it: "
            "remove it to count from zero"
        ) from None


class GroupRunTimesFile:
    """Adds up the status messages of the processes of a launch, life by life."""

    def __init__(self, run: Path) -> None:
        """Go on with what a run folder holds. Raises PolicyError when that is damaged."""
        self._run = run
        self.times = read_group_run_times(run) or GroupRunTimes(clients={}, waited_s={})
        self._last: dict[
            str, tuple[int, ClientTimeTotals]
        ] = {}  # process and reading of each client
        self._saved_s = 0.0
        self._world_pid = 0
        # What the world of now has reported, by the client that waited and the awaited one.
        self._world_waits_s: dict[tuple[str, str], float] = {}

    def add(self, state: LaunchProcessStates) -> None:
        """Add what has been spent since the last call."""
        for client in state.clients:
            if client.status is not None:
                self._add_shares(client.name, client.status)
        # Without a process these are the last messages of a dead world.
        if state.world is not None and state.world_pid:
            self._add_waits(state.world_pid, state.world)

    def save_each(self, now_s: float) -> None:
        """Save to the run folder once in `SAVE_EVERY_S`; `now_s` are seconds since the start."""
        if now_s - self._saved_s >= SAVE_EVERY_S:
            self._saved_s = now_s
            self.save()

    def save(self) -> None:
        """Save to the run folder, unless the disk is full: what is learned is of more weight."""
        if self.times.clients:
            with suppress(DiskFullError):
                files.write_json(self._run / WAITS, asdict(self.times))

    def _add_shares(self, name: str, status: ClientStatusReport) -> None:
        now = ClientTimeTotals(
            acting_s=status.inference_s,
            learning_s=status.learning_s,
            overlap_s=status.overlap_s,
            world_s=status.simulation_s,
            others_s=status.barrier_s,
        )
        last_pid, before = self._last.get(name, (status.pid, ClientTimeTotals()))
        # A process counts from zero.
        if status.pid != last_pid:
            before = ClientTimeTotals()
        sums = self.times.clients.get(name, ClientTimeTotals())
        self.times.clients[name] = sums.plus(now, before)
        self._last[name] = status.pid, now

    def _add_waits(self, pid: int, world: WorldStatusReport) -> None:
        """Add the waits that a world reports.

        It forgets the waits of those who left, but not the waits for them: these go on when they
        are back.
        """
        if pid != self._world_pid:
            self._world_pid = pid
            self._world_waits_s = {}
        last_s = {
            pair: seconds
            for pair, seconds in self._world_waits_s.items()
            if pair[0] in world.members
        }
        now_s = {
            (waiter, awaited): seconds
            for waiter, row in zip(world.members, world.waited_s, strict=False)
            for awaited, seconds in zip(world.members, row, strict=False)
            if waiter != awaited
        }
        for (waiter, awaited), seconds in now_s.items():
            was_s = last_s.get((waiter, awaited), 0.0)
            more_s = seconds - was_s if seconds >= was_s else seconds
            row = self.times.waited_s.setdefault(waiter, {})
            row[awaited] = round(row.get(awaited, 0.0) + more_s, 2)
        self._world_waits_s = last_s | now_s


def _seconds(row: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in row.items()}
