"""How danger networks were trained: their loss, and how often those crashed who drove for them, round by round."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from wcsim.agents.rounds.round_log import TrainedRound
from wcsim.core.reading import counted
from wcsim.view.report.charts import Curve, curve_chart
from wcsim.view.report.figures import figure
from wcsim.view.report.markup import Cell, Exhibit, csv_of, el, table
from wcsim.view.report.page import Section, shown

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


def round_sections(runs: Runs) -> list[tuple[Section, Sequence[Exhibit]]]:
    """The section of the page with what belongs to it; none where no run has rounds."""
    if not any(runs.values()):
        return []
    drawn = [
        _figure(runs, "round-loss", "loss", _LOSS_SAYS, lambda rounds: [each.loss for each in rounds]),
        _figure(runs, "round-crashes", "crashes per 1,000 steps", _CRASH_SAYS, _crash_rates),
    ]
    rows = _table(runs)
    body = el("div", el("div", *map(shown, drawn), class_="charts"), shown(rows))
    return [(Section(name="rounds", title="Rounds of driving and learning", body=body), (*drawn, rows))]


def _crash_rates(rounds: Sequence[TrainedRound]) -> list[float]:
    """Crashes per 1,000 steps that each round added; NaN where it added none."""
    return [_THOUSAND * each.crashes / each.new_steps if each.new_steps else math.nan for each in rounds]


def told_of(rounds: Sequence[TrainedRound]) -> str:
    """A run's rounds in a line.

    >>> at = {"round": 0, "steps": 2000, "new_steps": 2000, "updates": 50, "loss": 0.25, "wait_s": 1, "learn_s": 2}
    >>> told_of((TrainedRound(tight_share=0.2, crashes=4, **at),))
    '1 round, 2000 steps, 50 updates, loss 0.250, 2.0 crashes per 1000 steps in the last'
    """
    last, rate = rounds[-1], _crash_rates(rounds)[-1]
    told = "" if math.isnan(rate) else f", {rate:.1f} crashes per 1000 steps in the last"
    return f"{counted(len(rounds), 'round')}, {last.steps} steps, {last.updates} updates, loss {last.loss:.3f}{told}"


def _figure(
    runs: Runs, name: str, label: str, says: str, of: Callable[[Sequence[TrainedRound]], Iterable[float]]
) -> Exhibit:
    curves, plain = [], list[list[Cell]]()
    for run, rounds in runs.items():
        known = [(each, value) for each, value in zip(rounds, of(rounds), strict=True) if math.isfinite(value)]
        values = [value for _, value in known]
        curves.append(Curve(name=run, steps=[each.steps for each, _ in known], values=values, means=values))
        plain += [[run, each.round + 1, each.steps, round(value, 6)] for each, value in known]
    svg = curve_chart(name, label, curves)
    return figure(name, label[0].upper() + label[1:], f"{says}.", csv_of(("run", "round", "steps", label), plain), svg)


def _table(runs: Runs) -> Exhibit:
    headings = (
        *("run", "round", "steps", "new", "of these with dangers", "crashes", "per 1,000 steps", "updates", "loss"),
        *("waited for worlds, s", "learned, s"),
    )
    rows: list[list[Cell]] = [
        [
            run, each.round + 1, each.steps, each.new_steps, f"{100.0 * each.tight_share:.0f} %", each.crashes,
            _number(rate, 1), each.updates, _number(each.loss, 3), round(each.wait_s), round(each.learn_s),
        ]
        for run, rounds in runs.items()
        for each, rate in zip(rounds, _crash_rates(rounds), strict=True)
    ]  # fmt: skip
    return Exhibit(
        name="rounds",
        title="Rounds",
        says="Steps: all samples so far. New: added in this round. With dangers: share of all steps in which some "
        "stick position ends in a crash. Crashes of this round. Updates so far. Times are wall-clock time.",
        body=table(headings, [["–" if cell is None else cell for cell in row] for row in rows]),
        csv=csv_of(headings, rows),
    )


def _number(value: float, digits: int) -> Cell:
    return round(value, digits) if math.isfinite(value) else None
