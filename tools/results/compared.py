"""Networks of several seeds against a baseline, over the same episodes, and what is wanted of all of them together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from tools.pages import table
from wcsim.agents.evaluation.suite.intervals import bootstrapped, garwood
from wcsim.agents.evaluation.suite.records import EpisodeRecord, saved_and_lost
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.evaluation.suite.rows import ResultRow
from wcsim.config.held_out import HELD_OUT
from wcsim.core import seeding

DRAWS: Final = 4000
USER: Final = "follow"
RIVAL: Final = "dwa"
BLINDED: Final = "oracle-visible"
BOUNDS: Final = ("oracle", BLINDED)  # they know what no camera shows, or what no picture says
UNMET: Final = HELD_OUT["profile"]
HARD: Final = ("hazard", "tight")
Counts = npt.NDArray[np.float64]
Rows = Mapping[tuple[str, str], ResultRow]  # by policy and part, "" for all


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """A pooled measure of all networks, and whether it reaches its target."""

    what: str
    bar: str
    got: str
    reached: bool


def compared_text(result: TestResult, runs: Sequence[str]) -> str:
    """Tables in Markdown: scores network by network less the rival's, the user never met, and what is wanted."""
    parts = [*dict.fromkeys(row.part for row in result.rows), ""]
    lines = ["", f"| part | {' | '.join(Path(run).name for run in runs)} |", "|---" * (len(runs) + 1) + "|"]
    lines += [
        f"| {part or 'all'} | {' | '.join(difference_text(result, run, part) for run in runs)} |" for part in parts
    ]
    lines += ["", f"| policy | own crashes, score: user {', '.join(UNMET)} | all other users |", "|---|---|---|"]
    lines += [by_user_text(result, name) for name in (USER, RIVAL, *runs)]
    goals = [(goal.what, goal.bar, goal.got, "yes" if goal.reached else "no") for goal in wanted(result, runs)]
    return "\n".join([*lines, "", *table(("measure", "target", "networks", "reached"), goals), ""])


def difference_text(result: TestResult, run: str, part: str) -> str:
    """A network's score less the rival's, and the own crashes that the rival has and it has not, and the other way."""
    mine, others = records_of(result, run, part), records_of(result, RIVAL, part)
    saved, lost = saved_and_lost(mine, others)
    return f"{_mean_text(scores_of(mine) - scores_of(others))}, {saved} and {lost}"


def by_user_text(result: TestResult, policy: str) -> str:
    """A row of what a policy does with the user that no network has met, and with the others."""
    records = records_of(result, policy)
    met = [record for record in records if record.profile not in UNMET]
    new = [record for record in records if record.profile in UNMET]
    cells = (
        f"{sum(record.own for record in some)} of {len(some)}, "
        f"{sum(record.score for record in some) / max(len(some), 1):.3f}"
        for some in (new, met)
    )
    return f"| {Path(policy).name} | {' | '.join(cells)} |"


def wanted(result: TestResult, runs: Sequence[str]) -> list[Wanted]:
    """Everything that is wanted of networks on a suite, taken together over their seeds."""
    rows = {(row.policy, row.part): row for row in (*result.rows, *result.pooled)}
    return [
        _left(result, runs),
        _half(result, runs),
        *_survived(rows, runs),
        *_obedience(rows, runs),
        _arrivals(rows, runs),
        _needless(rows, runs),
        _warned(rows, runs),
        _ahead(result, runs),
    ]


def records_of(result: TestResult, policy: str, part: str = "") -> list[EpisodeRecord]:
    """A policy's episodes of a part, "" for all, that count for every policy of the result."""
    return [item for item in result.counted(policy) if part in ("", item.part)]


def counts_of(records: Sequence[EpisodeRecord]) -> Counts:
    """(N, 2) own crashes and km, an episode a row."""
    return np.array([[record.own, record.m / 1000.0] for record in records], np.float64)


def scores_of(records: Sequence[EpisodeRecord]) -> Counts:
    """(N,) of each episode."""
    return np.array([record.score for record in records], np.float64)


def left_of(nets: Sequence[Counts], follow: Counts, oracle: Counts) -> tuple[float, float, float]:
    """What is left of the user's crashes above the oracle's, with its 95 % interval by drawing episodes anew.

    Args:
        nets: (N, 2) own crashes and km of the same N episodes, a network each.
        follow: (N, 2) of the user alone.
        oracle: (N, 2) of the blinded oracle.
    """
    together = np.sum(nets, axis=0)

    def left(picks: npt.NDArray[np.int64]) -> Counts:
        rates = [counts[picks].sum(-2) for counts in (together, follow, oracle)]
        net, user, best = (rate[..., 0] / np.maximum(rate[..., 1], 1e-9) for rate in rates)
        ratio: Counts = (net - best) / np.maximum(user - best, 1e-9)
        return ratio

    count = len(follow)
    low, high = np.percentile(left(_drawn(count)), (2.5, 97.5)).tolist()
    return float(left(np.arange(count))), float(low), float(high)


def _drawn(count: int) -> npt.NDArray[np.int64]:
    return seeding.make_rng(0, "bootstrap", count).integers(0, count, (DRAWS, count))


def _left(result: TestResult, runs: Sequence[str]) -> Wanted:
    nets = [counts_of(records_of(result, run)) for run in runs]
    follow, oracle = (counts_of(records_of(result, name)) for name in (USER, BLINDED))
    value, low, high = left_of(nets, follow, oracle)
    own, km = sum(float(net[:, 0].sum()) for net in nets), sum(float(net[:, 1].sum()) for net in nets)
    few, many = (bound / km for bound in garwood(round(own)))
    said = f"{value:.3f} ({low:.3f} to {high:.3f}); {own / km:.2f} a km ({few:.2f} to {many:.2f})"
    what = f"own crashes per km, scaled from `{BLINDED}` (0) to `{USER}` (1)"
    return Wanted(what=what, bar="0.15, interval below 0.35", got=said, reached=value <= 0.15 and high <= 0.35)


def _half(result: TestResult, runs: Sequence[str]) -> Wanted:
    nets = np.array([[record.own for record in records_of(result, run)] for run in runs], np.float64)
    rival = np.array([record.own for record in records_of(result, RIVAL)], np.float64)
    mean, picks = nets.mean(0), _drawn(len(rival))
    drawn = mean[picks].sum(1) / np.maximum(rival[picks].sum(1), 1.0)
    low, high = np.percentile(drawn, (2.5, 97.5)).tolist()
    ratio = mean.sum() / max(rival.sum(), 1.0)
    each = ", ".join(f"{own:.0f}" for own in nets.sum(1))
    said = f"{ratio:.2f} ({low:.2f} to {high:.2f}); {each} against {rival.sum():.0f}"
    return Wanted(what=f"own crashes, relative to `{RIVAL}`", bar="0.5", got=said, reached=bool(ratio <= 0.5))


def _survived(rows: Rows, runs: Sequence[str]) -> list[Wanted]:
    """One figure a hard part; reached is a gain of 20 points in one of them and no loss in the other."""

    def survived(policy: str, part: str) -> float:
        row = rows[policy, part]
        return 100.0 * (1.0 - row.crashes_own / row.episodes)

    gains = {part: float(np.mean([survived(run, part) for run in runs])) - survived(RIVAL, part) for part in HARD}
    reached = max(gains.values()) >= 20.0 and min(gains.values()) >= 0.0
    return [
        Wanted(
            what=f"episodes without own crash in {part}, minus `{RIVAL}`'s {survived(RIVAL, part):.0f} %",
            bar="20 points in one, none lost in the other",
            got=f"{gain:+.1f} points",
            reached=reached,
        )
        for part, gain in gains.items()
    ]


def _obedience(rows: Rows, runs: Sequence[str]) -> list[Wanted]:
    within = [rows[run, ""].kpi1_free_within or 0.0 for run in runs]
    paces = [(rows[run, ""].speed_mps or 0.0) / (rows[USER, ""].speed_mps or 1.0) for run in runs]
    return [
        Wanted(
            what="close to user, within 0.1768 on moving free steps", bar="95 %", got=_each(within, 100.0, 1, " %"),
            reached=float(np.mean(within)) >= 0.95,
        ),
        Wanted(
            what=f"speed, relative to `{USER}`", bar="0.95", got=_each(paces, 1.0, 2),
            reached=float(np.mean(paces)) >= 0.95,
        ),
    ]  # fmt: skip


def _arrivals(rows: Rows, runs: Sequence[str]) -> Wanted:
    crossing = [rows[name, "crossing"] for name in (RIVAL, *runs)]
    rival, *shares = (row.arrived / max(row.attempts, 1) for row in crossing)
    return Wanted(
        what="arrivals in part crossing",
        bar=f"`{RIVAL}`'s {100 * rival:.1f} %, minus 3 points",
        got=_each(shares, 100.0, 1, " %"),
        reached=float(np.mean(shares)) >= rival - 0.03,
    )


def _needless(rows: Rows, runs: Sequence[str]) -> Wanted:
    most, *counts = (rows[name, ""].unneeded for name in (RIVAL, *runs))
    reached = float(np.mean(counts)) <= most
    return Wanted(what="unneeded interventions", bar=f"`{RIVAL}`'s {most}", got=_each(counts, 1.0, 0), reached=reached)


def _warned(rows: Rows, runs: Sequence[str]) -> Wanted:
    shares = [rows[run, ""].warned_share or 0.0 for run in runs]
    reached = float(np.mean(shares)) >= 0.9
    return Wanted(what="warned 1 s ahead", bar="90 %", got=_each(shares, 100.0, 0, " %"), reached=reached)


def _ahead(result: TestResult, runs: Sequence[str]) -> Wanted:
    """The mean score against the best baseline that is no bound."""
    scores = {name: scores_of(records_of(result, name)) for name in result.episodes if name not in BOUNDS}
    means = {name: float(each.mean()) for name, each in scores.items()}
    best = max((name for name in means if name not in runs), key=means.__getitem__)
    less = np.mean([scores[run] for run in runs], axis=0) - scores[best]
    said = f"{_each([means[run] for run in runs], 1.0, 3)}; {_mean_text(less)}"
    reached = all(means[run] > means[best] for run in runs)
    return Wanted(what="score", bar=f"above `{best}`'s {means[best]:.3f}", got=said, reached=reached)


def _mean_text(values: Counts) -> str:
    """A mean over episodes and its 95 % interval, with their signs."""
    low, high = bootstrapped(values) or (float("nan"), float("nan"))
    return f"{values.mean():+.3f} ({low:+.3f} to {high:+.3f})"


def _each(values: Sequence[float], factor: float, digits: int, unit: str = "") -> str:
    return ", ".join(f"{factor * value:.{digits}f}" for value in values) + unit
