"""A training run of a danger network from configuration to saved policy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from wcsim.agents.collecting.segment_places import require_recordable
from wcsim.agents.rounds.round_checkpoint import damaged_rounds, newest_round
from wcsim.agents.rounds.towns_of_rounds import towns_of
from wcsim.agents.rounds.train_rounds import Progress, Rounds, keep_newest, train_rounds
from wcsim.agents.runs.resumed_folder import folder_of
from wcsim.agents.runs.run_folder import ResolvedRun, RunFolder, with_whole_data
from wcsim.config import RunConfig
from wcsim.core import files
from wcsim.errors import ConfigError, InterruptedRunError, PolicyError
from wcsim.server.workers.machines import HERE, Machines
from wcsim.towns.scenario.town import Town


def train_danger(
    run: ResolvedRun,
    town: Town,
    machines: Machines = HERE,
    progress: Progress = lambda now: None,
    stage: Callable[[str], object] = lambda told: None,
) -> Path:
    """Do all rounds and leave a run folder with data/, checkpoints/ and policies/final.

    Args:
        run: The run; with `resume` it goes on after the last whole round.
        town: The one that it is trained in; others may be beside it, see `CollectConfig`.
        machines: Who drives beside the process that learns; how many and where changes nothing but the time.
        progress: Told what comes of it.
        stage: Told what takes long before the first round.

    Raises:
        InterruptedRunError: Ctrl-C; policies/final is that of the last whole round, and `resume` goes on.
        PolicyError, TownError, ConfigError, WorkersError, DiskFullError: See `train_rounds` and `folder_of`.
    """
    _require_driving(run.config)
    require_recordable(run.config)
    folder = folder_of(run, with_whole_data)
    with files.locked(folder.path):
        _tell_damaged(folder, stage)
        towns = towns_of(town, folder.manifest.more_towns, folder.config, folder.path, folder.manifest.seed, stage)
        rounds = Rounds(folder=folder, towns=towns, machines=machines)
        total = folder.config.collect.rounds
        try:
            sha256 = train_rounds(rounds, progress)
        except KeyboardInterrupt:
            folder.with_status("interrupted", 0)
            kept = "the policy of the complete rounds" if keep_newest(folder) else "the segments so far, no policy yet"
            raise InterruptedRunError(
                f"stopped; {folder.path} holds {kept}, and can be continued with --resume"
            ) from None
        folder.with_status("done", total * folder.config.danger.updates)
        folder.event("done", weights_sha256=sha256)
    return folder.path


def _tell_damaged(folder: RunFolder, say: Callable[[str], object]) -> None:
    """Set checkpoints aside that cannot be gone on from. Raises PolicyError where no other is there."""
    damaged = damaged_rounds(folder.checkpoints)
    if damaged and newest_round(folder.checkpoints) < 0:
        names = ", ".join(path.name for path in damaged)
        raise PolicyError(f"{folder.checkpoints} holds no intact checkpoint ({names}); restore one, or start a new run")
    for path in damaged:
        kept = files.set_aside(path)
        say(f"{path}: damaged, skipped for the round before; renamed to {kept.name}")
        folder.event("passed_over", checkpoint=kept.name, reason="damaged")


def _require_driving(config: RunConfig) -> None:
    """Refuse a run that nobody drives for. Raises ConfigError."""
    if config.collect.segments == 0 and not config.collect.data:
        raise ConfigError(
            "collect.segments=0 without collect.data: there is no data to learn from; expected --data FOLDER, or "
            "collect.segments of 1 or more"
        )
