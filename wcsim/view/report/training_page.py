"""The page of a training: how each client came to follow its user, and to stay alive (Fig. 7a and 7b of the paper)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from wcsim.agents.learning.metrics import read_metrics
from wcsim.agents.runs.run_folder import MANIFEST, METRICS, read_json
from wcsim.core.reading import is_file, shown_value
from wcsim.errors import PolicyError
from wcsim.view.report.charts import Curve, curve_chart
from wcsim.view.report.figures import figure
from wcsim.view.report.markup import Cell, Exhibit, csv_of, el, table
from wcsim.view.report.page import Section, facts, page, shown, write_page

_OVER: Final = 20  # episodes that a mean goes over


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainedEpisode:
    """A row of metrics.csv, as far as it is drawn."""

    step: int
    phase: int
    length: int
    kpi1: float  # in the first phase of what the agent would have chosen, where that was looked at
    crashed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """A run of one client or of several."""

    manifest: Mapping[str, Any]
    clients: Mapping[str, tuple[TrainedEpisode, ...]]  # in seat order


def read_training(folder: Path) -> Training:
    """The log of a run folder. Raises PolicyError when it is none, or damaged."""
    manifest = read_json(folder, MANIFEST)
    names = manifest.get("clients")
    homes = {folder.resolve().name: folder} if names is None else {name: folder / name for name in names}
    return Training(manifest=manifest, clients={name: _episodes(home / METRICS) for name, home in homes.items()})


def _episodes(path: Path) -> tuple[TrainedEpisode, ...]:
    rows = read_metrics(path) if is_file(path) else []
    return tuple(_episode(row, path) for row in rows)


def _episode(row: Mapping[str, str], path: Path) -> TrainedEpisode:
    chosen = row["kpi1_greedy"] if row["phase"] == "1" and row["kpi1_greedy"] else row["kpi1"]
    try:
        episode = TrainedEpisode(
            step=int(row["step"]),
            phase=int(row["phase"]),
            length=int(row["length"]),
            kpi1=float(chosen),
            crashed=bool(int(row["crashed"])),
        )
    except ValueError:
        raise PolicyError(f"{path}: is damaged at step {shown_value(row['step'])}; expected numbers") from None
    if not math.isfinite(episode.kpi1):
        raise PolicyError(f"{path}: is damaged at step {episode.step}; expected a finite joystick distance")
    return episode


def write_training_page(training: Training, folder: Path) -> Path:
    """Write the page of a training; where it is.

    Raises:
        PolicyError: No client has finished an episode.
        DiskFullError: It cannot be written.
    """
    if not any(training.clients.values()):
        raise PolicyError(f"{folder}: no client has finished an episode; expected some: train on with --resume")
    drawn = (_figure(training, "kpi1", "7a"), _figure(training, "length", "7b"))
    clients = _table(training)
    manifest = training.manifest
    intro = facts(
        (
            ("town", manifest.get("town", "")),
            ("seed", manifest.get("seed", "")),
            ("status", f"{manifest.get('status', '')}, {manifest.get('steps', 0)} steps"),
            ("clients", ", ".join(training.clients)),
        )
    )
    sections = (
        Section(name="curves", title="Curves", body=el("div", *map(shown, drawn), class_="charts")),
        Section(name="clients", title="Clients", body=shown(clients)),
    )
    return write_page(folder, page(f"Training {folder.resolve().name}", intro, sections), (*drawn, clients))


def running_means(values: Sequence[float], over: int = _OVER) -> list[float]:
    """The mean of each value and those before it, at most `over` of them.

    >>> running_means([1.0, 3.0, 5.0], over=2)
    [1.0, 2.0, 4.0]
    """
    firsts = (max(0, place + 1 - over) for place in range(len(values)))
    return [math.fsum(values[first : place + 1]) / (place + 1 - first) for place, first in enumerate(firsts)]


_KPI1_SAYS: Final = (
    "Joystick distance of user and agent, mean over an episode: KPI 1; in the first phase of the actions that the "
    "agent would have chosen"
)
_SAYS: Final = {
    "kpi1": ("KPI 1, mean joystick distance", _KPI1_SAYS),
    "length": ("KPI 2, steps alive", "Steps that an episode lasted, at most its limit: KPI 2"),
}


def _figure(training: Training, key: str, number: str) -> Exhibit:
    curves, plain = [], []
    for name, episodes in training.clients.items():
        values = [float(getattr(episode, key)) for episode in episodes]
        means = running_means(values)
        curves.append(Curve(name=name, steps=[e.step for e in episodes], values=values, means=means))
        rows: list[list[Cell]] = [
            [name, e.step, e.phase, value, round(mean, 6), int(e.crashed)]
            for e, value, mean in zip(episodes, values, means, strict=True)
        ]
        plain += rows
    label, says = _SAYS[key]
    return figure(
        f"fig-{number}-{key}",
        f"Fig. {number}: {label}",
        f"{says}. A dot an episode, at the step of its end; lines are means of the last {_OVER} episodes. Dashed: "
        "the end of the first phase, in which the user's action is executed. Exploration is in it: a test says more.",
        csv_of(("client", "step", "phase", key, f"mean_of_{_OVER}", "crashed"), plain),
        curve_chart(f"fig-{number}", label, curves, _switches(training)),
    )


def _switches(training: Training) -> list[int]:
    """Steps at which a client's first phase had ended."""
    found = {
        before.step
        for episodes in training.clients.values()
        for before, after in pairwise(episodes)
        if before.phase < after.phase
    }
    return sorted(found)


def _table(training: Training) -> Exhibit:
    rows: list[list[Cell]] = []
    for name, episodes in training.clients.items():
        last = episodes[-_OVER:]
        means = [math.fsum(values) / len(values) if (values := list(each)) else None for each in (
            (e.kpi1 for e in last), (float(e.length) for e in last))]  # fmt: skip
        figures = [None if mean is None else round(mean, 4) for mean in means]
        crashes = sum(e.crashed for e in episodes)
        rows.append([name, episodes[-1].step if episodes else 0, len(episodes), crashes, *figures])
    headings = ("client", "steps", "episodes", "crashes", f"KPI 1, last {_OVER}", f"KPI 2, last {_OVER}")
    return Exhibit(
        name="clients",
        title="Clients",
        says="Steps up to the last episode that ended; means over the last episodes of the training.",
        body=table(headings, [["–" if cell is None else cell for cell in row] for row in rows], "clients-table"),
        csv=csv_of(headings, rows),
    )
