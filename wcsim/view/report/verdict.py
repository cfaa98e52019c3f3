"""The verdict of a test on a suite, in plain words: crashes, what can be told apart, and the price of the help."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import Final

from wcsim.agents.evaluation.intervals import FEWEST
from wcsim.agents.evaluation.suite.records import NEEDLESS, EpisodeRecord
from wcsim.agents.evaluation.suite.result_files import KeptResult
from wcsim.agents.evaluation.suite.run import UNAIDED
from wcsim.agents.policies.baseline_names import NAMES, UPPER_BOUNDS
from wcsim.core.reading import counted
from wcsim.view.report.comparisons import paired

_NO_HELP: Final = (UNAIDED, "zero", "random", *UPPER_BOUNDS)  # they assist nobody, or could not be built
_MOST_LINES, _LINE = 3, 100  # of 80 characters where names are as short as `shipped`
_MOST_POLICIES, _MOST_ALIKE = 3, 3


def verdict(result: KeptResult) -> str:
    """Three sentences, and as many lines; no policy is called best by chance.

    Policies of the user's own come first; of many only some are named.
    """
    helping = [name for name in result.episodes if name not in _NO_HELP]
    helping.sort(key=lambda name: name.partition("@")[0] in NAMES)
    said = ""
    for many in range(min(_MOST_POLICIES, len(helping)), -1, -1):
        chosen = helping[:many]
        sentences = (_crashes(result, chosen), _told_apart(result), _price(result, chosen))
        said = " ".join(sentence for sentence in sentences if sentence)
        if many <= 1 or len(wrap(said, _LINE)) <= _MOST_LINES:
            break
    return said


def _records(result: KeptResult, name: str) -> list[EpisodeRecord]:
    return [episode.record for episode in result.episodes.get(name, ())]


def _crashes(result: KeptResult, helping: Sequence[str]) -> str:
    """How many drives ended with a crash by the chair's fault, without and with help."""
    driven = {name: _records(result, name) for name in (UNAIDED, *helping)}
    driven = {name: records for name, records in driven.items() if records}
    if not driven:
        return ""
    drives = len(next(iter(driven.values())))
    counts = []
    for name, records in driven.items():
        of = "" if len(records) == drives else f" of {len(records)}"
        left = sum(not record.held for record in records)
        failed = f" (it failed in {left})" if left else ""
        own = sum(record.own for record in records)
        counts.append(f"{own}{of} with {_called(name)}{failed}")
    return f"Of {counted(drives, 'drive')}, the chair caused a crash in {_and(counts)}."


def _told_apart(result: KeptResult) -> str:
    """Which policy has the best score, or which cannot be told apart from it."""
    scores = {row["policy"]: float(row.get("score") or 0.0) for row in result.pooled}
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


def _price(result: KeptResult, helping: Sequence[str]) -> str:
    """How often each did what the user requested, and intervened without need."""
    driven = [(name, _records(result, name)) for name in helping]
    moved = [(name, records) for name, records in driven if sum(record.moving_steps for record in records)]
    if not moved:
        return ""
    shares = [(name, _close_percent(records)) for name, records in moved]
    close = [f"{name} {share:.0f} %" for name, share in shares]
    close[0] = f"{shares[0][0]} did {shares[0][1]:.0f} % as requested"
    return f"In safe moments {_and(close)}{_needless([records for _, records in moved])}."


def _close_percent(records: Sequence[EpisodeRecord]) -> float:
    moving = sum(record.moving_steps for record in records)
    return 100.0 * sum(record.moving_within for record in records) / moving


def _needless(policies: Sequence[Sequence[EpisodeRecord]]) -> str:
    """Interventions without need of each policy, where its episodes were judged by counterfactual rollouts."""
    judged = [[record for record in records if record.judged] for records in policies]
    if not all(judged):
        return ""
    unneeded = [sum(item.verdict == NEEDLESS for record in seen for item in record.interventions) for seen in judged]
    whole = [len(seen) for seen in judged] == [len(records) for records in policies]
    among = "" if whole else f" in {counted(len(judged[0]), 'judged drive')}"
    word = "unneeded intervention" if unneeded == [1] else "unneeded interventions"
    return f", with {_and([str(count) for count in unneeded])} {word}{among}"


def _called(name: str) -> str:
    return "the user alone" if name == UNAIDED else name


def _first_upper(text: str) -> str:
    """A sentence may begin with "The user alone", but names stay as they are typed."""
    return f"T{text[1:]}" if text.startswith("the user alone") else text


def _and(names: Sequence[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]
