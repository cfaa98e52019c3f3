"""Where work is done: in processes of this machine, or on those of a Ray cluster. The rest of wcsim need not know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.server.workers.processes import ProcessWorkers
from wcsim.server.workers.worker_api import Workers

LOGS: Final = "cluster"  # of a run or a result: its folder for what Ray said, and who did what

Say = Callable[[str], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Machines:
    """Who is asked for workers."""

    count: int = 1  # processes, here or in a cluster that is made here
    cluster: str = ""  # "" for none, `local` for one that is made here, or HOST:PORT of a Ray head
    say: Say = lambda told: None  # of what machines come, go, or cannot be used

    def open(self, folder: Path) -> Workers:
        """The workers; `folder` is that of the run, for the logs of a cluster.

        Raises:
            ConfigError: There is no Ray, or no cluster at that address, or none of its nodes can be used.
        """
        if not self.cluster:
            return ProcessWorkers(self.count)
        from wcsim.server.workers.cluster.ray_workers import RayWorkers

        return RayWorkers(self.cluster, self.count, folder / LOGS, self.say)


HERE: Final = Machines()
"""One process of this machine."""
