"""What a test decides: policies compared over the same episodes, and the verdict in plain words."""

import math
from dataclasses import dataclass
from textwrap import wrap
from typing import Any, Final

from wcsim.agents.evaluation.suite.intervals import FEWEST, Interval, bootstrapped, mcnemar
from wcsim.agents.evaluation.suite.records import both_counted, saved_and_lost
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.policy_api import BASELINES, UNAIDED, UPPER_BOUNDS
from wcsim.view.report.pages import page

RIVALS: Final = ("follow", "dwa")  # the user alone, and the classical controller
_NO_HELP: Final = (UNAIDED, "zero", "random", *UPPER_BOUNDS)  # they assist nobody, or could not be built
_MOST_LINES, _LINE = 4, 100  # of 80 characters where names are as short as `shipped`
_MOST_POLICIES, _MOST_ALIKE = 3, 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Paired:
    """A policy and another one over the same episodes."""

    policy: str
    rival: str
    part: str  # "" for all
    episodes: int
    saved: int  # crashes that the rival has and the policy has not
    lost: int  # and the other way round
    mcnemar_p: float
    difference: float | None  # of the scores, the policy's less the rival's; None where none count
    interval: Interval | None  # of the difference, 95 %; None of too few episodes

    @property
    def separated(self) -> bool:
        """Whether the interval of the difference leaves out 0; never without one."""
        return self.interval is not None and not self.interval[0] <= 0.0 <= self.interval[1]

    @property
    def enough(self) -> int | None:
        """About how many such episodes would separate them, were the difference as it is; None where nobody knows."""
        if not self.difference or self.interval is None:
            return None
        half = 0.5 * (self.interval[1] - self.interval[0])
        return max(self.episodes, math.ceil(self.episodes * (half / abs(self.difference)) ** 2))


def compared(result: TestResult) -> tuple[Paired, ...]:
    """Every policy with each rival that was driven, by part, all parts first."""
    rivals = [name for name in RIVALS if name in result.episodes]
    pairs = [
        (name, rival)
        for place, rival in enumerate(rivals)
        for name in result.episodes
        if name not in rivals[: place + 1]
    ]
    found = (_paired(result, name, rival, part) for part in ("", *result.parts) for name, rival in pairs)
    return tuple(item for item in found if item is not None)


def _paired(result: TestResult, policy: str, rival: str, part: str) -> Paired | None:
    """Two policies over the episodes of a part that both have; None without any."""
    theirs = {(e.block, e.seat): e for e in result.episodes[rival]}
    shared = [e for e in result.episodes[policy] if part in ("", e.part) and (e.block, e.seat) in theirs]
    both = both_counted(shared, [theirs[e.block, e.seat] for e in shared])
    if not both:
        return None
    saved, lost = saved_and_lost((mine for mine, _ in both), (other for _, other in both))
    scores = [(mine.score, other.score) for mine, other in both]
    changes = [mine - other for mine, other in scores if mine is not None and other is not None]
    return Paired(
        policy=policy,
        rival=rival,
        part=part,
        episodes=len(both),
        saved=saved,
        lost=lost,
        mcnemar_p=mcnemar(saved, lost),
        difference=math.fsum(changes) / len(changes) if changes else None,
        interval=bootstrapped(changes),
    )


def verdict(result: TestResult) -> str:
    """Three sentences, on at most four lines; no policy is called best by chance.

    Policies of the user's own come first; of many only some are named.
    """
    helping = [name for name in result.episodes if name not in _NO_HELP]
    helping.sort(key=lambda name: name.partition("@")[0] in BASELINES)
    driven = {row.policy: row for row in result.pooled if row.episodes}
    rows = [driven[name] for name in (UNAIDED, *helping[:_MOST_POLICIES]) if name in driven]
    told_apart, said = _told_apart(result), ""
    for many in range(min(_MOST_POLICIES, len(helping)), -1, -1):
        chosen = [row for row in rows if row.policy in (UNAIDED, *helping[:many])]
        said = page("verdict.txt.jinja", rows=chosen, unaided=UNAIDED, **told_apart).strip()
        if many <= 1 or len(wrap(said, _LINE)) <= _MOST_LINES:
            break
    return said


def _told_apart(result: TestResult) -> dict[str, Any]:
    """The policies that could be built, compared with the one of the highest score, and those that are like it."""
    bounded = (row for row in result.pooled if row.policy not in UPPER_BOUNDS)
    scores = {row.policy: row.score for row in bounded if row.score is not None}
    best, *others = sorted(scores, key=lambda name: -scores[name]) or [""]
    pairs = {name: _paired(result, best, name, "") for name in others}
    return {
        "policies": len(scores),
        "few": all(pair is None or pair.interval is None for pair in pairs.values()),
        # in the order of the tables, which is no ranking
        "alike": [name for name in scores if (pair := pairs.get(name)) is None or not pair.separated],
        "most_alike": _MOST_ALIKE,
        "fewest": FEWEST,
    }
