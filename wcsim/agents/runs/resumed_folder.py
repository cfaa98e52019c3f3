"""The folder that a run writes into: a new one, or the one that it goes on in, perhaps for longer than at first."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from wcsim.agents.runs.run_folder import (
    CONFIG,
    MANIFEST,
    ResolvedRun,
    RunFolder,
    create_run,
    make_manifest,
    open_run,
    read_json,
    with_kept_plant,
)
from wcsim.config import RunConfig, parse
from wcsim.config.plant import plant_text
from wcsim.core import files
from wcsim.errors import ConfigError, PolicyError

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


def extend(run: Path, steps: int, fade: float | None = None) -> None:
    """Write another number of steps in all into a run's configuration; all else in it stays as it was.

    Killed between two files, it leaves a run that goes on as it was, and that can be extended again.

    Args:
        run: Its folder.
        steps: In all.
        fade: Another `learn.learning_rate_fade`; None leaves it.

    Raises:
        PolicyError: It is no run, or cannot have so many.
        DiskFullError: There is no room.
    """
    data, manifest = read_json(run, CONFIG), read_json(run, MANIFEST)
    try:
        was = parse(RunConfig, data, str(run / CONFIG)).digest()
        data["learn"]["total_steps"] = steps
        if fade is not None:
            data["learn"]["learning_rate_fade"] = fade
        config = parse(RunConfig, data, str(run / CONFIG))
    except (ConfigError, TypeError, KeyError) as error:
        raise PolicyError(f"{run / CONFIG}: {error}") from None
    manifest = {**manifest, "config_sha256": config.digest()}
    files.write_json(run / MANIFEST, {**manifest, "config_was_sha256": was})
    files.write_json(run / CONFIG, data)
    files.write_json(run / MANIFEST, {key: value for key, value in manifest.items() if key != "config_was_sha256"})
