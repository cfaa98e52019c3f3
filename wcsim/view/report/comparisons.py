"""What a test decides: policies compared over the same episodes, other weights, and the verdict in plain words."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Final

from wcsim.agents.evaluation.suite.records import EpisodeRecord, saved_and_lost
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.evaluation.suite.rows import FEWEST, Interval, ResultRow, bootstrapped, mcnemar, undone
from wcsim.agents.policy_api import BASELINES, UNAIDED, UPPER_BOUNDS
from wcsim.core.reading import counted

RIVALS: Final = ("follow", "dwa")  # the user alone, and the classical controller
_SURE: Final = 0.05
_NO_HELP: Final = (UNAIDED, "zero", "random", *UPPER_BOUNDS)  # they assist nobody, or could not be built
_MOST_LINES, _LINE = 3, 100  # of 80 characters where names are as short as `shipped`
_MOST_POLICIES, _MOST_ALIKE = 3, 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Paired:
    """A policy and another one over the same episodes."""

    policy: str
    rival: str
    part: str  # "" for all
    episodes: int
    saved: int  # own crashes that the rival has and the policy has not
    lost: int  # and the other way round
    mcnemar_p: float
    difference: float  # of the scores, the policy's less the rival's
    interval: Interval | None  # of the difference, 95 %; None of too few episodes

    @property
    def separated(self) -> bool:
        """Whether the interval of the difference leaves out 0; never without one."""
        return self.interval is not None and not self.interval[0] <= 0.0 <= self.interval[1]

    @property
    def enough(self) -> int | None:
        """About how many such episodes would separate them, were the difference as it is; None where nobody knows."""
        if self.difference == 0.0 or self.interval is None:
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
    found = (paired(result, name, rival, part) for part in ("", *result.parts) for name, rival in pairs)
    return tuple(item for item in found if item is not None)


def paired(result: TestResult, policy: str, rival: str, part: str) -> Paired | None:
    """Two policies over the episodes of a part that both have; None without any."""
    theirs = {(e.block, e.seat): e for e in result.episodes[rival]}
    both = [
        (episode, theirs[episode.block, episode.seat])
        for episode in result.episodes[policy]
        if part in ("", episode.part) and (episode.block, episode.seat) in theirs
    ]
    if not both:
        return None
    saved, lost = saved_and_lost((mine for mine, _ in both), (other for _, other in both))
    return Paired(
        policy=policy,
        rival=rival,
        part=part,
        episodes=len(both),
        saved=saved,
        lost=lost,
        mcnemar_p=mcnemar(saved, lost),
        difference=math.fsum(mine.score - other.score for mine, other in both) / len(both),
        interval=bootstrapped([mine.score - other.score for mine, other in both]),
    )


def verdicts(pairs: Sequence[Paired]) -> list[str]:
    """What the test decides between policies and one rival, and what it does not, in sentences.

    Args:
        pairs: Of one part, with one rival.
    """
    apart, sure = [pair for pair in pairs if pair.separated], [pair for pair in pairs if pair.mcnemar_p < _SURE]
    told = {
        "higher score": [pair.policy for pair in apart if pair.difference > 0.0],
        "lower score": [pair.policy for pair in apart if pair.difference < 0.0],
        "not different": [f"{pair.policy} ({_lacking(pair)})" for pair in pairs if not pair.separated],
        f"fewer own crashes, p below {_SURE}": [_counts(pair) for pair in sure if pair.saved > pair.lost],
        f"more own crashes, p below {_SURE}": [_counts(pair) for pair in sure if pair.saved < pair.lost],
    }
    return [f"{word}: {', '.join(some)}" for word, some in told.items() if some]


def _counts(pair: Paired) -> str:
    return f"{pair.policy} ({pair.saved} saved, {pair.lost} lost)"


def _lacking(pair: Paired) -> str:
    """Why two are not separated."""
    if pair.interval is None:
        return f"{counted(pair.episodes, 'episode')}; at least {FEWEST} are needed"
    if pair.enough is None:
        return "equal scores"
    return f"{pair.difference:+.3f}; would need about {counted(pair.enough, 'episode')}"


@dataclass(frozen=True, slots=True)
class _Weighting:
    """Another way to make one number of an episode."""

    heading: str
    says: str
    of: Callable[[EpisodeRecord], float]


def _product(record: EpisodeRecord, obedience: float = 1.0) -> float:
    done, pace, obeyed = record.score_parts
    return done * pace * math.pow(obeyed, obedience)


def _lawful(record: EpisodeRecord) -> bool:
    return record.driven and not record.red_entries


WEIGHTINGS: Final = (
    _Weighting("the score", "as in the tables", lambda record: record.score),
    _Weighting(
        "safety alone",
        "1 without an own crash or a red light, else 0: standing still is best",
        lambda record: float(_lawful(record)),
    ),
    _Weighting(
        "geometric mean",
        "cube root of route x pace x obedience; 0 as in the score",
        lambda record: math.cbrt(_product(record)) if _lawful(record) else 0.0,
    ),
    _Weighting(
        "obedience counts double",
        "route x pace x obedience squared; 0 as in the score",
        lambda record: _product(record, 2.0) if _lawful(record) else 0.0,
    ),
    _Weighting(
        "red lights forgiven",
        "as the score, but not 0 after a red light",
        lambda record: _product(record) if record.driven else 0.0,
    ),
    _Weighting(
        "way alone",
        "share of the route completed, however the episode ended",
        lambda record: record.score_parts[0] if record.steps else 0.0,
    ),
)


def weighted(result: TestResult) -> dict[str, list[tuple[float, int]]]:
    """By policy: its mean under each of WEIGHTINGS, and its rank; equal means share a rank."""
    means = {
        name: [math.fsum(way.of(e) for e in episodes) / len(episodes) for way in WEIGHTINGS]
        for name, episodes in result.episodes.items()
    }
    return {
        name: [
            (mean, 1 + sum(other[place] > mean + 1e-12 for other in means.values())) for place, mean in enumerate(own)
        ]
        for name, own in means.items()
    }


def verdict(result: TestResult) -> str:
    """Three sentences, and as many lines; no policy is called best by chance.

    Policies of the user's own come first; of many only some are named.
    """
    helping = [name for name in result.episodes if name not in _NO_HELP]
    helping.sort(key=lambda name: name.partition("@")[0] in BASELINES)
    driven = {row.policy: row for row in result.pooled if row.episodes}
    rows = [driven[name] for name in (UNAIDED, *helping[:_MOST_POLICIES]) if name in driven]
    said = ""
    for many in range(min(_MOST_POLICIES, len(helping)), -1, -1):
        chosen = [row for row in rows if row.policy in (UNAIDED, *helping[:many])]
        sentences = (_crashes(chosen), _told_apart(result), _price(chosen))
        said = " ".join(sentence for sentence in sentences if sentence)
        if many <= 1 or len(wrap(said, _LINE)) <= _MOST_LINES:
            break
    return said


def _crashes(rows: Sequence[ResultRow]) -> str:
    """How many drives ended with a crash by the chair's fault, without and with help."""
    if not rows:
        return ""
    drives = rows[0].episodes
    counts = []
    for row in rows:
        of = "" if row.episodes == drives else f" of {row.episodes}"
        left = undone(row)
        failed = f" (it failed in {left})" if left else ""
        counts.append(f"{row.crashes_own}{of} with {_called(row.policy)}{failed}")
    return f"Of {counted(drives, 'drive')}, the chair caused a crash in {_and(counts)}."


def _told_apart(result: TestResult) -> str:
    """Which policy has the best score, or which cannot be told apart from it."""
    scores = {row.policy: (row.score or 0.0) for row in result.pooled}
    real = sorted((name for name in scores if name not in UPPER_BOUNDS), key=lambda name: -scores[name])
    if len(real) < 2:
        return ""
    pairs = [paired(result, real[0], name, "") for name in real[1:]]
    if not any(pair is not None and pair.interval is not None for pair in pairs):
        return f"Fewer than {FEWEST} drives cannot tell policies apart."
    alike = {real[0], *(name for name, pair in zip(real[1:], pairs, strict=True) if pair is None or not pair.separated)}
    if len(alike) == 1:
        return f"{_first_upper(_called(real[0]))} has the highest score."
    if len(alike) > _MOST_ALIKE:
        among = ", the user alone among them," if UNAIDED in alike else ""
        return f"The best {len(alike)} of {len(real)} policies{among} cannot be told apart here."
    named = [_called(name) for name in scores if name in alike]  # in the order of the tables, which is no ranking
    return f"{_first_upper(_and(named))} cannot be told apart here."


def _price(rows: Sequence[ResultRow]) -> str:
    """How often each did what the user requested, and intervened without need."""
    moved = [row for row in rows if row.policy != UNAIDED and row.kpi1_free_within is not None]
    if not moved:
        return ""
    shares = [(row.policy, 100.0 * (row.kpi1_free_within or 0.0)) for row in moved]
    close = [f"{name} {share:.0f} %" for name, share in shares]
    close[0] = f"{shares[0][0]} did {shares[0][1]:.0f} % as requested"
    return f"In safe moments {_and(close)}{_unneeded(moved)}."


def _unneeded(rows: Sequence[ResultRow]) -> str:
    """Interventions without need of each policy, where its episodes were judged by counterfactual rollouts."""
    judged = [row.judged_episodes for row in rows]
    if not all(judged):
        return ""
    counts = [row.needless for row in rows]
    among = "" if judged == [row.episodes for row in rows] else f" in {counted(judged[0], 'judged drive')}"
    word = "unneeded intervention" if counts == [1] else "unneeded interventions"
    return f", with {_and([str(count) for count in counts])} {word}{among}"


def _called(name: str) -> str:
    return "the user alone" if name == UNAIDED else name


def _first_upper(text: str) -> str:
    """A sentence may begin with "The user alone", but names stay as they are typed."""
    return f"T{text[1:]}" if text.startswith("the user alone") else text


def _and(names: Sequence[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]
