"""A training's steps and episodes by its logs, running means, where KPI 1 passed its limit."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, TypeVar, get_type_hints

from wcsim.agents.runs.metrics import (
    COLUMNS,
    KPI1_STEPS,
    ROW_STEPS,
    STEP_COLUMNS,
    has_metrics_per_round,
    read_metrics,
    read_round_metrics,
)
from wcsim.agents.runs.run_folder import MANIFEST, METRICS, STEPS, read_run_json
from wcsim.config.run_file import RoundMetricsRow
from wcsim.core.reading import escape_repr, is_file
from wcsim.errors import PolicyError
from wcsim.supervisor.kpi import MAX_FOLLOW_DISTANCE

OVER: Final = 20  # episodes, or rows of 100 steps, that a mean goes over
_Row = TypeVar("_Row", "TrainedSteps", "TrainedEpisode")
KPI1_LIMIT: Final = MAX_FOLLOW_DISTANCE  # the line in Fig. 7a of the paper


@dataclass(frozen=True, slots=True, kw_only=True)
class LogRow:
    """What a row of steps.csv and one of metrics.csv have in common."""

    step: int  # the last that it tells of
    phase: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainedSteps(LogRow):
    """A row of steps.csv: 100 steps."""

    kpi1: float  # of the agent's own choice, whatever was executed
    elapsed_s: float  # since the training began, or went on


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainedEpisode(LogRow):
    """A row of metrics.csv, as far as it is drawn."""

    length: int
    crashed: bool
    cut: bool = False  # its world ended it, neither a crash nor its limit
    overestimate: float | None = None  # value at its start minus the return that followed, scaled


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """Runs of one client or of several, as one."""

    manifests: Mapping[str, Mapping[str, Any]]  # by the run's folder
    clients: Mapping[str, tuple[TrainedEpisode, ...]]  # in seat order
    steps: Mapping[str, tuple[TrainedSteps, ...]] = field(
        default_factory=dict
    )  # of the same clients
    rounds: Mapping[str, tuple[RoundMetricsRow, ...]] = field(
        default_factory=dict
    )  # of runs of danger networks


@dataclass(frozen=True, slots=True, kw_only=True)
class _LimitCrossing:
    """Where the mean of KPI 1 over the last 2,000 steps came below the limit."""

    step: int | None  # at which it first did; None where it never did
    last: float | None  # the last mean; None where there are fewer steps
    left: int | None = None  # the step since which it is above again
    elapsed_s: float | None = None  # of training until `step`

    def told(self) -> str:
        """In words.

        >>> print(_LimitCrossing(step=3200, last=0.1, left=900).told())
        KPI 1 (mean of 2000 steps) is below 0.1768 from step 3200 on, above it again since step 900
        """
        mean = f"KPI 1 (mean of {KPI1_STEPS} steps)"
        if self.last is None:
            return f"KPI 1: a mean needs {KPI1_STEPS} steps"
        if self.step is None:
            return f"{mean} never falls below {KPI1_LIMIT}"
        spent = "" if self.elapsed_s is None else f" ({self.elapsed_s / 60.0:.1f} min)"
        after = f", above it again since step {self.left}" if self.left is not None else ""
        return f"{mean} is below {KPI1_LIMIT} from step {self.step} on{spent}{after}"


def read_training(folders: Sequence[Path]) -> Training:
    """The logs of run folders; of several, clients are called by their run's name too.

    Raises:
        PolicyError: One is no run, or damaged.
    """
    manifests, clients, steps, rounds = {}, {}, {}, {}
    for folder in folders:
        manifest = read_run_json(folder, MANIFEST)
        manifests[str(folder)] = manifest
        for name, home in _homes(folder, manifest):
            label = (
                name
                if len(folders) == 1 or "clients" not in manifest
                else f"{folder.resolve().name}/{name}"
            )
            label = str(home) if label in clients or label in rounds else label
            if is_file(home / METRICS) and has_metrics_per_round(home / METRICS):
                rounds[label] = read_round_metrics(home / METRICS)
            else:
                clients[label] = _rows(home / METRICS, COLUMNS, TrainedEpisode)
                steps[label] = _rows(home / STEPS, STEP_COLUMNS, TrainedSteps)
    return Training(manifests=manifests, clients=clients, steps=steps, rounds=rounds)


def _homes(folder: Path, manifest: Mapping[str, Any]) -> Iterable[tuple[str, Path]]:
    names = manifest.get("clients")
    return (
        [(folder.resolve().name, folder)]
        if names is None
        else [(name, folder / name) for name in names]
    )


def _rows(path: Path, columns: tuple[str, ...], kind: type[_Row]) -> tuple[_Row, ...]:
    """The rows of a log, none without a file. Raises PolicyError: a number is not finite."""
    found, kinds = [], get_type_hints(kind)
    for row in read_metrics(path, columns) if is_file(path) else []:
        try:
            read = {
                each.name: _READ[kinds[each.name]](row[_LOGGED.get(each.name, each.name)])
                for each in fields(kind)
            }
        except ValueError:
            where = f"{path}: is damaged at step {escape_repr(row['step'])}"
            raise PolicyError(f"{where}; expected finite numbers") from None
        found.append(kind(**read))
    return tuple(found)


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(text)
    return value


_READ: Final[Mapping[object, Callable[[str], Any]]] = {
    int: int,
    bool: lambda text: bool(int(text)),
    float: _finite,
    float | None: lambda text: _finite(text) if text else None,
}
_LOGGED: Final = {"kpi1": "kpi1_greedy", "elapsed_s": "elapsed_s_wall"}  # columns of other names


def running_means(values: Sequence[float], over: int = OVER) -> list[float]:
    """The mean of each value and those before it, at most `over` of them.

    >>> running_means([1.0, 3.0, 5.0], over=2)
    [1.0, 2.0, 4.0]
    """
    firsts = (max(0, place + 1 - over) for place in range(len(values)))
    return [
        math.fsum(values[first : place + 1]) / (place + 1 - first)
        for place, first in enumerate(firsts)
    ]


def crossing(rows: Sequence[TrainedSteps]) -> _LimitCrossing:
    """Where the mean of KPI 1 over the last 2,000 steps first was at most the limit."""
    means = running_means([row.kpi1 for row in rows])
    within = [place for place, mean in enumerate(means) if mean <= KPI1_LIMIT and place + 1 >= OVER]
    last = means[-1] if len(means) >= OVER else None
    if not within:
        return _LimitCrossing(step=None, last=last)
    left = rows[within[-1] + 1].step if within[-1] + 1 < len(rows) else None
    first = rows[within[0]]
    # A run that was resumed counts from 0: the time before is in the last rows before that.
    elapsed_s = first.elapsed_s + sum(
        row.elapsed_s
        for row, after in pairwise(rows[: within[0] + 1])
        if after.elapsed_s < row.elapsed_s
    )
    return _LimitCrossing(step=first.step, last=last, left=left, elapsed_s=elapsed_s)


def kpi1_of(run: Path) -> float:
    """The mean of KPI 1 over the last 2,000 steps of a run's first phase, or all if fewer.

    Raises:
        PolicyError: None is logged, or the log is damaged.
    """
    found = [row.kpi1 for row in _rows(run / STEPS, STEP_COLUMNS, TrainedSteps) if row.phase == 1]
    if not found:
        raise PolicyError(
            f"{run / STEPS}: no row of the first phase; expected a run of {ROW_STEPS} steps or more"
        )
    return running_means(found)[-1]
