"""The folder that a run writes into: a new one, or the one that it goes on in."""

from __future__ import annotations

from collections.abc import Callable

from wcsim.agents.runs.run_folder import (
    ResolvedRun,
    RunFolder,
    create_run,
    make_manifest,
    open_run,
    with_kept_plant,
)
from wcsim.config import RunConfig
from wcsim.config.plant import plant_text
from wcsim.errors import PolicyError

Complete = Callable[[RunConfig], RunConfig]


def folder_of(run: ResolvedRun, complete: Complete = lambda config: config) -> RunFolder:
    """A new run folder, or the one to go on with when it was made with the same settings, seed, town and rewards.

    Args:
        run: The run.
        complete: Fills in what a configuration leaves to the network, before two are compared.

    Raises:
        PolicyError: The folder is not empty, no run, or one of another run.
        ConfigError: The user's own plant file cannot be read.
    """
    if not run.resume:
        return create_run(run.out, run.config, make_manifest(run.config, run.info))
    folder, kept = open_run(run.out), ("seed", "town_sha256", "more_towns", "rewards")
    other = [key for key in kept if getattr(folder.manifest, key) != getattr(run.info, key)]
    if plant_text(run.config.chair.plant) != plant_text(folder.config.chair.plant):
        other.append("plant")
    if complete(folder.config) != complete(with_kept_plant(run.config, run.out)) or other:
        raise PolicyError(f"{run.out} was made with another {', '.join(other) or 'configuration'}; resume with its own")
    return folder
