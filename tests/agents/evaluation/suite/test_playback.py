"""An episode driven once more is the same episode, and its last steps are those that were."""

import math
from dataclasses import replace

import pytest

from tests.agents.evaluation.suite.lists import block_of, suite_in
from tests.support.one_process import in_this_process
from wcsim.agents.evaluation.suite.playback import play, require_same
from wcsim.agents.evaluation.suite.records import Intervention
from wcsim.agents.evaluation.suite.run import SuiteOrder, piece_of, run_suite, town_addresses
from wcsim.errors import ConfigError


@pytest.fixture(scope="module")
def driven(corner, tmp_path_factory):
    suite = suite_in(corner, block_of(corner, max_steps=24, handover=10))
    order = SuiteOrder(suite=suite, out=tmp_path_factory.mktemp("driven"))
    with in_this_process():
        return order, run_suite(order, ["dwa"], lambda *said: None)["dwa"]


def test_the_record_is_the_kept_one_and_the_steps_lead_to_its_end(driven):
    order, kept = driven
    piece = piece_of(order, 0, "dwa", town_addresses(order), judged=True)
    worlds = []
    (played,) = play(piece, (1,), 12, lambda world, steps: worlds.append(len(steps)) or "drawn")
    require_same(played.record, replace(kept[1], last_moment_s=0.9, cause="late"))
    assert [step.step for step in played.steps] == list(range(13, 25))
    assert (played.drawn, worlds) == ("drawn", [12])
    last, before = played.steps[-1], played.steps[-2]
    assert math.dist(last.p_W_m[:2], kept[1].end_m) < 1e-3
    assert math.dist(last.p_W_m[:2], before.p_W_m[:2]) == pytest.approx(0.1 * last.speed_mps, abs=0.02)
    assert last.seen["seg"].shape == (1, 24, 32) and last.seen["depth"].shape == (1, 24, 32)
    assert {chair.seat for chair in last.chairs} >= {1}


def test_another_episode_is_told(driven):
    order, kept = driven
    piece = piece_of(order, 0, "follow", town_addresses(order), judged=False)
    (played,) = play(piece, (0,), 1)
    with pytest.raises(ConfigError, match="run the test again"):
        require_same(played.record, replace(kept[0], m=kept[0].m + 1.0))
    with pytest.raises(ConfigError, match="interventions"):
        require_same(kept[0], replace(kept[0], interventions=(Intervention(first=3, last=4, verdict="needed"),)))
    assert played.drawn is None


def test_a_seat_that_is_not_there_is_refused(driven):
    order, _ = driven
    with pytest.raises(ConfigError, match="expected 0 to 1"):
        play(piece_of(order, 0, "dwa", {}, judged=False), (2,), 1)
