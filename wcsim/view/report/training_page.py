"""The page of a training: how each client learned (Fig. 7a, 7b of the paper), or its rounds.

Of several clients it also says which one learned the second phase, and who waited for whom.
"""

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

from wcsim.agents.clients.group_run import CHOICE, KPI1, SELECTION, read_chosen_client_name
from wcsim.agents.clients.paid_times import read_group_run_times
from wcsim.agents.evaluation.suite.result_files import RESULT, read_result
from wcsim.agents.runs.metrics import KPI1_STEPS
from wcsim.agents.runs.run_folder import read_run_json
from wcsim.config.run_file import RoundMetricsRow
from wcsim.core.reading import is_file, pluralize
from wcsim.errors import PolicyError
from wcsim.view.report.figures import Curve, curve_chart
from wcsim.view.report.learning_curve import (
    KPI1_LIMIT,
    OVER,
    LogRow,
    TrainedEpisode,
    TrainedSteps,
    Training,
    crossing,
    running_means,
)
from wcsim.view.report.pages import Cell, Exhibit, page, write_page

Runs = Mapping[str, tuple[RoundMetricsRow, ...]]
_Section = tuple[str, str, Sequence[Exhibit]]  # its anchor, its title, and what it shows
_THOUSAND: Final = 1000.0


def _rounds(runs: Runs) -> _Section:
    """First whether networks learned: steps between crashes, beside those of the users alone."""
    every = [each for rounds in runs.values() for each in rounds]
    alone = _per_crash(
        sum(each.user_steps for each in every), sum(each.user_crashes for each in every)
    )
    line = None if math.isnan(alone) else (alone, f"the users alone: {alone:.0f}")
    alive = _round_figure(
        runs,
        "steps-between-crashes",
        "steps between crashes of the network (up is better)",
        lambda each: _per_crash(each.network_steps, each.network_crashes),
        line,
    )
    loss = _round_figure(runs, "round-loss", "loss", lambda each: each.loss)
    headings = (
        *(
            "run",
            "round",
            "steps",
            "new",
            "with dangers",
            "crashes",
            "per 1,000 steps",
            "network's steps",
            "crashes",
        ),
        *("user's steps", "crashes", "updates", "loss", "waited for worlds, s", "learned, s"),
    )
    rows: list[list[Cell]] = [
        [
            run, each.round + 1, each.steps, each.new_steps, f"{100.0 * each.tight_share:.0f} %",
            each.crashes, _rounded(_crash_rate(each), 1), each.network_steps, each.network_crashes,
            each.user_steps, each.user_crashes, each.updates, _rounded(each.loss, 3),
            round(each.wait_s), round(each.learn_s),
        ]
        for run, rounds in runs.items()
        for each in rounds
    ]  # fmt: skip
    table = Exhibit(name="rounds", title="Rounds", columns=headings, rows=rows)
    return (
        "rounds",
        "Rounds of driving and learning",
        (*([alive] if alive.rows else []), table, loss),
    )


def _per_crash(steps: int, crashes: int) -> float:
    """Steps for each crash; NaN without one."""
    return steps / crashes if crashes else math.nan


def _crash_rate(each: RoundMetricsRow) -> float:
    """Crashes per 1,000 steps that a round added; NaN where it added none."""
    return _THOUSAND * each.crashes / each.new_steps if each.new_steps else math.nan


def rounds_summary(rounds: Sequence[RoundMetricsRow]) -> str:
    """A run's rounds in a line.

    >>> at = dict.fromkeys(RoundMetricsRow.model_fields, 0) | {"steps": 2000, "new_steps": 2000}
    >>> rounds_summary((RoundMetricsRow(**at | {"updates": 50, "loss": 0.25, "crashes": 4}),))
    '1 round, 2000 steps, 50 updates, loss 0.250, 2.0 crashes per 1000 steps in the last'
    """
    last, rate = rounds[-1], _crash_rate(rounds[-1])
    told = "" if math.isnan(rate) else f", {rate:.1f} crashes per 1000 steps in the last"
    counts = f"{pluralize(len(rounds), 'round')}, {last.steps} steps, {last.updates} updates"
    return f"{counts}, loss {last.loss:.3f}{told}"


def _round_figure(
    runs: Runs,
    name: str,
    label: str,
    of: Callable[[RoundMetricsRow], float],
    line: tuple[float, str] | None = None,
) -> Exhibit:
    curves, plain = [], list[list[Cell]]()
    for run, rounds in runs.items():
        known = [(each, of(each)) for each in rounds if math.isfinite(of(each))]
        values = [value for _, value in known]
        curves.append(
            Curve(name=run, steps=[each.steps for each, _ in known], values=values, means=values)
        )
        plain += [[run, each.round + 1, each.steps, round(value, 6)] for each, value in known]
    svg = curve_chart(name, label, curves, line)
    return Exhibit(
        name=name,
        title=label.capitalize(),
        columns=("run", "round", "steps", name),
        rows=plain,
        svg=svg,
    )


def _rounded(value: float | None, digits: int = 4) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, digits)


def write_training_page(training: Training, folder: Path) -> Path:
    """Write the page of a training; where it is.

    Args:
        training: What the logs hold.
        folder: Where the page goes.

    Raises:
        PolicyError: No client has logged a step and no round is done, or files of clients are
            damaged.
        ConfigError: The same.
        DiskFullError: It cannot be written.
    """
    episodes = any(training.clients.values()) or any(training.steps.values())
    rounds = any(training.rounds.values())
    if not episodes and not rounds:
        raise PolicyError(
            f"{folder}: no client has logged a step yet; "
            f"continue the training: wcsim resume {folder}"
        )
    sections = [
        *([_curves(training)] if episodes else ()),
        *([_rounds(training.rounds)] if rounds else ()),
        *_client_sections(training),
        *([("clients", "Clients", (_clients(training),))] if episodes else ()),
    ]
    runs = [name for name, manifest in training.manifests.items() if "clients" not in manifest]
    text = page(
        "training.jinja",
        title=f"Training {', '.join(Path(name).resolve().name for name in training.manifests)}",
        clients=[*training.clients, *training.rounds],
        manifests=training.manifests,
        by_rounds=[
            name
            for name in training.manifests
            if {name, Path(name).resolve().name} & set(training.rounds)
        ],
        policies=" ".join(map(shlex.quote, runs)) or "RUN/CLIENT",
        sections=sections,
        limit=KPI1_LIMIT,
        mean_steps=KPI1_STEPS,
        over=OVER,
    )
    return write_page(
        folder, text, [exhibit for _, _, exhibits in sections for exhibit in exhibits]
    )


def _curves(training: Training) -> _Section:
    episodes, steps = _counted(training), training.steps
    own = {name: [each for each in found if each.phase > 1] for name, found in episodes.items()}
    limit = (KPI1_LIMIT, f"{KPI1_LIMIT}: close to the user's stick")
    figures = (
        _drawn(
            "kpi1",
            "fig-7a-kpi1",
            "Fig. 7a: KPI 1, mean joystick distance (down is better)",
            steps,
            limit,
        ),
        _drawn(
            "length",
            "fig-7b-length",
            "Fig. 7b: KPI 2, steps of an episode in phase 2 (up is better)",
            own,
        ),
        _drawn("overestimate", "overestimate", "value minus return", episodes, (0.0, "0")),
    )
    return "curves", "Curves", [found for found in figures if found is not None]


def _counted(training: Training) -> dict[str, list[TrainedEpisode]]:
    """The episodes of each client that ended by a crash or at their limit."""
    return {
        name: [each for each in episodes if not each.cut]
        for name, episodes in training.clients.items()
    }


def _drawn(
    key: str,
    name: str,
    title: str,
    logged: Mapping[str, Sequence[LogRow]],
    line: tuple[float, str] | None = None,
) -> Exhibit | None:
    """A curve for each client through its rows with a value; None if there are none."""
    curves: list[Curve] = []
    plain: list[list[Cell]] = []
    for client, told in logged.items():
        rows = [row for row in told if getattr(row, key) is not None]
        values = [float(getattr(row, key)) for row in rows]
        means = running_means(values)
        curves.append(
            Curve(
                name=client,
                steps=[row.step for row in rows],
                values=values,
                means=means,
                # The last step that the log has of the first phase; None where there was no change.
                switch=next(
                    (row.step for row, after in pairwise(rows) if row.phase < after.phase), None
                ),
                crossing=crossing([row for row in rows if isinstance(row, TrainedSteps)]).step,
            )
        )
        for row, value, mean in zip(rows, values, means, strict=True):
            ends: list[Cell] = [int(row.crashed)] if isinstance(row, TrainedEpisode) else []
            plain.append([client, row.step, row.phase, value, round(mean, 6), *ends])
    if not plain:
        return None
    columns = (
        "client",
        "step",
        "phase",
        key,
        f"mean_of_{OVER}",
        *(("crashed",) if key != "kpi1" else ()),
    )
    svg = curve_chart(name, title.rpartition(": ")[2], curves, line)
    return Exhibit(name=name, title=title, columns=columns, rows=plain, svg=svg)


def _clients(training: Training) -> Exhibit:
    rows: list[list[Cell]] = []
    for name, episodes in _counted(training).items():
        steps = training.steps.get(name, ())
        crossed, last = crossing(steps), [*training.clients[name], *steps]
        means: list[Cell] = []
        for key in ("length", "overestimate"):
            values = [value for episode in episodes if (value := getattr(episode, key)) is not None]
            means.append(round(running_means(values)[-1], 4) if values else None)
        rows.append([
            name, max((row.step for row in last), default=0), len(episodes),
            sum(e.crashed for e in episodes), sum(e.cut for e in training.clients[name]),
            crossed.step, crossed.left, _rounded(crossed.last), *means,
        ])  # fmt: skip
    headings = (
        *("client", "steps", "episodes", "crashes", "cut", f"KPI 1 below {KPI1_LIMIT} from step"),
        *("above again since step", f"KPI 1, last {KPI1_STEPS} steps"),
        *(f"{what}, last {OVER}" for what in ("KPI 2", "value minus return")),
    )
    return Exhibit(name="clients", title="Clients", columns=headings, rows=rows)


_SHOWN: Final = (
    *(
        ("score", "score"),
        ("score_ci", "95 %"),
        ("crashes_any", "crashes"),
        ("crashes_own", "own crashes"),
    ),
    *(("kpi1", "KPI 1"), ("followed", "obeyed"), ("kpi2", "KPI 2"), ("arrived", "arrivals")),
)
_CONTINUES: Final = "second phase"
_IN_TIME: Final = "of those that decide within learn.select_ms"
_PAID: Final = (
    *("client", "acting s", "learning s", "waiting for the world s", "for others and messages s"),
    *("of both learning s", "idle s"),
)


def _client_sections(training: Training) -> list[_Section]:
    """Sections of runs that compared clients (`learn.select_by`), then of those in one world."""
    shown: list[_Section] = []
    runs = {
        f"-{number + 1}" if number else "": Path(run)
        for number, run in enumerate(training.manifests)
    }
    for number, run in runs.items():
        if is_file(run / SELECTION / CHOICE):
            selection = (_tested if is_file(run / SELECTION / RESULT) else _compared)(
                run, f"selection{number}"
            )
            shown.append((selection.name, "Which client learns the second phase", (selection,)))
    for number, run in runs.items():
        waiting = _waiting(run, f"waiting{number}")
        if waiting is not None:
            shown.append((waiting.name, "Who waits for whom", (waiting,)))
    return shown


def _compared(run: Path, exhibit: str) -> Exhibit:
    """The clients by KPI 1."""
    choice = read_run_json(run / SELECTION, CHOICE)
    try:
        figures = {str(name): float(of[KPI1]) for name, of in choice["clients"].items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise PolicyError(
            f"{run / SELECTION / CHOICE}: is damaged; expected KPI 1 of each client"
        ) from None
    best, by = read_chosen_client_name(run, list(figures)), choice.get("by")
    why = (
        f"The client with the lowest one {_IN_TIME} continues"
        if by == KPI1
        else f"The user chose {best}"
    )
    return Exhibit(
        name=exhibit,
        title=f"{run.resolve().name}: KPI 1 of the first phase",
        says=f"KPI 1 of the client's own choice, over the last {KPI1_STEPS} steps of its first "
        f"phase. {why}.",
        columns=("client", "KPI 1", "learned on"),
        rows=[(name, kpi1, _CONTINUES if name == best else "") for name, kpi1 in figures.items()],
    )


def _tested(run: Path, exhibit: str) -> Exhibit:
    """The clients by a test on a list."""
    result = read_result(run / SELECTION)
    names = [Path(row.policy.removesuffix(":phase1")).name for row in result.pooled]
    best = read_chosen_client_name(run, list(dict.fromkeys(names)))
    return Exhibit(
        name=exhibit,
        title=f"{run.resolve().name}: {result.suite} {result.set}",
        says=f"Each client after its first phase, tested on {result.set}; follow is the user. "
        f"The client with the highest score {_IN_TIME} continues. "
        f"Details: wcsim report {shlex.quote(str(run / SELECTION))}",
        columns=("client", *(heading for _, heading in _SHOWN), "learned on"),
        rows=[
            (
                name,
                *(_cell(getattr(row, key)) for key, _ in _SHOWN),
                _CONTINUES if name == best else "",
            )
            for name, row in zip(names, result.pooled, strict=True)
        ],
    )


def _cell(value: object) -> Cell:
    if isinstance(value, tuple):
        return " to ".join(f"{bound:.3f}" for bound in value)
    return value if isinstance(value, int | float | str) else None


def _waiting(run: Path, exhibit: str) -> Exhibit | None:
    """Who paid what of clients that shared a world; None where none did."""
    times = read_group_run_times(run)
    if times is None:
        return None
    rows: list[list[Cell]] = []
    for name, shares in times.clients.items():
        waited = times.waited_s.get(name, {})
        waits = (shares.world_s, shares.others_s, shares.overlap_s, shares.waiting_s)
        paid = (shares.acting_s, shares.learning_s, *waits)
        held = [None if whom == name else round(waited.get(whom, 0.0), 1) for whom in times.clients]
        rows.append([name, *(round(part_s, 1) for part_s in paid), *held])
    title, columns = (
        f"{run.resolve().name}: waiting between clients",
        [f"for {name} s" for name in times.clients],
    )
    return Exhibit(name=exhibit, title=title, columns=(*_PAID, *columns), rows=rows)
