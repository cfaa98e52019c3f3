"""`wcsim train` with a danger head: rounds of driving and learning."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from wcsim.agents.rounds.run_of_rounds import train_danger
from wcsim.agents.rounds.train_rounds import RoundProgress
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.cli.shared.exit_codes import NothingKept
from wcsim.cli.training.bar import gone_if_nothing_came_of_it
from wcsim.errors import InterruptedRunError
from wcsim.towns.scenario.town import Town


def train_rounds_in(run: ResolvedRun, town: Town, worlds: int) -> Path:
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
    collect = run.config.collect
    task = bar.add_task("driving", total=collect.rounds * collect.segments, says="")

    def show(now: RoundProgress) -> None:
        at = now.round * now.of + now.segments
        learned = "" if math.isnan(now.loss) else f", {now.updates} updates, loss {now.loss:.4f}"
        says = f"round {now.round + 1} of {now.rounds}, {now.segments} of {now.of} segments{learned}"
        driven = now.segments == now.of
        bar.update(task, completed=at, description="learning" if driven and not learned else "driving", says=says)
        if not console.is_terminal and driven:
            console.print(says if learned else f"{says}: learning")

    try:
        with bar, gone_if_nothing_came_of_it(run.out):
            return train_danger(run, town, worlds, show, lambda told: console.print(told))
    except InterruptedRunError:
        if run.out.exists():
            raise
        raise NothingKept("stopped before the first round was done; nothing is kept") from None
