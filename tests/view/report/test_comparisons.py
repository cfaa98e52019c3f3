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
    """The last two cells of each pair on the page: whether it is different, and how many drives would tell."""
    text = str(TEMPLATES.get_template("comparisons.jinja").module.pair_table("", pairs, FEWEST))
    return [tuple(re.findall(r"<td[^>]*>([^<]*)", row)[-2:]) for row in text.split("<tr>")[2:]]


def test_pairs_are_counted_over_the_same_episodes(result):
    pair = _paired(result, "dwa", "follow", "")
    scores = [a.score - b.score for a, b in zip(records_of("dwa")[4:], records_of("follow")[4:], strict=True)]
    assert (pair.episodes, pair.saved, pair.lost) == (12, 8, 0)
    assert pair.difference == pytest.approx(math.fsum(scores) / 8)
    assert pair.mcnemar_p == pytest.approx(2 / 2**8)
    low, high = pair.interval
    assert low <= pair.difference <= high and pair.separated == (low > 0)
    back = _paired(result, "follow", "dwa", "")
    assert (back.saved, back.lost) == (0, 8) and back.difference == pytest.approx(-pair.difference)


def test_every_policy_meets_every_rival_once_in_each_part(result):
    pairs = compared(result)
    assert {pair.part for pair in pairs} == {"free", "hazard", ""}
    assert [(pair.policy, pair.rival) for pair in pairs if not pair.part] == [
        *((name, "follow") for name in POLICIES if name != "follow"),
        *((name, "dwa") for name in POLICIES if name not in ("follow", "dwa")),
    ]


def test_the_page_says_what_is_separated_and_how_many_drives_would_separate_the_rest(result):
    pairs = [pair for pair in compared(result) if not pair.part]
    assert said(pairs) == [("yes", "–") if pair.separated else ("no", str(pair.enough)) for pair in pairs]
    assert {cells[0] for cells in said(pairs)} == {"yes", "no"}
    same = _paired(result, "dwa", "dwa", "")
    assert same.enough is None and said([same]) == [("no", "–")]


def test_few_episodes_separate_nobody_however_far_apart_they_are(result):
    few = with_episodes(result, {name: found[:6] for name, found in result.episodes.items()})
    pairs = [pair for pair in compared(few) if pair.part == "hazard"]
    assert pairs and all(pair.episodes == 2 and not pair.separated for pair in pairs)
    assert any(pair.difference for pair in pairs)
    assert said(pairs) == [("–", "–")] * len(pairs)
    assert all(line.endswith(",,") for line in _comparison_table(pairs).csv.splitlines()[1:])


def test_where_one_is_to_arrive_crashes_alone_are_compared(result):
    pair = _paired(result, "dwa", "follow", "free")
    assert (pair.saved, pair.lost, pair.difference, pair.interval) == (3, 0, None, None)
    assert said([pair]) == [("–", "–")] and not pair.separated
