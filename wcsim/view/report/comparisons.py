"""What a test decides: policies compared over the same episodes, and the score under other weights."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from wcsim.agents.evaluation.intervals import FEWEST, Interval, bootstrapped, mcnemar
from wcsim.agents.evaluation.suite.records import EpisodeRecord, saved_and_lost
from wcsim.agents.evaluation.suite.result_files import KeptResult
from wcsim.core.reading import counted

RIVALS: Final = ("follow", "dwa")  # the user alone, and the classical controller
_SURE: Final = 0.05


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


def compared(result: KeptResult) -> tuple[Paired, ...]:
    """Every policy with each rival that was driven, by part, all parts first."""
    parts = ("", *dict.fromkeys(row["part"] for row in result.rows))
    rivals = [name for name in RIVALS if name in result.episodes]
    pairs = [
        (name, rival)
        for place, rival in enumerate(rivals)
        for name in result.episodes
        if name not in rivals[: place + 1]
    ]
    found = (paired(result, name, rival, part) for part in parts for name, rival in pairs)
    return tuple(item for item in found if item is not None)


def paired(result: KeptResult, policy: str, rival: str, part: str) -> Paired | None:
    """Two policies over the episodes of a part that both have; None without any."""
    theirs = {(e.record.block, e.record.seat): e.record for e in result.episodes[rival]}
    both = [
        (episode.record, theirs[episode.record.block, episode.record.seat])
        for episode in result.episodes[policy]
        if part in ("", episode.record.part) and (episode.record.block, episode.record.seat) in theirs
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
    found = []
    for word, chosen in (
        ("higher score", [pair.policy for pair in pairs if pair.separated and pair.difference > 0.0]),
        ("lower score", [pair.policy for pair in pairs if pair.separated and pair.difference < 0.0]),
    ):
        if chosen:
            found.append(f"{word}: {', '.join(chosen)}")
    left = [f"{pair.policy} ({_lacking(pair)})" for pair in pairs if not pair.separated]
    if left:
        found.append(f"not different: {', '.join(left)}")
    sure = [pair for pair in pairs if pair.mcnemar_p < _SURE]
    for word, some in (
        ("fewer own crashes", [pair for pair in sure if pair.saved > pair.lost]),
        ("more own crashes", [pair for pair in sure if pair.saved < pair.lost]),
    ):
        if some:
            told = ", ".join(f"{pair.policy} ({pair.saved} saved, {pair.lost} lost)" for pair in some)
            found.append(f"{word}, p below {_SURE}: {told}")
    return found


def _lacking(pair: Paired) -> str:
    """Why two are not separated."""
    if pair.interval is None:
        return f"{counted(pair.episodes, 'episode')}; at least {FEWEST} are needed"
    if pair.enough is None:
        return "equal scores"
    return f"{pair.difference:+.3f}; would need about {counted(pair.enough, 'episode')}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Weighting:
    """Another way to make one number of an episode."""

    name: str
    says: str
    of: Callable[[EpisodeRecord], float]


def _product(record: EpisodeRecord, obedience: float = 1.0) -> float:
    done, pace, obeyed = record.score_parts
    return done * pace * math.pow(obeyed, obedience)


def _lawful(record: EpisodeRecord) -> bool:
    return record.driven and not record.red_entries


WEIGHTINGS: Final = (
    Weighting(name="the score", says="as in the tables", of=lambda record: record.score),
    Weighting(
        name="safety alone",
        says="1 without an own crash or a red light, else 0: standing still is best",
        of=lambda record: float(_lawful(record)),
    ),
    Weighting(
        name="geometric mean",
        says="cube root of route x pace x obedience; 0 as in the score",
        of=lambda record: math.cbrt(_product(record)) if _lawful(record) else 0.0,
    ),
    Weighting(
        name="obedience counts double",
        says="route x pace x obedience squared; 0 as in the score",
        of=lambda record: _product(record, 2.0) if _lawful(record) else 0.0,
    ),
    Weighting(
        name="red lights forgiven",
        says="as the score, but not 0 after a red light",
        of=lambda record: _product(record) if record.driven else 0.0,
    ),
    Weighting(
        name="way alone",
        says="share of the route completed, however the episode ended",
        of=lambda record: record.score_parts[0] if record.steps else 0.0,
    ),
)


def weighted(result: KeptResult) -> dict[str, list[tuple[float, int]]]:
    """By policy: its mean under each of WEIGHTINGS, and its rank; equal means share a rank."""
    means = {
        name: [math.fsum(way.of(e.record) for e in episodes) / len(episodes) for way in WEIGHTINGS]
        for name, episodes in result.episodes.items()
    }
    return {
        name: [
            (mean, 1 + sum(other[place] > mean + 1e-12 for other in means.values())) for place, mean in enumerate(own)
        ]
        for name, own in means.items()
    }
