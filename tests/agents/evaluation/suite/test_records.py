"""Sums, scores, runs of interventions and warnings: every rule by hand."""

from dataclasses import replace

import pytest

from wcsim.agents.evaluation.suite.alarms import Alarms
from wcsim.agents.evaluation.suite.records import EpisodeRecord, Intervention, record_of
from wcsim.errors import ConfigError

GOOD = EpisodeRecord(
    block=0, seat=1, part="free", town="t", profile="ataxic", status="finished", steps=100, time_s=10.0, m=10.0,
    route_m=10.0, done_m=10.0, within=80,
)  # fmt: skip


@pytest.fixture
def alarms():
    return Alarms(0.1)


@pytest.mark.parametrize("part", ["streets", "held-out", "tight", "Helsinki, ataxic user"])
def test_needless_steps_alone_cost_something_where_there_is_nowhere_to_arrive(part):
    safe = replace(GOOD, part=part)
    needless = (Intervention(first=5, last=24, verdict="needless", needless_steps=20),)
    assert safe.steps == 100 and safe.score == 1.0
    assert replace(safe, interventions=needless).score == pytest.approx(0.8)
    assert replace(safe, red_entries=1, status="timed_out", done_m=1.0).score == 1.0
    assert replace(safe, within=70, judged=False).score == pytest.approx(0.7), "nobody knows what was needless"


@pytest.mark.parametrize(
    "changes",
    [
        {"status": "chair_crashed", "fault": "own", "reason": "collision"},
        {"status": "chair_crashed", "fault": "other", "reason": "collision"},
        {"status": "policy_failed"},
        {"status": "refused", "steps": 0},
    ],
)
def test_who_crashes_whosever_fault_it_is_scores_nothing(changes):
    assert replace(GOOD, part="scenes", **changes).score == 0.0
    assert replace(GOOD, **changes).score is None, "a way is not in the score"


def test_a_record_comes_back_from_json_and_anything_else_is_refused(alarms):
    alarms.begin(3, True, False)
    alarms.alone_s[3] = 2.0
    record = replace(GOOD, interventions=alarms.interventions())
    assert record_of(record.to_json()) == record
    older = record.to_json()
    del older["within"]
    for other in ({**record.to_json(), "more": 1}, older, [record.to_json()]):
        with pytest.raises(ConfigError, match="run the test again with this version"):
            record_of(other)


def test_gaps_under_half_a_second_join_interventions(alarms):
    begun = [alarms.begin(step, True, False) for step in (10, 11, 16, 22)]  # 4 and 5 steps between
    assert begun == [True, False, False, True]
    assert [(item.first, item.last) for item in alarms.interventions()] == [(10, 16), (22, 22)]


def test_the_verdict_of_a_fork_is_that_of_its_intervention(alarms):
    for step, alone_s in ((10, 1.2), (30, None)):
        alarms.begin(step, True, False)
        alarms.alone_s[step] = alone_s
    alarms.begin(60, True, False)
    found = [(item.verdict, item.crash_after_s, item.needless_steps) for item in alarms.interventions()]
    assert found == [("needed", 1.2, 0), ("needless", None, 1), ("not_judged", None, 0)]


def test_a_long_intervention_is_judged_again_every_two_seconds(alarms):
    """Needed at first, needless for the next 2 s, and needed again until its end."""
    asked = [step for step in range(10, 55) if alarms.begin(step, True, False)]
    assert asked == [10, 30, 50]
    alarms.alone_s = {10: 1.2, 30: None, 50: 2.0}
    (whole,) = alarms.interventions()
    assert (whole.first, whole.last, whole.verdict, whole.needless_steps) == (10, 54, "needed", 20)


def test_a_crash_is_missed_when_nothing_was_done_in_the_five_seconds_before(alarms):
    alarms.begin(20, True, False)
    assert not alarms.missed(70) and alarms.missed(71)


def test_warnings_count_a_second_ahead_and_are_false_where_nothing_came(alarms):
    for step in (40, 41, 42):
        alarms.begin(step, False, True)
    assert alarms.warnings(52) == (1, 1, 0)
    assert alarms.warnings(49) == (0, 1, 0)  # 0.9 s ahead is too late
    alarms.alone_s[40] = None  # judged: the user alone comes through
    assert alarms.warnings(None) == (0, 0, 1)
    alarms.alone_s[40] = 2.0
    assert alarms.warnings(None) == (1, 1, 0)


@pytest.mark.parametrize(
    "crashes, dangers",
    [((50,), 1), ((50, 50), 1), ((50, 59), 1), ((50, 59, 68), 1), ((50, 60), 2), ((70, 50, 55), 2)],
)
def test_crashes_less_than_a_second_apart_are_one_danger(alarms, crashes, dangers):
    alarms.begin(20, False, True)
    for number, step in enumerate(crashes):
        alarms.alone_s[20 + number] = 0.1 * (step - 20 - number)
    assert alarms.warnings(None) == (dangers, dangers, 0)
    assert alarms.warnings(crashes[0])[1] == dangers, "an own crash that a fork saw come is the same one"


def test_one_crash_that_was_warned_of_and_one_that_was_not_are_two_dangers(alarms):
    alarms.begin(100, False, True)
    alarms.alone_s[100] = 3.0
    assert alarms.warnings(130) == (1, 1, 0)
    assert Alarms(0.1).warnings(130) == (0, 1, 0)


def test_a_warning_before_a_crash_by_the_others_fault_is_not_false(alarms):
    alarms.begin(100, False, True)
    alarms.alone_s[100] = None
    assert alarms.warnings(None, 130) == (0, 0, 0)
    assert alarms.warnings(None, 151) == (0, 0, 1)
    assert alarms.warnings(None) == (0, 0, 1)
