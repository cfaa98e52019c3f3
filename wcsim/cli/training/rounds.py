"""`wcsim train` with a danger head: rounds of driving and learning."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from wcsim.agents.rounds.train_rounds import RoundProgress, train_danger
from wcsim.agents.runs.run_folder import ResolvedRun
from wcsim.cli.shared.exit_codes import NothingKept
from wcsim.cli.shared.stage_bar import StageBar
from wcsim.cli.training.bar import gone_if_nothing_came_of_it
from wcsim.config import RunConfig
from wcsim.core.reading import counted
from wcsim.errors import InterruptedRunError
from wcsim.server.workers.machines import Machines
from wcsim.towns.scenario.town import Town

_DOES = {False: "driving", True: "learning"}


def train_rounds_in(run: ResolvedRun, town: Town, machines: Machines, note: str = "") -> Path:
    """Train with a progress bar, and a note above it; returns the run folder.

    Raises:
        InterruptedRunError: The user stopped it.
        NothingKept: ... before anything was driven.
        WcsimError: Something that was asked for cannot be used.
    """
    with StageBar("driving") as bar:

        def show(now: RoundProgress) -> None:
            bar.rows({row.name: f"segment {row.key}, {row.for_s:.0f} s" if row.key else "free" for row in now.workers})
            learns = now.learned > 0 or now.segments == now.of
            at = f"update {now.learned}" if learns else f"segment {now.segments} of {now.of}"
            bar.show(_share_done(now, run.config), f"round {now.round + 1} of {now.rounds}, {at}", _DOES[learns])
            if not bar.console.is_terminal:
                _log(bar, now)

        if note:
            bar.say(f"note: {note}")

        def say(told: str) -> None:
            bar.say(told, left=False)

        try:
            with gone_if_nothing_came_of_it(run.out):
                return train_danger(run, town, replace(machines, say=say), show, say)
        except InterruptedRunError:
            if run.out.exists():
                raise
            raise NothingKept("stopped before the first segment was driven; nothing is saved") from None


def _share_done(now: RoundProgress, config: RunConfig) -> float:
    """Which share of a run's work is done, 0 to 1.

    A step that is driven and one in a batch that is learned from cost about the same on two cores. From the second
    round on worlds drive while the network learns, so that a round takes as long as the longer of both.
    """
    collect, danger = config.collect, config.danger
    drive, learn = collect.segments * collect.ticks * collect.chairs, danger.updates * danger.batch
    both, last = max(drive, learn), now.rounds - 1
    before = 0 if now.round == 0 else drive + now.round * both
    driven = drive * now.segments / max(1, now.of) if now.round == 0 else 0.0
    learned = 1.0 if now.updates else now.learned / danger.updates
    return (before + driven + learned * (learn if now.round == last else both)) / (drive + last * both + learn)


def _log(bar: StageBar, now: RoundProgress) -> None:
    """A line where a round is driven, and one where it is learned from."""
    says = f"round {now.round + 1} of {now.rounds}, {now.segments} of {now.of} segments"
    if now.updates:
        bar.say(f"{says}, {counted(now.updates, 'update')}, loss {now.loss:.4f}")
    elif now.segments == now.of and not now.learned:
        bar.say(f"{says}: learning")
