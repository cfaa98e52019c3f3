"""The page of a training: how each client learned to follow its user without crashes (Fig. 7a, 7b), or its rounds."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from wcsim.agents.learning.metrics import KPI1_STEPS
from wcsim.errors import PolicyError
from wcsim.view.report.charts import Curve, curve_chart
from wcsim.view.report.figures import figure
from wcsim.view.report.markup import Cell, Exhibit, Markup, csv_of, el, joined, table
from wcsim.view.report.page import Section, facts, page, shown, write_page
from wcsim.view.report.training.learning_curve import (
    KPI1_LIMIT,
    OVER,
    LogRow,
    TrainedEpisode,
    Training,
    crossing,
    running_means,
    switch_step,
)
from wcsim.view.report.training.round_figures import round_sections

_KPI1_SAYS: Final = (
    f"Distance between the agent's own best action and the user's stick, and its limit {KPI1_LIMIT}. In the first "
    f"phase the user's action is executed. A dot is 100 steps, a line the mean of the last {KPI1_STEPS}. Triangle: "
    "that mean falls below the limit. Dashed: the end of a client's first phase"
)
_EPISODES_SAY: Final = (
    f"One dot per episode, at its last step; lines are means of the last {OVER} episodes. Dashed, in the client's "
    "colour: the end of its first phase, in which the user's action is executed. Exploration is included. Episodes "
    "that the end of a world cut are left out."
)
_OVER_SAYS: Final = (
    "Value of the best action at the start of an episode minus the discounted return that followed, both scaled. "
    "Above 0 the network overestimates, more so without double Q-learning (learn.double_q). In the first phase the "
    "user's actions were executed"
)
_Value = Callable[[TrainedEpisode], float | None]
_FIGURES: Final[Sequence[tuple[str, str, str, str, _Value]]] = (
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
        PolicyError: No client has logged a step, and no round is done.
        DiskFullError: It cannot be written.
    """
    episodes = any(training.clients.values()) or any(training.steps.values())
    rounds = round_sections(training.rounds)
    if not episodes and not rounds:
        raise PolicyError(f"{folder}: no client has logged a step yet; continue the training with --resume")
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
    figures = [_kpi1_figure(training), *(_figure(training, *each) for each in _FIGURES)]
    drawn = [found for found in figures if found is not None]
    body = el("div", *map(shown, drawn), class_="charts")
    return [(Section(name="curves", title="Curves", body=body), drawn)]


def _runs(training: Training) -> list[tuple[str, object]]:
    """Of one run all that is to be said of it, of several a line each."""
    said: list[tuple[str, object]] = []
    for name, manifest in training.manifests.items():
        by_rounds = {name, Path(name).resolve().name} & set(training.rounds)
        counted = "updates" if by_rounds else "steps"
        state = f"{manifest.get('status', '')}, {manifest.get('steps', 0)} {counted}"
        town = ", ".join((manifest.get("town", ""), *manifest.get("more_towns", {})))
        seed = manifest.get("seed", "")
        if len(training.manifests) == 1:
            return [("town", town), ("seed", seed), ("status", state)]
        said.append(("run", f"{name}: town {town}, seed {seed}, {state}"))
    return said


def _counted(training: Training) -> dict[str, list[TrainedEpisode]]:
    """The episodes of each client that ended by a crash or at their limit."""
    return {name: [each for each in episodes if not each.cut] for name, episodes in training.clients.items()}


def _kpi1_figure(training: Training) -> Exhibit | None:
    """Fig. 7a, over steps; None where there is nothing to draw."""
    told = {name: [(row, row.kpi1) for row in rows] for name, rows in training.steps.items()}
    crossed = {name: crossing(rows).step for name, rows in training.steps.items()}
    return _drawn("kpi1", "Fig. 7a: KPI 1, mean joystick distance", f"{_KPI1_SAYS}.", told, KPI1_LIMIT, crossed)


def _figure(training: Training, key: str, number: str, label: str, says: str, of: _Value) -> Exhibit | None:
    """A figure over the episodes of all clients; None where there is nothing to draw."""
    told = {
        name: [(episode, value) for episode in episodes if (value := of(episode)) is not None]
        for name, episodes in _counted(training).items()
    }
    limit = {"overestimate": 0.0}.get(key)
    return _drawn(key, f"{number}{label}", f"{says}. {_EPISODES_SAY}", told, limit, {})


def _drawn(
    key: str,
    title: str,
    says: str,
    told: Mapping[str, Sequence[tuple[LogRow, float]]],
    limit: float | None,
    crossed: Mapping[str, int | None],
) -> Exhibit | None:
    """A curve for each client through its rows and their values."""
    curves: list[Curve] = []
    plain: list[list[Cell]] = []
    for name, points in told.items():
        means = running_means([value for _, value in points])
        curves.append(
            Curve(
                name=name,
                steps=[row.step for row, _ in points],
                values=[value for _, value in points],
                means=means,
                switch=switch_step([row for row, _ in points]),
                crossing=crossed.get(name),
            )
        )
        for (row, value), mean in zip(points, means, strict=True):
            ends: list[Cell] = [int(row.crashed)] if isinstance(row, TrainedEpisode) else []
            plain.append([name, row.step, row.phase, value, round(mean, 6), *ends])
    if not plain:
        return None
    columns = ("client", "step", "phase", key, f"mean_of_{OVER}", *(("crashed",) if key != "kpi1" else ()))
    drawn = curve_chart(_NAMES[key], title.rpartition(": ")[2], curves, limit)
    return figure(_NAMES[key], title, says, csv_of(columns, plain), drawn)


def _table(training: Training) -> Exhibit:
    rows: list[list[Cell]] = []
    for name, episodes in _counted(training).items():
        steps = training.steps.get(name, ())
        crossed, last = crossing(steps), [*training.clients[name], *steps]
        rows.append([
            name, max((row.step for row in last), default=0), len(episodes), sum(e.crashed for e in episodes),
            sum(e.cut for e in training.clients[name]), crossed.step, crossed.left, _rounded(crossed.last),
            *(_last_mean(episodes, of) for *_, of in _FIGURES),
        ])  # fmt: skip
    headings = (
        *("client", "steps", "episodes", "crashes", "cut", f"KPI 1 below {KPI1_LIMIT} from step"),
        *("above again since step", f"KPI 1, last {KPI1_STEPS} steps"),
        *(f"{what}, last {OVER}" for what in ("KPI 2", "value minus return")),
    )
    return Exhibit(
        name="clients",
        title="Clients",
        says=f"KPI 1 is of the agent's own best actions; it counts as below its limit where the mean of {KPI1_STEPS} "
        "steps is. KPI 2 is the steps of an episode. Cut: episodes that the end of a world ended; no figure has them.",
        body=table(headings, [["–" if cell is None else cell for cell in row] for row in rows], "clients-table"),
        csv=csv_of(headings, rows),
    )


def _last_mean(episodes: Sequence[TrainedEpisode], of: _Value) -> float | None:
    values = [value for episode in episodes if (value := of(episode)) is not None][-OVER:]
    return round(math.fsum(values) / len(values), 4) if values else None


def _rounded(mean: float | None) -> float | None:
    return None if mean is None else round(mean, 4)
