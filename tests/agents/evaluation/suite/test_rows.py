"""Rows of the table, and the planted fools: each is caught by the column that should."""

import json
from dataclasses import fields, replace

import pytest

from tests.agents.driven import Script, driven
from tests.agents.evaluation.suite.test_records import GOOD
from tests.support.tracked import ROOT
from wcsim.agents.evaluation.suite.records import SCORE_VERSION, Intervention
from wcsim.agents.evaluation.suite.rows import COLUMNS, LOOK, ResultRow, pooled_rows, row_of
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.config import RunConfig

CRASH = replace(GOOD, status="chair_crashed", fault="own", reason="collision")
MANY = [replace(GOOD, block=number, m=100.0) for number in range(20)]


def row(records, unaided=()):
    return row_of("p", "", records, list(unaided)).to_json()


def test_a_row_says_on_what_it_stands():
    ways = [*MANY[:15], *[replace(CRASH, m=100.0)] * 5]
    found = row([replace(each, part="scenes") for each in ways])
    assert row(ways)["score"] is None and row(ways)["attempts"] == 20
    assert found["episodes"] == 20 and found["km"] == 2.0 and found["crashes_own"] == 5
    assert found["status"]["finished"] == 15 and found["status"]["chair_crashed"] == 5
    assert found["crashes_any"] == 5 and found["crashes_any_ci"][0] < 0.25 < found["crashes_any_ci"][1]
    assert json.loads(json.dumps(found, allow_nan=False)).keys() == found.keys()
    assert found["score"] == pytest.approx(0.75) and found["crash_reasons"] == {"collision": 5}


def test_what_the_policy_did_not_do_is_in_no_figure():
    more = replace(CRASH, status="not_reached", steps=0)
    alone, found = row([GOOD] * 9), row([*[GOOD] * 9, more], [*[CRASH] * 9, GOOD])
    assert (found["episodes"], found["uncounted"], found["saved"], found["lost"]) == (9, 1, 9, 0)
    left = {"uncounted", "status", "saved", "lost", "mcnemar_p", "harm"}
    assert {name: found[name] for name in found.keys() - left} == {name: alone[name] for name in alone.keys() - left}


def test_crashes_of_any_fault_are_counted_beside_the_own():
    found = row([GOOD, CRASH, replace(CRASH, fault="other")])
    assert (found["crashes_any"], found["crashes_own"]) == (2, 1)


def test_nothing_driven_is_no_number():
    empty = replace(GOOD, status="refused", steps=0, m=0.0, time_s=0.0, within=0)
    found = row([empty])
    assert found["pace"] is None and found["kpi1"] is None and found["speed_mps"] is None
    assert found["status"]["refused"] == 1 and found["crashes_any"] == 0


def test_a_policy_that_failed_in_all_that_it_was_given_has_no_result():
    failed = replace(GOOD, status="policy_failed")
    given = [failed, replace(failed, seat=2), replace(GOOD, status="not_reached")]
    found = row_of("p", "", given, [])
    assert found.without_result and found.undone == 2
    assert not row_of("p", "", [*given, GOOD], []).without_result


def test_the_pace_is_against_the_users_own_where_both_arrived():
    slow = replace(GOOD, time_s=20.0)
    assert row([slow, slow, CRASH, slow], [GOOD, CRASH, GOOD, replace(GOOD, time_s=16.0)])["pace"] == 0.65
    assert row([slow], [CRASH])["pace"] is None


NEEDLESS = (Intervention(first=1, last=2, verdict="needless"),)
LATE = replace(GOOD, status="timed_out")


@pytest.mark.parametrize(
    "own, user, said",
    [
        ([GOOD] * 20, [GOOD] * 20, "none"),
        ([CRASH, *[GOOD] * 19], [GOOD] * 20, "crashes"),
        ([CRASH, *[GOOD] * 19], [GOOD, CRASH, *[GOOD] * 18], "none"),
        ([LATE, *[GOOD] * 19], [GOOD] * 20, "none"),
        ([LATE, LATE, *[GOOD] * 18], [GOOD] * 20, "arrivals"),
        ([replace(GOOD, time_s=12.6)] * 20, [GOOD] * 20, "pace"),
        ([replace(GOOD, interventions=NEEDLESS * 2)] * 20, [GOOD] * 20, "meddling"),
        ([GOOD, *[replace(GOOD, part="scenes", time_s=20.0)] * 20], [GOOD] * 21, "none"),
        ([replace(GOOD, part="scenes")] * 20, [GOOD] * 20, None),
        ([CRASH], [], None),
    ],
)
def test_harm_is_what_is_worse_than_for_the_user_alone(own, user, said):
    assert row(own, user)["harm"] == said


def test_twins_say_who_was_saved_and_who_was_lost():
    found = row([GOOD] * 9 + [CRASH], [CRASH] * 9 + [GOOD])
    assert (found["saved"], found["lost"]) == (9, 1) and found["mcnemar_p"] == pytest.approx(0.0215, abs=1e-3)


@pytest.mark.parametrize("changes", [{"status": "refused", "steps": 0}, {"status": "policy_failed"}])
def test_a_policy_that_did_not_drive_to_the_end_saves_nobody(changes):
    found = row([replace(GOOD, **changes)] * 9 + [CRASH], [CRASH] * 9 + [GOOD])
    assert (found["saved"], found["lost"]) == (0, 1)
    assert found["mcnemar_p"] == 1.0


@pytest.mark.parametrize(
    "fool, column, worse",
    [
        ({"status": "timed_out", "done_m": 3.0, "crossings": 0}, "arrived", lambda fool, good: fool < good),
        ({"m": 0.0, "done_m": 0.0, "status": "gave_up"}, "arrived", lambda fool, good: fool == 0 < good),
        ({"freezes": 3, "time_s": 40.0}, "freezes", lambda fool, good: fool > good),
        ({"status": "chair_crashed", "fault": "own", "missed": True}, "missed", lambda fool, good: fool > good),
        ({"within": 8}, "followed", lambda fool, good: fool < good),
        ({"interventions": (Intervention(first=1, last=2, verdict="needless"),)}, "unneeded", lambda f, g: f > g),
        ({"done_m": 0.0, "status": "timed_out"}, "arrived", lambda fool, good: fool == 0 < good),
        ({"false_warnings": 2}, "false_warnings_per_km", lambda fool, good: fool > good),
        ({"red_entries": 1}, "red_entries", lambda fool, good: fool > good),
    ],
    ids=["never-crosses", "stands", "freezes", "follows", "oscillates", "meddles", "goes-home", "warns", "runs-red"],
)
def test_a_fool_is_caught(fool, column, worse):
    assert worse(row([replace(item, **fool) for item in MANY])[column], row(MANY)[column])


def test_what_forks_say_stands_on_the_episodes_that_they_judged():
    told = replace(GOOD, m=500.0, to_warn=4, warned=1, false_warnings=3, judged=True)
    unjudged = replace(told, to_warn=1, warned=1, false_warnings=0, judged=False)
    both = row([told, unjudged])
    assert (both["judged_episodes"], both["episodes"], both["km"]) == (1, 2, 1.0)
    assert both["false_warnings_per_km"] == 6.0 and both["warned_share"] == 0.25


def test_arrivals_count_where_there_is_a_destination():
    parts = ("free", "free", "crossing", "hazard", "tight")
    records = [replace(GOOD, block=number, part=part) for number, part in enumerate(parts)]
    records[1] = replace(records[1], status="timed_out")
    rows, whole = pooled_rows("a", records, records)
    assert [row.part for row in rows] == [*parts[1:]] and whole.episodes == 5
    assert (whole.arrived, whole.attempts) == (2, 3)


def test_the_indicators_of_a_scripted_drive():
    env = Script(crash_at=6)
    found = driven(make_baseline_policy("follow", RunConfig()), env, episodes=2, max_steps=100, seed=7, tick_s=10.0)
    assert found.kpi1 == pytest.approx(0.25)
    assert found.followed == pytest.approx(2 / 6)
    assert (found.kpi2, found.crashes_own, found.episodes) == (6, 2, 2)
    assert found.km == pytest.approx(0.12)
    assert env.seeds == [7, None]
    assert (found.goals, found.given_up, found.crossings, found.red_entries, found.helps) == (2, 2, 4, 2, 2)
    assert (found.crash_reasons, found.freezes, found.road_s) == ({"tilt": 2}, 0, 0.0)  # it never stands


def test_a_policy_that_stands_freezes_on_the_carriageway():
    env = Script(crash_at=6, speed_mps=0.0)
    found = driven(make_baseline_policy("follow", RunConfig()), env, episodes=2, max_steps=100, tick_s=1.0)
    assert (found.freezes, found.road_s) == (2, 6.0)  # one an episode; 3 steps of each on the road


def test_a_cut_episode_survived():
    found = driven(make_baseline_policy("follow", RunConfig()), Script(crash_at=99), episodes=1, max_steps=5)
    assert (found.kpi2, found.crashes_own, found.crashes_any) == (5, 0, 0)


def test_arrivals_are_nothing_where_no_episode_is_an_attempt_to_arrive():
    (arrivals,) = (column for column in LOOK if column.key == "arrived")
    drawn, sent = ([replace(GOOD, part=part, route_m=0.0)] for part in ("Helsinki, ataxic user", "free"))
    assert arrivals.value(row_of("follow", "", drawn, ())) is None
    assert (
        arrivals.value(row_of("follow", "", sent, ())) == arrivals.value(row_of("follow", "", [*drawn, *sent], ())) == 1
    )


def test_what_else_a_new_figure_changes():
    """Its key is explained; results of before are read no more, so that they need another version of the score."""
    keys = [field.name for field in fields(ResultRow)]
    page = (ROOT / "docs/suites.md").read_text()
    explained = [key for key in keys if key.endswith("_ci") or f"`{key}`" in page]
    assert [key for key in keys if key not in explained] == ["policy", "part", "episodes"]
    assert (SCORE_VERSION, len(keys)) == (4, 45)
    assert all(column.interval for column in COLUMNS if column.range_form)
