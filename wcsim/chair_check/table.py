"""The table of a plant: all its trials, done one by one or in a pool of processes."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final

from wcsim.chair_check.driving import make_driving_trials
from wcsim.chair_check.kerbs import make_kerb_trials, make_twisted_ramp_trials
from wcsim.chair_check.mass_rig import make_mass_rig_trials, make_tip_trials, tip_ratio_rows
from wcsim.chair_check.row import TrialResult, TrialSetup, TrialSpec, run_trial
from wcsim.core.processes import run_in_process_pool
from wcsim.errors import ConfigError
from wcsim.physics.wheelchair.plant import plant_spec

Progress = Callable[[str], None]
_MAKERS: Final = (
    make_mass_rig_trials,
    make_driving_trials,
    make_twisted_ramp_trials,
    make_kerb_trials,
)


def _trials(setup: TrialSetup, only: Sequence[str] = ()) -> tuple[TrialSpec, ...]:
    """The trials of a plant whose names begin with one of some words; all if none.

    Raises ConfigError or PhysicsError for a plant that cannot be.
    """
    most_mps = plant_spec(setup.chair).limits.speed_mps
    slow_enough = (
        trial
        for trial in _made(setup, only)
        if trial.speed_mps is None or trial.speed_mps <= most_mps
    )
    return (*slow_enough, *make_tip_trials(setup, only))


def list_too_fast_trials(setup: TrialSetup, only: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the rows that are left out: they need more than the plant's `limits.speed_mps`."""
    most_mps = plant_spec(setup.chair).limits.speed_mps
    return tuple(
        trial.name
        for trial in _made(setup, only)
        if trial.speed_mps is not None and trial.speed_mps > most_mps
    )


def _made(setup: TrialSetup, only: Sequence[str]) -> Iterator[TrialSpec]:
    for make in _MAKERS:
        yield from (
            trial for trial in make(setup) if not only or trial.name.startswith(tuple(only))
        )


def run_plant_trials(
    setup: TrialSetup, only: Sequence[str] = (), workers: int = 1, progress: Progress | None = None
) -> list[TrialResult]:
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
        if fast := list_too_fast_trials(setup, only):
            what = f"{', '.join(fast)}: faster than the plant's limits.speed_mps"
        raise ConfigError(f"{what}; expected the start of a row's name")
    done: dict[int, TrialResult] = {}
    for place, row in _done(chosen, setup, workers):
        done[place] = row
        if progress is not None:
            progress(row.name)
    rows = {done[place].name: done[place] for place in sorted(done)}
    return [*rows.values(), *tip_ratio_rows(setup, rows)]


def _done(
    chosen: Sequence[TrialSpec], setup: TrialSetup, workers: int
) -> Iterator[tuple[int, TrialResult]]:
    """Each row with its place, as it is done."""
    if workers == 1:
        return enumerate(run_trial(trial, setup) for trial in chosen)
    return run_in_process_pool(partial(run_trial, setup=setup), chosen, workers)
