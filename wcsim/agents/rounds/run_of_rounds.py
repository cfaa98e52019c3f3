"""A training run of a danger network from configuration to saved policy.

The towns that data is driven in: the run's own, those of the configuration, and some that are drawn for the run.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

from wcsim.agents.collecting.segment_places import require_recordable
from wcsim.agents.networks.device import torch_settings
from wcsim.agents.rounds.round_checkpoint import damaged_rounds, newest_round
from wcsim.agents.rounds.train_rounds import Progress, Rounds, keep_newest, train_rounds
from wcsim.agents.runs.resumed_folder import folder_of
from wcsim.agents.runs.run_folder import ResolvedRun, RunFolder, how_to_resume, with_whole_data
from wcsim.config import RunConfig
from wcsim.core import files, seeding
from wcsim.errors import ConfigError, InterruptedRunError, PolicyError, TownError
from wcsim.server.workers.machines import HERE, Machines
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.making.maker import make_town
from wcsim.towns.making.wishes import Wishes
from wcsim.towns.scenario.town import Town, find_town, open_town

TOWNS: Final = "towns"


def towns_of(
    own: Town,
    more: Collection[str],
    config: RunConfig,
    folder: Path,
    seed: int,
    stage: Callable[[str], object] = lambda told: None,
) -> tuple[str, ...]:
    """Folders or names of all towns, the run's own first.

    Args:
        own: The run's.
        more: Words for those that take turns with it.
        config: Of the run.
        folder: Of the run; towns that are drawn lie in it, and are made once, where anybody is going to drive in them.
        seed: Of the run.
        stage: Told what is made.

    Raises:
        TownError: A town is missing, is meant for tests, or cannot be made.
        SumoError: One of SUMO's tools failed.
    """
    listed = [find_town(name) for name in config.collect.towns]
    for town in listed:
        if town.split == "test":
            raise TownError(f"collect.towns: {town.name} is a test town; expected training towns")
    others = [*map(asked_town, more), *listed]
    made = config.collect.made_towns if config.collect.segments else 0
    for number in range(made):
        drawn = seeding.derive(seed, "collect", "town", number)
        out = folder / TOWNS / f"made-{drawn}"
        if not out.is_dir():
            stage(f"generating town {number + 1} of {made}")
            make_town(out, drawn, Wishes())
        others.append(open_town(out))
    return tuple(str(town.address) for town in (own, *others))


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
    with files.locked(folder.path), torch_settings(folder.config.learn):
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
                f"stopped; {folder.path} holds {kept}; continue it: {how_to_resume(folder.path)}"
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
