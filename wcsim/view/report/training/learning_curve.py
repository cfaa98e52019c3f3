"""What a training's log says, episode by episode, its running means, and where KPI 1 came below its limit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from wcsim.agents.learning.watching.metrics import read_metrics
from wcsim.agents.rounds.round_log import TrainedRound, logs_rounds, read_rounds
from wcsim.agents.runs.run_folder import MANIFEST, METRICS, read_json
from wcsim.core.reading import counted, is_file, shown_value
from wcsim.errors import PolicyError
from wcsim.supervisor.kpi import MAX_FOLLOW_DISTANCE

OVER: Final = 20  # episodes that a mean goes over
LEAST: Final = 5  # episodes in a mean that counts as a crossing
KPI1_LIMIT: Final = MAX_FOLLOW_DISTANCE  # the line in Fig. 7a of the paper


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainedEpisode:
    """A row of metrics.csv, as far as it is drawn."""

    step: int
    phase: int
    length: int
    kpi1: float | None  # in the first phase of what the agent would have chosen, where that was looked at
    crashed: bool
    overestimate: float | None = None  # value at its start minus the return that followed, scaled


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """Runs of one client or of several, as one."""

    manifests: Mapping[str, Mapping[str, Any]]  # by the run's folder
    clients: Mapping[str, tuple[TrainedEpisode, ...]]  # in seat order
    rounds: Mapping[str, tuple[TrainedRound, ...]] = field(default_factory=dict)  # of runs of danger networks


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCrossing:
    """Where smoothed KPI 1 came below the limit."""

    step: int | None  # at which it first did; None where it never did
    last: float | None  # the last mean
    left: int | None = None  # the step since which it is above again
    episodes: int = OVER  # with a KPI 1

    def told(self) -> str:
        """In words.

        >>> LimitCrossing(step=1200, last=0.4, left=9000).told()
        'KPI 1 (mean of 20 episodes) is below 0.1768 from step 1200 on, above it again since step 9000'
        """
        if self.episodes < LEAST:
            return f"KPI 1: {counted(self.episodes, 'episode')}; a mean needs at least {LEAST}"
        mean = f"KPI 1 (mean of {min(OVER, self.episodes)} episodes)"
        if self.step is None:
            return f"{mean} never falls below {KPI1_LIMIT}"
        after = f", above it again since step {self.left}" if self.left is not None else ""
        return f"{mean} is below {KPI1_LIMIT} from step {self.step} on{after}"


def read_training(folders: Sequence[Path]) -> Training:
    """The logs of run folders; of several, clients are called by their run's name too.

    Raises:
        PolicyError: One is no run, or damaged.
    """
    manifests, clients, rounds = {}, {}, {}
    for folder in folders:
        manifest = read_json(folder, MANIFEST)
        manifests[str(folder)] = manifest
        for name, home in _homes(folder, manifest):
            label = name if len(folders) == 1 or "clients" not in manifest else f"{folder.resolve().name}/{name}"
            label = str(home) if label in clients or label in rounds else label
            if is_file(home / METRICS) and logs_rounds(home / METRICS):
                rounds[label] = read_rounds(home / METRICS)
            else:
                clients[label] = _episodes(home / METRICS)
    return Training(manifests=manifests, clients=clients, rounds=rounds)


def _homes(folder: Path, manifest: Mapping[str, Any]) -> Iterable[tuple[str, Path]]:
    names = manifest.get("clients")
    return [(folder.resolve().name, folder)] if names is None else [(name, folder / name) for name in names]


def _episodes(path: Path) -> tuple[TrainedEpisode, ...]:
    rows = read_metrics(path) if is_file(path) else []
    return tuple(_episode(row, path) for row in rows)


def _episode(row: Mapping[str, str], path: Path) -> TrainedEpisode:
    chosen = row["kpi1_greedy"] if row["phase"] == "1" else row["kpi1"]
    try:
        episode = TrainedEpisode(
            step=int(row["step"]),
            phase=int(row["phase"]),
            length=int(row["length"]),
            kpi1=_number(chosen) if row["phase"] == "1" else float(chosen),
            crashed=bool(int(row["crashed"])),
            overestimate=_number(row["overestimate"]),
        )
    except ValueError:
        raise PolicyError(f"{path}: is damaged at step {shown_value(row['step'])}; expected numbers") from None
    if not all(math.isfinite(value) for value in (episode.kpi1, episode.overestimate) if value is not None):
        raise PolicyError(f"{path}: is damaged at step {episode.step}; expected finite numbers")
    return episode


def _number(text: str) -> float | None:
    return float(text) if text else None


def running_means(values: Sequence[float], over: int = OVER) -> list[float]:
    """The mean of each value and those before it, at most `over` of them.

    >>> running_means([1.0, 3.0, 5.0], over=2)
    [1.0, 2.0, 4.0]
    """
    firsts = (max(0, place + 1 - over) for place in range(len(values)))
    return [math.fsum(values[first : place + 1]) / (place + 1 - first) for place, first in enumerate(firsts)]


def crossing(episodes: Sequence[TrainedEpisode]) -> LimitCrossing:
    """Where the mean of KPI 1 over the last episodes first was at most the limit; the first few are too few for it."""
    told = [(episode.step, episode.kpi1) for episode in episodes if episode.kpi1 is not None]
    means = running_means([kpi1 for _, kpi1 in told])
    within = [place for place, mean in enumerate(means) if mean <= KPI1_LIMIT and place + 1 >= LEAST]
    last = means[-1] if means else None
    if not within:
        return LimitCrossing(step=None, last=last, episodes=len(means))
    left = told[within[-1] + 1][0] if within[-1] + 1 < len(told) else None
    return LimitCrossing(step=told[within[0]][0], last=last, left=left, episodes=len(means))


def switch_step(episodes: Sequence[TrainedEpisode]) -> int | None:
    """The step of the last episode that ended in the first phase; None where there was no change."""
    return next((before.step for before, after in pairwise(episodes) if before.phase < after.phase), None)
