"""The page of a training: how each client learned to follow its user without crashes (Fig. 7a, 7b), or its rounds.

Of several clients it says, too, which one learned the second phase, and who waited for whom.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final

from wcsim.agents.clients.group_run import CHOICE, KPI1, SELECTION, read_choice
from wcsim.agents.clients.paid_times import PaidTimes, read_paid_times
from wcsim.agents.evaluation.suite.result_files import RESULT, read_result
from wcsim.agents.runs.metrics import KPI1_STEPS
from wcsim.agents.runs.run_folder import read_json
from wcsim.config.run_file import TrainedRound
from wcsim.core.reading import counted, is_file
from wcsim.errors import PolicyError
from wcsim.view.report.figures import Curve, curve_chart
from wcsim.view.report.learning_curve import (
    KPI1_LIMIT,
    OVER,
    LogRow,
    TrainedEpisode,
    Training,
    crossing,
    running_means,
    switch_step,
)
from wcsim.view.report.pages import Cell, Exhibit, Section, page, write_page

Runs = Mapping[str, tuple[TrainedRound, ...]]
_THOUSAND: Final = 1000.0
_LOSS_SAYS: Final = (
    "Loss at the end of a round, smoothed over about 50 updates, over all 81 positions. Each round adds new driving "
    "data, so the loss may rise although the network gets better"
)
_CRASH_SAYS: Final = (
    "Crashes per 1,000 new steps of data: users and the oracle drive, and from the third round on, in a share of the "
    "episodes, the network of the round before the last. Their driving is disturbed on purpose, so this is no "
    "measure of the network"
)
_KPI1_SAYS: Final = (
    f"Distance between the agent's own best action and the user's stick, and its limit {KPI1_LIMIT}. In the first "
    f"phase the user's action is executed. A dot is 100 steps, a line the mean of the last {KPI1_STEPS}. Triangle: "
    "that mean falls below the limit. Dashed: the end of a client's first phase."
)
_EPISODES_SAY: Final = (
    f"One dot per episode, at its last step; lines are means of the last {OVER} episodes. Dashed, in the client's "
    "colour: the end of its first phase, in which the user's action is executed. Exploration is included. Episodes "
    "that the end of a world cut are left out."
)
_OVER_SAYS: Final = (
    "Value of the best action at the start of an episode minus the discounted return that followed, both scaled. "
    "Above 0 the network overestimates, more so without double Q-learning (learn.double_q). In the first phase the "
    f"user's actions were executed. {_EPISODES_SAY}"
)
_LENGTH_SAYS: Final = f"Steps until a crash, or until the limit of an episode. {_EPISODES_SAY}"


def _rounds(runs: Runs) -> Section:
    drawn = (
        _round_figure(runs, "round-loss", "loss", _LOSS_SAYS, lambda rounds: [each.loss for each in rounds]),
        _round_figure(runs, "round-crashes", "crashes per 1,000 steps", _CRASH_SAYS, _crash_rates),
    )
    return Section(name="rounds", title="Rounds of driving and learning", exhibits=(*drawn, _round_table(runs)))


def _crash_rates(rounds: Sequence[TrainedRound]) -> list[float]:
    """Crashes per 1,000 steps that each round added; NaN where it added none."""
    return [_THOUSAND * each.crashes / each.new_steps if each.new_steps else math.nan for each in rounds]


def rounds_summary(rounds: Sequence[TrainedRound]) -> str:
    """A run's rounds in a line.

    >>> at = {"round": 0, "steps": 2000, "new_steps": 2000, "updates": 50, "loss": 0.25, "wait_s": 1, "learn_s": 2}
    >>> rounds_summary((TrainedRound(tight_share=0.2, crashes=4, **at),))
    '1 round, 2000 steps, 50 updates, loss 0.250, 2.0 crashes per 1000 steps in the last'
    """
    last, rate = rounds[-1], _crash_rates(rounds)[-1]
    told = "" if math.isnan(rate) else f", {rate:.1f} crashes per 1000 steps in the last"
    return f"{counted(len(rounds), 'round')}, {last.steps} steps, {last.updates} updates, loss {last.loss:.3f}{told}"


def _round_figure(
    runs: Runs, name: str, label: str, says: str, of: Callable[[Sequence[TrainedRound]], Iterable[float]]
) -> Exhibit:
    curves, plain = [], list[list[Cell]]()
    for run, rounds in runs.items():
        known = [(each, value) for each, value in zip(rounds, of(rounds), strict=True) if math.isfinite(value)]
        values = [value for _, value in known]
        curves.append(Curve(name=run, steps=[each.steps for each, _ in known], values=values, means=values))
        plain += [[run, each.round + 1, each.steps, round(value, 6)] for each, value in known]
    return Exhibit(
        name=name,
        title=label[0].upper() + label[1:],
        says=f"{says}.",
        columns=("run", "round", "steps", label),
        rows=plain,
        svg=curve_chart(name, label, curves),
    )


def _round_table(runs: Runs) -> Exhibit:
    headings = (
        *("run", "round", "steps", "new", "of these with dangers", "crashes", "per 1,000 steps", "updates", "loss"),
        *("waited for worlds, s", "learned, s"),
    )
    rows: list[list[Cell]] = [
        [
            run, each.round + 1, each.steps, each.new_steps, f"{100.0 * each.tight_share:.0f} %", each.crashes,
            _rounded(rate, 1), each.updates, _rounded(each.loss, 3), round(each.wait_s), round(each.learn_s),
        ]
        for run, rounds in runs.items()
        for each, rate in zip(rounds, _crash_rates(rounds), strict=True)
    ]  # fmt: skip
    return Exhibit(
        name="rounds",
        title="Rounds",
        says="Steps: all samples so far. New: added in this round. With dangers: share of all steps in which some "
        "stick position ends in a crash. Crashes of this round. Updates so far. Times are wall-clock time.",
        columns=headings,
        rows=rows,
    )


def _rounded(value: float | None, digits: int = 4) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, digits)


def write_training_page(training: Training, folder: Path) -> Path:
    """Write the page of a training; where it is.

    Args:
        training: What the logs hold.
        folder: Where the page goes.

    Raises:
        PolicyError: No client has logged a step, and no round is done, or what a run saved of its clients is damaged.
        ConfigError: The same.
        DiskFullError: It cannot be written.
    """
    episodes = any(training.clients.values()) or any(training.steps.values())
    rounds = any(training.rounds.values())
    if not episodes and not rounds:
        raise PolicyError(f"{folder}: no client has logged a step yet; continue the training: wcsim resume {folder}")
    sections = [
        *([_curves(training)] if episodes else ()),
        *([_rounds(training.rounds)] if rounds else ()),
        *_client_sections(training),
        *([Section(name="clients", title="Clients", exhibits=(_clients(training),))] if episodes else ()),
    ]
    runs = [name for name, manifest in training.manifests.items() if "clients" not in manifest]
    text = page(
        "training.jinja",
        title=f"Training {folder.resolve().name}",
        about=[("clients", ", ".join((*training.clients, *training.rounds))), *_runs(training)],
        policies=" ".join(map(shlex.quote, runs)) or "RUN/CLIENT",
        sections=sections,
    )
    return write_page(folder, text, [exhibit for section in sections for exhibit in section.exhibits])


def _curves(training: Training) -> Section:
    steps, episodes = training.steps, _counted(training)
    kpi1, length = "Fig. 7a: KPI 1, mean joystick distance", "Fig. 7b: KPI 2, steps of an episode"
    crossed = {name: crossing(rows).step for name, rows in steps.items()}
    figures = (
        _drawn("kpi1", "fig-7a-kpi1", kpi1, _KPI1_SAYS, _values(steps, "kpi1"), KPI1_LIMIT, crossed),
        _drawn("length", "fig-7b-length", length, _LENGTH_SAYS, _values(episodes, "length")),
        _drawn(
            "overestimate", "overestimate", "value minus return", _OVER_SAYS, _values(episodes, "overestimate"), 0.0
        ),
    )
    return Section(name="curves", title="Curves", exhibits=[found for found in figures if found is not None])


def _runs(training: Training) -> list[tuple[str, str]]:
    """Of one run all that is to be said of it, of several a line each."""
    said = []
    for name, manifest in training.manifests.items():
        by_rounds = {name, Path(name).resolve().name} & set(training.rounds)
        counted = "updates" if by_rounds else "steps"
        state = f"{manifest.get('status', '')}, {manifest.get('steps', 0)} {counted}"
        town = ", ".join((manifest.get("town", ""), *manifest.get("more_towns", {})))
        seed = str(manifest.get("seed", ""))
        if len(training.manifests) == 1:
            return [("town", town), ("seed", seed), ("status", state)]
        said.append(("run", f"{name}: town {town}, seed {seed}, {state}"))
    return said


def _counted(training: Training) -> dict[str, list[TrainedEpisode]]:
    """The episodes of each client that ended by a crash or at their limit."""
    return {name: [each for each in episodes if not each.cut] for name, episodes in training.clients.items()}


def _values(told: Mapping[str, Sequence[LogRow]], key: str) -> dict[str, list[tuple[LogRow, float]]]:
    """The rows of each client that have a value, by its field's name, with it."""
    return {
        client: [(row, float(value)) for row in rows if (value := getattr(row, key)) is not None]
        for client, rows in told.items()
    }


def _drawn(
    key: str,
    name: str,
    title: str,
    says: str,
    told: Mapping[str, Sequence[tuple[LogRow, float]]],
    limit: float | None = None,
    crossed: Mapping[str, int | None] = MappingProxyType({}),
) -> Exhibit | None:
    """A curve for each client through its rows and their values; None where there is nothing to draw."""
    curves: list[Curve] = []
    plain: list[list[Cell]] = []
    for client, points in told.items():
        rows, values = [row for row, _ in points], [value for _, value in points]
        means = running_means(values)
        curves.append(
            Curve(
                name=client,
                steps=[row.step for row in rows],
                values=values,
                means=means,
                switch=switch_step(rows),
                crossing=crossed.get(client),
            )
        )
        for row, value, mean in zip(rows, values, means, strict=True):
            ends: list[Cell] = [int(row.crashed)] if isinstance(row, TrainedEpisode) else []
            plain.append([client, row.step, row.phase, value, round(mean, 6), *ends])
    if not plain:
        return None
    return Exhibit(
        name=name,
        title=title,
        says=says,
        columns=("client", "step", "phase", key, f"mean_of_{OVER}", *(("crashed",) if key != "kpi1" else ())),
        rows=plain,
        svg=curve_chart(name, title.rpartition(": ")[2], curves, limit),
    )


def _clients(training: Training) -> Exhibit:
    rows: list[list[Cell]] = []
    for name, episodes in _counted(training).items():
        steps = training.steps.get(name, ())
        crossed, last = crossing(steps), [*training.clients[name], *steps]
        rows.append([
            name, max((row.step for row in last), default=0), len(episodes), sum(e.crashed for e in episodes),
            sum(e.cut for e in training.clients[name]), crossed.step, crossed.left, _rounded(crossed.last),
            *(_last_mean(episodes, key) for key in ("length", "overestimate")),
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
        columns=headings,
        rows=rows,
    )


def _last_mean(episodes: Sequence[TrainedEpisode], key: str) -> float | None:
    values = [value for episode in episodes if (value := getattr(episode, key)) is not None][-OVER:]
    return round(math.fsum(values) / len(values), 4) if values else None


_SHOWN: Final = (
    *(("score", "score"), ("score_ci", "95 %"), ("crashes_own", "own crashes"), ("crashes_per_km", "per km")),
    *(("kpi1", "KPI 1"), ("kpi1_free_within", "obeyed"), ("kpi2_median", "KPI 2, median"), ("arrivals", "arrivals")),
)
_CONTINUES: Final = "second phase"
_PAID: Final = (
    *("client", "acting s", "learning s", "waiting for the world s", "for others and messages s"),
    *("of both learning s", "idle s"),
)
_WAITING_SAYS: Final = (
    "Seconds of each client, restarts included. A client waits for the world's own work, or for other clients and "
    "messages. It may learn meanwhile; the rest is idle time. Learning costs nothing while another client is waited "
    "for. The last columns: how long a client that had acted waited for each of the others; time for which several "
    "were late is divided among them. These columns leave out the world's work and messages."
)


def _client_sections(training: Training) -> list[Section]:
    """Sections for runs that compared their clients (`learn.select_by`), then for runs whose clients shared a world."""
    shown = []
    for title, exhibit_of in (("Which client learns the second phase", _selection), ("Who waits for whom", _waiting)):
        for number, run in enumerate(map(Path, training.manifests)):
            exhibit = exhibit_of(run, f"-{number + 1}" if number else "")
            shown += [] if exhibit is None else [Section(name=exhibit.name, title=title, exhibits=(exhibit,))]
    return shown


def _selection(run: Path, number: str) -> Exhibit | None:
    """The clients after their first phase, by a test or by KPI 1; None where none was selected."""
    if not is_file(run / SELECTION / CHOICE):
        return None
    by, says, columns, rows = _tested(run) if is_file(run / SELECTION / RESULT) else _compared(run)
    title = f"{run.resolve().name}: {by}"
    return Exhibit(name=f"selection{number}", title=title, says=says, columns=columns, rows=rows)


def _compared(run: Path) -> tuple[str, str, tuple[str, ...], list[list[Cell]]]:
    """The clients by KPI 1."""
    choice = read_json(run / SELECTION, CHOICE)
    try:
        figures = {str(name): float(of[KPI1]) for name, of in choice["clients"].items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise PolicyError(f"{run / SELECTION / CHOICE}: is damaged; expected KPI 1 of each client") from None
    best, by = read_choice(run, list(figures)), choice.get("by")
    why = "The client with the lowest one continues" if by == KPI1 else f"The user chose {best}"
    says = f"KPI 1 of the client's own choice, over the last {KPI1_STEPS} steps of its first phase. {why}."
    rows: list[list[Cell]] = [[name, kpi1, _CONTINUES if name == best else ""] for name, kpi1 in figures.items()]
    return "KPI 1 of the first phase", says, ("client", "KPI 1", "learned on"), rows


def _tested(run: Path) -> tuple[str, str, tuple[str, ...], list[list[Cell]]]:
    """The clients by a test on a list."""
    result = read_result(run / SELECTION)
    names = {row.policy: Path(row.policy.removesuffix(":phase1")).name for row in result.pooled}
    best = read_choice(run, list(names.values()))
    rows: list[list[Cell]] = [
        [name, *(_cell(getattr(row, key)) for key, _ in _SHOWN), _CONTINUES if name == best else ""]
        for row in result.pooled
        for name in (names[row.policy],)
    ]
    says = (
        f"Each client after its first phase, tested on {result.set}; follow is the user alone. The client with "
        f"the highest score continues. Details: wcsim report {shlex.quote(str(run / SELECTION))}"
    )
    headings = ("client", *(heading for _, heading in _SHOWN), "learned on")
    return f"{result.suite} {result.set}", says, headings, rows


def _cell(value: object) -> Cell:
    if isinstance(value, tuple):
        return " to ".join(f"{bound:.3f}" for bound in value)
    return value if isinstance(value, int | float | str) else None


def _waiting(run: Path, number: str) -> Exhibit | None:
    """Who paid what of clients that shared a world; None where none did."""
    times = read_paid_times(run)
    if times is None:
        return None
    title, (columns, rows) = f"{run.resolve().name}: waiting between clients", _waiting_rows(times)
    return Exhibit(name=f"waiting{number}", title=title, says=_WAITING_SAYS, columns=columns, rows=rows)


def _waiting_rows(times: PaidTimes) -> tuple[tuple[str, ...], list[list[Cell]]]:
    """The headings, and a row for each client: what it paid, and for whom it waited."""
    rows: list[list[Cell]] = []
    for name, shares in times.clients.items():
        waited = times.waited_s.get(name, {})
        waits = (shares.world_s, shares.others_s, shares.overlap_s, shares.waiting_s)
        paid = (shares.acting_s, shares.learning_s, *waits)
        held = [None if whom == name else round(waited.get(whom, 0.0), 1) for whom in times.clients]
        rows.append([name, *(round(part_s, 1) for part_s in paid), *held])
    return (*_PAID, *(f"for {name} s" for name in times.clients)), rows
