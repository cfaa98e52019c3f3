"""A run that is to learn on for longer than it was made for."""

from __future__ import annotations

from pathlib import Path

from wcsim.agents.runs.run_folder import CONFIG, MANIFEST, read_json
from wcsim.config import RunConfig, parse
from wcsim.core import files
from wcsim.errors import ConfigError, PolicyError


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
