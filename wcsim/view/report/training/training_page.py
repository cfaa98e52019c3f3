"""The page of a training: how each client learned to follow its user without crashes (Fig. 7a, 7b), or its rounds."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from wcsim.errors import PolicyError
from wcsim.view.report.charts import Curve, curve_chart
from wcsim.view.report.figures import figure
from wcsim.view.report.markup import Cell, Exhibit, Markup, csv_of, el, joined, table
from wcsim.view.report.page import Section, facts, page, shown, write_page
from wcsim.view.report.training.learning_curve import (
    KPI1_LIMIT,
    OVER,
    LimitCrossing,
    TrainedEpisode,
    Training,
    crossing,
    running_means,
    switch_step,
)
from wcsim.view.report.training.round_figures import round_sections

_KPI1_SAYS: Final = (
    f"Mean distance between the driven and the user's stick in an episode, and its limit {KPI1_LIMIT}. In the first "
    "phase it is that of the actions that the agent would have chosen. Triangle: the mean falls below the limit"
)
_OVER_SAYS: Final = (
    "Value of the best action at the start of an episode minus the discounted return that followed, both scaled. "
    "Above 0 the network overestimates, more so without double Q-learning (learn.double_q). In the first phase the "
    "user's actions were executed"
)
_Value = Callable[[TrainedEpisode], float | None]
_FIGURES: Final[Sequence[tuple[str, str, str, str, _Value]]] = (
    ("kpi1", "Fig. 7a: ", "KPI 1, mean joystick distance", _KPI1_SAYS, lambda e: e.kpi1),
    ("length", "Fig. 7b: ", "KPI 2, steps of an episode", "Steps until a crash, or until the limit of an episode",
     lambda e: float(e.length)),
    ("overestimate", "", "value minus return", _OVER_SAYS, lambda e: e.overestimate),
)  # fmt: skip
_NAMES: Final = {"kpi1": "fig-7a-kpi1", "length": "fig-7b-length", "overestimate": "overestimate"}


def write_training_page(training: Training, folder: Path, more: Sequence[tuple[Section, Exhibit]] = ()) -> Path:
    """Write the page of a training; where it is.

    Args:
        training: What the logs hold.
        folder: Where the page goes.
        more: Sections between curves and clients.

    Raises:
        PolicyError: No client has finished an episode, and no round is done.
        DiskFullError: It cannot be written.
    """
    episodes, rounds = any(training.clients.values()), round_sections(training.rounds)
    if not episodes and not rounds:
        raise PolicyError(f"{folder}: no client has finished an episode yet; continue the training with --resume")
    parts = [*(_curves(training) if episodes else ()), *rounds, *((section, (each,)) for section, each in more)]
    if episodes:
        clients = _table(training)
        parts.append((Section(name="clients", title="Clients", body=shown(clients)), (clients,)))
    intro = facts([("clients", ", ".join((*training.clients, *training.rounds))), *_runs(training)])
    intro = joined((intro, _worth(training)))
    title = f"Training {folder.resolve().name}"
    exhibits = [exhibit for _, held in parts for exhibit in held]
    return write_page(folder, page(title, intro, [section for section, _ in parts]), exhibits)


def _worth(training: Training) -> Markup:
    """What the curves do not say, and the command that does."""
    runs = [name for name, manifest in training.manifests.items() if "clients" not in manifest]
    policies = " ".join(map(shlex.quote, runs)) or "RUN/CLIENT"
    told = "Curves of a training do not say how good a policy is, for it explores while it learns. A test does: "
    return el("p", told, el("code", f"wcsim test {policies} --suite dev --jobs 2"))


def _curves(training: Training) -> list[tuple[Section, Sequence[Exhibit]]]:
    drawn = [found for each in _FIGURES if (found := _figure(training, *each)) is not None]
    body = el("div", *map(shown, drawn), class_="charts")
    return [(Section(name="curves", title="Curves", body=body), drawn)]


def _runs(training: Training) -> list[tuple[str, object]]:
    """Of one run all that is to be said of it, of several a line each."""
    said: list[tuple[str, object]] = []
    for name, manifest in training.manifests.items():
        by_rounds = {name, Path(name).resolve().name} & set(training.rounds)
        counted = "updates" if by_rounds else "steps"
        state = f"{manifest.get('status', '')}, {manifest.get('steps', 0)} {counted}"
        town, seed = manifest.get("town", ""), manifest.get("seed", "")
        if len(training.manifests) == 1:
            return [("town", town), ("seed", seed), ("status", state)]
        said.append(("run", f"{name}: town {town}, seed {seed}, {state}"))
    return said


def crossings(training: Training) -> dict[str, LimitCrossing]:
    """Where each client came below the limit of KPI 1."""
    return {name: crossing(episodes) for name, episodes in training.clients.items()}


def _figure(training: Training, key: str, number: str, label: str, says: str, of: _Value) -> Exhibit | None:
    """A figure of all clients; None where there is nothing to draw."""
    curves, plain = [], []
    for name, episodes in training.clients.items():
        told = [(episode, value) for episode in episodes if (value := of(episode)) is not None]
        means = running_means([value for _, value in told])
        curves.append(
            Curve(
                name=name,
                steps=[episode.step for episode, _ in told],
                values=[value for _, value in told],
                means=means,
                switch=switch_step(episodes),
                crossing=crossing(episodes).step if key == "kpi1" else None,
            )
        )
        rows: list[list[Cell]] = [
            [name, e.step, e.phase, value, round(mean, 6), int(e.crashed)]
            for (e, value), mean in zip(told, means, strict=True)
        ]
        plain += rows
    if not plain:
        return None
    limit = {"kpi1": KPI1_LIMIT, "overestimate": 0.0}.get(key)
    return figure(
        _NAMES[key],
        f"{number}{label}",
        f"{says}. One dot per episode, at its last step; lines are means of the last {OVER} episodes. Dashed, in the "
        "client's colour: the end of its first phase, in which the user's action is executed. Exploration is included.",
        csv_of(("client", "step", "phase", key, f"mean_of_{OVER}", "crashed"), plain),
        curve_chart(_NAMES[key], label, curves, limit),
    )


def _table(training: Training) -> Exhibit:
    rows: list[list[Cell]] = []
    found = crossings(training)
    for name, episodes in training.clients.items():
        crossed = found[name]
        rows.append([
            name, episodes[-1].step if episodes else 0, len(episodes), sum(e.crashed for e in episodes),
            crossed.step, crossed.left, *(_last_mean(episodes, of) for *_, of in _FIGURES),
        ])  # fmt: skip
    headings = (
        *("client", "steps", "episodes", "crashes", f"KPI 1 below {KPI1_LIMIT} from step", "above again since step"),
        *(f"{what}, last {OVER}" for what in ("KPI 1", "KPI 2", "value minus return")),
    )
    return Exhibit(
        name="clients",
        title="Clients",
        says="Steps until the last finished episode; means over the last episodes. KPI 1 counts as below its limit "
        "where the line of the figure is.",
        body=table(headings, [["–" if cell is None else cell for cell in row] for row in rows], "clients-table"),
        csv=csv_of(headings, rows),
    )


def _last_mean(episodes: Sequence[TrainedEpisode], of: _Value) -> float | None:
    values = [value for episode in episodes if (value := of(episode)) is not None][-OVER:]
    return round(math.fsum(values) / len(values), 4) if values else None
