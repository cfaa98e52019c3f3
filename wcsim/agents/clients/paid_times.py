"""What sharing a world costs each client of a run: who waited for whom, and where each one's time went.

Kept in the run folder as waits.json, over all lives of all processes and over `wcsim resume`. What a process did in the
half second before it was killed is not in it, nor the last minute of a launcher that was.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from wcsim.agents.runs.run_folder import read_json
from wcsim.core import files
from wcsim.errors import DiskFullError, PolicyError
from wcsim.server.launch.states import ClientState, ClientStatus, LaunchState, WorldStatus

WAITS = "waits.json"
SAVE_EVERY_S = 60.0  # a launcher that is killed loses so much at most


@dataclass(frozen=True, slots=True, kw_only=True)
class PaidShares:
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

    def plus(self, now: PaidShares, before: PaidShares) -> PaidShares:
        """This, and what has been added from `before` to `now`, two readings of one life."""
        names = [each.name for each in fields(self)]
        return PaidShares(
            **{k: getattr(self, k) + getattr(now, k) - getattr(before, k) for k in names}
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PaidTimes:
    """All of it, by client; `waited_s` by who waited, then for whom."""

    clients: dict[str, PaidShares]
    waited_s: dict[str, dict[str, float]]


def read_paid_times(run: Path) -> PaidTimes | None:
    """What a run folder holds of it; None for one that was made before. Raises PolicyError when it is damaged."""
    if not (run / WAITS).is_file():
        return None
    data = read_json(run, WAITS)
    try:
        clients = {name: PaidShares(**_seconds(shares)) for name, shares in data["clients"].items()}
        return PaidTimes(
            clients=clients, waited_s={who: _seconds(row) for who, row in data["waited_s"].items()}
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise PolicyError(
            f"{run / WAITS}: is damaged ({str(error)[:80]}); expected the file as a run wrote it: "
            "remove it to count from zero"
        ) from None


def _seconds(row: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in row.items()}


def _read_shares(status: ClientStatus) -> PaidShares:
    """A client's own reading of one life."""
    return PaidShares(
        acting_s=status.inference_s,
        learning_s=status.learning_s,
        overlap_s=status.overlap_s,
        world_s=status.simulation_s,
        others_s=status.barrier_s,
    )


class PaidTimesLog:
    """Adds up the status messages of the processes of a launch, life by life."""

    def __init__(self, run: Path) -> None:
        """Go on with what a run folder holds. Raises PolicyError when that is damaged."""
        self._run = run
        self.times = read_paid_times(run) or PaidTimes(clients={}, waited_s={})  # the sums of now
        self._last: dict[str, tuple[int, PaidShares]] = {}  # process and reading of each client
        self._saved_s = 0.0
        self._world_pid = 0
        self._pairs_s: dict[
            tuple[str, str], float
        ] = {}  # the same of its world, by who waited and for whom

    def add(self, state: LaunchState) -> None:
        """Take in how things are."""
        for client in state.clients:
            self._client(client)
        if (
            state.world is not None and state.world_pid
        ):  # without a process these are a dead world's last words
            self._pairs(state.world_pid, state.world)

    def save_each(self, now_s: float) -> None:
        """Leave it in the run folder when that was done a while ago; `now_s` are seconds since the begin."""
        if now_s - self._saved_s >= SAVE_EVERY_S:
            self._saved_s = now_s
            self.save()

    def save(self) -> None:
        """Leave it in the run folder, unless the disk is full: what is learned is of more weight."""
        if self.times.clients:
            with suppress(DiskFullError):
                files.write_json(self._run / WAITS, asdict(self.times))

    def _client(self, client: ClientState) -> None:
        if client.status is None:
            return
        pid, now = client.status.pid, _read_shares(client.status)
        last_pid, before = self._last.get(client.name, (pid, PaidShares()))
        if pid != last_pid:  # of another life
            before = PaidShares()
        self.times.clients[client.name] = self.times.clients.get(client.name, PaidShares()).plus(
            now, before
        )
        self._last[client.name] = pid, now

    def _pairs(self, pid: int, world: WorldStatus) -> None:
        """Add the waits that a world reports.

        It forgets what those have waited who left, but not for whom the others have: that goes on when they are back.
        """
        if pid != self._world_pid:
            self._world_pid, self._pairs_s = pid, {}
        last = {(who, whom): s for (who, whom), s in self._pairs_s.items() if who in world.members}
        now = _by_name(world)
        for (who, whom), seconds in now.items():
            was_s = last.get((who, whom), 0.0)
            row = self.times.waited_s.setdefault(who, {})
            row[whom] = round(
                row.get(whom, 0.0) + (seconds - was_s if seconds >= was_s else seconds), 2
            )
        self._pairs_s = last | now


def _by_name(world: WorldStatus) -> dict[tuple[str, str], float]:
    return {
        (who, whom): seconds
        for who, row in zip(world.members, world.waited_s, strict=False)
        for whom, seconds in zip(world.members, row, strict=False)
        if who != whom
    }
