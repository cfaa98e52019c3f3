"""What a test decides: policies compared over the same episodes, and the verdict in plain words."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any, Final

import numpy as np

from wcsim.agents.evaluation.suite.intervals import FEWEST, Interval, bootstrapped, mcnemar
from wcsim.agents.evaluation.suite.records import EpisodeRecord, saved_and_lost
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.policy_api import BASELINES, UNAIDED, UPPER_BOUNDS
from wcsim.view.report.pages import page

RIVALS: Final = ("follow", "dwa")  # the user alone, and the classical controller
_NO_HELP: Final = (
    UNAIDED,
    "zero",
    "random",
    *UPPER_BOUNDS,
)  # they assist nobody, or could not be built
_MOST_LINES, _LINE = 4, 100  # of 80 characters where names are as short as `shipped`
_MOST_POLICIES, _MOST_ALIKE = 3, 3
_NUMBER: Final = re.compile(r"-\d+$")


@dataclass(frozen=True, slots=True, kw_only=True)
class Paired:
    """A policy and another one over the same episodes."""

    policy: str
    rival: str
    part: str  # "" for all
    episodes: int
    saved: int  # crashes that the rival has and the policy has not
    lost: int  # and the other way round
    mcnemar_p: float | None  # None of several trainings, whose episodes are the same
    difference: float | None  # of the scores, the policy's less the rival's; None where none count
    interval: Interval | None  # of the difference, 95 %; None of too few episodes

    @property
    def separated(self) -> bool:
        """Whether the interval of the difference leaves out 0; never without one."""
        return self.interval is not None and not self.interval[0] <= 0.0 <= self.interval[1]


def compared(result: TestResult) -> tuple[Paired, ...]:
    """Every policy with each rival that was driven, by part, all parts first."""
    rivals = [name for name in RIVALS if name in result.episodes]
    # Runs that differ only by a number at the end are trainings of one kind, compared as one too.
    kinds: dict[str, list[str]] = {name: [name] for name in result.episodes}
    for name in result.episodes:
        if _NUMBER.search(name):
            kinds.setdefault(_NUMBER.sub("-*", name), []).append(name)
    pairs = [
        (kind, names, rival)
        for place, rival in enumerate(rivals)
        for kind, names in kinds.items()
        if kind not in rivals[: place + 1] and (len(names) > 1 or kind in result.episodes)
    ]
    found = (_paired(result, *pair, part) for part in ("", *result.parts) for pair in pairs)
    return tuple(item for item in found if item is not None)


def _paired(
    result: TestResult, kind: str, names: Sequence[str], rival: str, part: str
) -> Paired | None:
    """Trainings of one kind and a rival over a part's common episodes; None without any."""
    found = [
        {(e.block, e.seat): e for e in result.episodes[name] if e.counts}
        for name in (*names, rival)
    ]
    shared = [
        key
        for key, e in found[0].items()
        if part in ("", e.part) and all(key in each for each in found)
    ]
    if not shared:
        return None
    *own, others = ([each[key] for key in shared] for each in found)
    changes = [_changes(each, others) for each in own]
    saved, lost = np.sum([saved_and_lost(each, others) for each in own], axis=0).tolist()
    return Paired(
        policy=kind,
        rival=rival,
        part=part,
        episodes=len(shared),
        saved=saved,
        lost=lost,
        mcnemar_p=mcnemar(saved, lost) if len(names) == 1 else None,
        difference=float(np.mean(changes)) if changes[0] else None,
        interval=bootstrapped(changes),
    )


def _changes(records: Iterable[EpisodeRecord], others: Iterable[EpisodeRecord]) -> list[float]:
    scores = ((one.score, other.score) for one, other in zip(records, others, strict=True))
    return [one - other for one, other in scores if one is not None and other is not None]


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
    """Policies that could be built, compared with that of the highest score; those like it."""
    scores = {
        row.policy: row.score
        for row in result.pooled
        if row.policy not in UPPER_BOUNDS and row.score is not None
    }
    best, *others = sorted(scores, key=lambda name: -scores[name]) or [""]
    pairs = {name: _paired(result, best, [best], name, "") for name in others}
    return {
        "policies": len(scores),
        "oracles": any(row.policy in UPPER_BOUNDS for row in result.pooled),
        "few": all(pair is None or pair.interval is None for pair in pairs.values()),
        # in the order of the tables, which is no ranking
        "alike": [
            name for name in scores if (pair := pairs.get(name)) is None or not pair.separated
        ],
        "most_alike": _MOST_ALIKE,
        "fewest": FEWEST,
    }
