"""`wcsim train` with a danger head: rounds of driving and learning."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from wcsim.agents.rounds.run_of_rounds import train_danger
from wcsim.agents.rounds.train_rounds import RoundProgress
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.cli.training.bar import gone_if_nothing_came_of_it
from wcsim.towns.scenario.town import Town


def train_rounds_in(run: ResolvedRun, town: Town, worlds: int) -> Path:
    """Train with a progress bar; returns the run folder."""
    console = Console(stderr=True, highlight=False)
    bar = Progress(
        *(TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[says]}"), TimeElapsedColumn()),
        console=console,
        disable=not console.is_terminal,
    )
    collect = run.config.collect
    task = bar.add_task("driving", total=collect.rounds * collect.segments, says="")

    def show(now: RoundProgress) -> None:
        at = now.round * now.of + now.segments
        learned = "" if math.isnan(now.loss) else f", {now.updates} updates, loss {now.loss:.4f}"
        says = f"round {now.round + 1} of {now.rounds}, {now.segments} of {now.of} segments{learned}"
        bar.update(task, completed=at, says=says)
        if not console.is_terminal and learned:
            console.print(says)

    with bar, gone_if_nothing_came_of_it(run.out):
        return train_danger(run, town, worlds, show, lambda told: console.print(told))
