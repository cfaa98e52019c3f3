"""Networks of several seeds against a baseline: what is left, what is wanted, what a table says."""

import dataclasses

import numpy as np
import pytest

from tools.results.compared import by_user_text, compared_text, difference_text, left_of, wanted
from wcsim.agents.evaluation.suite.records import CRASHED, FINISHED, EpisodeRecord, Intervention
from wcsim.agents.evaluation.suite.result_files import result_of as result

PARTS = ("free", "crossing", "hazard", "tight")
MANY = 40  # episodes of a part


def episode(part, number, crashes=False, pace=1.0):
    """One of 100 m in 100 s; who crashes does so half way."""
    done = 0.5 if crashes else 1.0
    return EpisodeRecord(
        block=number, seat=0, part=part, town="t", profile="typical", fault="own" if crashes else "",
        status=CRASHED if crashes else FINISHED, steps=int(1000 * done), time_s=100.0 * done / pace, m=100.0 * done,
        route_m=100.0, done_m=100.0 * done, reference_s=100.0, moving_steps=1000, moving_within=980,
        to_warn=1, warned=1,
    )  # fmt: skip


def driven(own, **changes):
    """Episodes of all parts, the first `own[part]` of each crashed."""
    return [episode(part, number, number < own.get(part, 0), **changes) for part in PARTS for number in range(MANY)]


def result_of(policies):
    said = {"suite": "s", "set": "v1", "list_sha256": "0" * 64, "changed": (), "list_name": "v1", "preset": "quick"}
    return result(policies, **said, network="", out="")


def beside(nets, dwa=None):
    """Networks beside a user who crashes often, `dwa` that does in some and an oracle that never does."""
    rival = {"free": 2, "crossing": 2, "hazard": 4, "tight": 12} if dwa is None else dwa
    baselines = {
        "follow": driven({part: 30 for part in PARTS}),
        "dwa": driven(rival, pace=0.9),
        "oracle-visible": driven({}),
    }
    return result_of(baselines | nets)


def reached(result, runs):
    return {item.what.split(",")[0]: item.reached for item in wanted(result, runs)}


def test_a_network_that_never_crashes_and_always_obeys_has_all_that_is_wanted():
    result = beside({"n-1": driven({}), "n-2": driven({})})
    assert set(reached(result, ["n-1", "n-2"]).values()) == {True}


UNHURT = "episodes without own crash in"


@pytest.mark.parametrize(
    "own, change, missed",
    [
        ({"free": 30, "crossing": 9}, {}, {"own crashes", "own crashes per km", "score", "arrivals in part crossing"}),
        ({"tight": 12}, {}, {"own crashes", f"{UNHURT} hazard", f"{UNHURT} tight"}),
        ({"tight": 3, "hazard": 5}, {}, {f"{UNHURT} hazard", f"{UNHURT} tight"}),
        ({}, {"moving_within": 940}, {"close to user"}),
        ({}, {"time_s": 130.0}, {"speed"}),
        ({}, {"warned": 0}, {"warned 1 s ahead"}),
    ],
)
def test_each_figure_that_falls_short_is_said_to(own, change, missed):
    short = [dataclasses.replace(record, **change) for record in driven(own)]
    result = beside({"n-1": short})
    assert {what for what, there in reached(result, ["n-1"]).items() if not there} == missed


def test_networks_that_intervene_more_often_for_nothing_than_the_rival_fall_short():
    often = tuple(Intervention(first=at, last=at, verdict="needless") for at in (1, 50))
    result = beside({"n-1": [dataclasses.replace(record, interventions=often) for record in driven({})]})
    assert reached(result, ["n-1"])["unneeded interventions"] is False


def test_a_difference_is_that_of_the_same_episodes():
    result = beside({"n-1": driven({"tight": 13})}, dwa={"tight": 12})
    said = difference_text(result, "n-1", "tight")
    # Both have 0 in twelve, the network in the 13th, and 1 elsewhere.
    assert float(said.split()[0]) == pytest.approx((27 - 28) / 40, abs=1.5e-3) and said.endswith("), 0 and 1")
    assert difference_text(result, "dwa", "") == "+0.000 (+0.000 to +0.000), 0 and 0"


def test_the_user_who_is_in_no_training_has_figures_of_their_own():
    records = driven({"free": 1})
    records[0] = dataclasses.replace(records[0], profile="ataxic")
    assert by_user_text(beside({"out/n-1": records}), "out/n-1") == "| n-1 | 1 of 1, 0.000 | 0 of 159, 0.990 |"


def test_the_tables_have_a_row_a_part_and_a_column_a_network():
    result = beside({"out/n-1": driven({}), "out/n-2": driven({"tight": 1})})
    lines = compared_text(result, ["out/n-1", "out/n-2"]).splitlines()
    assert "| part | n-1 | n-2 |" in lines
    assert [line.split("|")[1].strip() for line in lines[3:8]] == [*PARTS, "all"]
    assert len([line for line in lines if line.endswith(("| yes |", "| no |"))]) == 10


def test_what_is_left_is_none_for_the_oracle_and_all_for_the_user():
    rng = np.random.default_rng(1)
    km = np.ones(200)
    follow, oracle = (np.stack([rng.random(200) < rate, km], 1).astype(float) for rate in (0.5, 0.05))
    assert left_of([oracle], follow, oracle) == pytest.approx((0.0, 0.0, 0.0))
    assert left_of([follow, follow], follow, oracle) == pytest.approx((1.0, 1.0, 1.0))
    value, low, high = left_of([np.stack([rng.random(200) < 0.15, km], 1).astype(float)], follow, oracle)
    assert low < value < high and 0.0 < value < 0.6
