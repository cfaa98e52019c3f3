"""`wcsim train` with a danger head: rounds of driving and learning."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from wcsim.agents.rounds.run_of_rounds import train_danger
from wcsim.agents.rounds.train_rounds import RoundProgress
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.cli.shared.exit_codes import NothingKept
from wcsim.cli.shared.machine_options import machines_of
from wcsim.cli.training.bar import gone_if_nothing_came_of_it
from wcsim.errors import InterruptedRunError
from wcsim.server.workers.crew import WorkerNow
from wcsim.towns.scenario.town import Town


def train_rounds_in(run: ResolvedRun, town: Town, worlds: int | None, cluster: str = "") -> Path:
    """Train with a progress bar; returns the run folder.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingKept: ... before the first round was done.
        WcsimError: Something that was asked for cannot be used.
    """
    console = Console(stderr=True, highlight=False)
    bar = Progress(
        *(TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[says]}"), TimeElapsedColumn()),
        console=console,
        disable=not console.is_terminal,
    )
    machines = replace(machines_of(cluster, worlds, "--worlds"), say=lambda told: console.print(told, markup=False))
    collect = run.config.collect
    rows = _Rows(bar)
    task = bar.add_task("driving", total=collect.rounds * collect.segments, says="")

    def show(now: RoundProgress) -> None:
        at = now.round * now.of + now.segments
        learned = "" if math.isnan(now.loss) else f", {now.updates} updates, loss {now.loss:.4f}"
        says = f"round {now.round + 1} of {now.rounds}, {now.segments} of {now.of} segments{learned}"
        driven = now.segments == now.of
        rows.show(now.workers)
        bar.update(task, completed=at, description="learning" if driven and not learned else "driving", says=says)
        if not console.is_terminal and driven:
            console.print(says if learned else f"{says}: learning")

    try:
        with bar, gone_if_nothing_came_of_it(run.out):
            return train_danger(run, town, machines, show, lambda told: console.print(told))
    except InterruptedRunError:
        if run.out.exists():
            raise
        raise NothingKept("stopped before the first round was done; nothing is kept") from None


class _Rows:
    """A line for each worker below the bar, while there is one."""

    def __init__(self, bar: Progress) -> None:
        self._bar = bar
        self._rows: dict[str, TaskID] = {}

    def show(self, workers: tuple[WorkerNow, ...]) -> None:
        """Who is at what now."""
        for gone in self._rows.keys() - {worker.name for worker in workers}:
            self._bar.remove_task(self._rows.pop(gone))
        for worker in workers:
            says = f"segment {worker.key}, {worker.for_s:.0f} s" if worker.key else "free"
            if worker.name not in self._rows:
                self._rows[worker.name] = self._bar.add_task(f"  {worker.name}", total=None, says=says)
            self._bar.update(self._rows[worker.name], says=says)
