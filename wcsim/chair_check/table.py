"""The table of a plant: all its trials, done one by one or in a pool of processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final

from wcsim.chair_check.driving import driving_trials
from wcsim.chair_check.kerbs import kerb_trials, ramp_trials
from wcsim.chair_check.mass_rig import mass_trials, tip_ratio_rows, tip_trials
from wcsim.chair_check.row import Row, Setup, Trial, measured
from wcsim.core.processes import run_in_pool
from wcsim.errors import ConfigError
from wcsim.physics.wheelchair.plant import plant_spec

Progress = Callable[[str], None]
_MAKERS: Final = (mass_trials, driving_trials, ramp_trials, kerb_trials)


def _trials(setup: Setup, only: Sequence[str] = ()) -> tuple[Trial, ...]:
    """The trials of a plant whose names begin with one of some words; all if none.

    Raises ConfigError or PhysicsError for a plant that cannot be.
    """
    most_mps = plant_spec(setup.chair).limits.speed_mps
    slow_enough = (
        trial
        for trial in _made(setup, only)
        if trial.speed_mps is None or trial.speed_mps <= most_mps
    )
    return (*slow_enough, *tip_trials(setup, only))


def too_fast(setup: Setup, only: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the rows that are left out: they need more than the plant's `limits.speed_mps`."""
    most_mps = plant_spec(setup.chair).limits.speed_mps
    return tuple(
        trial.name
        for trial in _made(setup, only)
        if trial.speed_mps is not None and trial.speed_mps > most_mps
    )


def _made(setup: Setup, only: Sequence[str]) -> Iterator[Trial]:
    for make in _MAKERS:
        yield from (
            trial for trial in make(setup) if not only or trial.name.startswith(tuple(only))
        )


def table(
    setup: Setup, only: Sequence[str] = (), workers: int = 1, progress: Progress | None = None
) -> list[Row]:
    """The table of a plant.

    Args:
        setup: The chair, its IMU and the rate.
        only: Beginnings of the names of the rows that are wanted; all if none.
        workers: Processes to share the work; 1 for none but this one.
        progress: Told the name of each row as it is done.

    Raises:
        ConfigError: The plant is unknown, its file is wrong, or no row begins so.
        PhysicsError: A trial gave no number.
    """
    chosen = _trials(setup, only)
    if not chosen:
        what = f"no row starts with {', '.join(only)!r}"
        if fast := too_fast(setup, only):
            what = f"{', '.join(fast)}: faster than the plant's limits.speed_mps"
        raise ConfigError(f"{what}; expected the start of a row's name")
    done: dict[int, Row] = {}
    for place, row in _done(chosen, setup, workers):
        done[place] = row
        if progress is not None:
            progress(row.name)
    rows = {done[place].name: done[place] for place in sorted(done)}
    return [*rows.values(), *tip_ratio_rows(setup, rows)]


def _done(chosen: Sequence[Trial], setup: Setup, workers: int) -> Iterator[tuple[int, Row]]:
    """Each row with its place, as it is done."""
    if workers == 1:
        return enumerate(measured(trial, setup) for trial in chosen)
    return run_in_pool(partial(measured, setup=setup), chosen, workers)
