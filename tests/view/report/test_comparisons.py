"""What a test decides."""

import math
import re

import pytest

from tests.view.report.results import POLICIES, records_of, with_episodes
from wcsim.agents.evaluation.suite.intervals import FEWEST
from wcsim.view.report.comparisons import _paired, compared
from wcsim.view.report.pages import TEMPLATES
from wcsim.view.report.suite_page import _comparison_table


def said(pairs):
    """The last cell of each pair on the page: whether it is different."""
    text = str(TEMPLATES.get_template("comparisons.jinja").module.pair_table("", pairs, FEWEST))
    return [re.findall(r"<td[^>]*>([^<]*)", row)[-1] for row in text.split("<tr>")[2:]]


def test_pairs_are_counted_over_the_same_episodes(result):
    pair = _paired(result, "dwa", ["dwa"], "follow", "")
    scores = [a.score - b.score for a, b in zip(records_of("dwa")[4:], records_of("follow")[4:], strict=True)]
    assert (pair.episodes, pair.saved, pair.lost) == (12, 8, 0)
    assert pair.difference == pytest.approx(math.fsum(scores) / 8)
    assert pair.mcnemar_p == pytest.approx(2 / 2**8)
    low, high = pair.interval
    assert low <= pair.difference <= high and pair.separated == (low > 0)
    back = _paired(result, "follow", ["follow"], "dwa", "")
    assert (back.saved, back.lost) == (0, 8) and back.difference == pytest.approx(-pair.difference)


def test_every_policy_meets_every_rival_once_in_each_part(result):
    pairs = compared(result)
    assert {pair.part for pair in pairs} == {"free", "hazard", ""}
    assert [(pair.policy, pair.rival) for pair in pairs if not pair.part] == [
        *((name, "follow") for name in POLICIES if name != "follow"),
        *((name, "dwa") for name in POLICIES if name not in ("follow", "dwa")),
    ]


def test_the_page_says_what_is_separated(result):
    pairs = [pair for pair in compared(result) if not pair.part]
    assert said(pairs) == ["yes" if pair.separated else "no" for pair in pairs]
    assert set(said(pairs)) == {"yes", "no"}


def test_trainings_of_one_kind_are_drawn_before_the_episodes(result):
    """Two that save all and two that save none: one kind, of which nobody knows what the next one does."""
    good, bad = result.episodes["dwa"], result.episodes["follow"]
    runs = {f"runs/net-{number}": found for number, found in enumerate((good, good, bad, bad), 1)}
    found = compared(with_episodes(result, {"follow": bad, **runs, "a-1": good}))
    pairs = {pair.policy: pair for pair in found if not pair.part}
    assert "a-*" not in pairs and pairs["a-1"].mcnemar_p == pytest.approx(2 / 2**8)
    one, kind = pairs["runs/net-1"], pairs["runs/net-*"]
    assert one.separated and not kind.separated and kind.mcnemar_p is None
    assert kind.difference == pytest.approx(0.5 * one.difference) and (kind.saved, kind.lost) == (16, 0)


def test_few_episodes_separate_nobody_however_far_apart_they_are(result):
    few = with_episodes(result, {name: found[:6] for name, found in result.episodes.items()})
    pairs = [pair for pair in compared(few) if pair.part == "hazard"]
    assert pairs and all(pair.episodes == 2 and not pair.separated for pair in pairs)
    assert any(pair.difference for pair in pairs)
    assert said(pairs) == ["–"] * len(pairs)
    assert all(line.endswith(",,") for line in _comparison_table(pairs).csv.splitlines()[1:])


def test_where_one_is_to_arrive_crashes_alone_are_compared(result):
    pair = _paired(result, "dwa", ["dwa"], "follow", "free")
    assert (pair.saved, pair.lost, pair.difference, pair.interval) == (3, 0, None, None)
    assert said([pair]) == ["–"] and not pair.separated
