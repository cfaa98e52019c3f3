"""Each disturbance alone, against the same episodes driven clean."""

import pytest

from tests.agents.evaluation.suite.lists import block_of, suite_in
from tests.support.one_process import in_this_process
from wcsim.agents.evaluation.suite import sensitivity as told_apart
from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.run import SuiteOrder
from wcsim.config import resolve
from wcsim.errors import TownError


def test_every_disturbance_disturbs_whatever_is_set(corner, tmp_path, monkeypatch):
    """A chair of one's own would be driven in the place of the mid-wheel one, too, and move nothing."""
    driven = []
    monkeypatch.setattr(told_apart, "run_suite", lambda order, *_: driven.append(order.settings) or {})
    own = ("cameras.0.noise.objects=poor", "chair.plant=rwd", "world.action_delay_ticks=1", "chair.v_max_mps=1.2")
    order = SuiteOrder(suite=suite_in(corner, block_of(corner)), out=tmp_path, settings=own)
    told_apart.sensitivity(order, (), lambda _: None)
    configs = [resolve("quick", settings) for settings in driven]
    assert len(configs) == len(told_apart.DISTURBANCES)
    of = dict(zip(told_apart.DISTURBANCES, configs, strict=True))
    assert [name for name in of if of[name] == configs[0]] == ["clean", "whole things, poor"]
    noise = of["noise"].cameras[0].noise
    assert noise is not None and (noise.objects, noise.depth is None, noise.rgb is None) == ("poor", False, False)
    assert configs[0].world.action_delay_ticks == 1 and configs[0].chair.v_max_mps == 1.2


def test_a_disturbance_that_a_town_cannot_have_is_told_and_left_out(corner, tmp_path, monkeypatch):
    def driven(order: SuiteOrder, policies: object, done: object) -> dict[str, tuple[EpisodeRecord, ...]]:
        if missing in order.settings:
            raise TownError("SUMO crashes here")
        return {
            "follow": (EpisodeRecord(block=0, seat=0, part="free", town="corner", profile="slow", status="finished"),)
        }

    monkeypatch.setattr(told_apart, "run_suite", driven)
    told: list[object] = []
    order = SuiteOrder(suite=suite_in(corner, block_of(corner)), out=tmp_path)
    missing = "world.street=jupedsim"
    rows = told_apart.sensitivity(order, (), told.append)
    assert [row.disturbance for row in rows] == [name for name in told_apart.DISTURBANCES if "JuPedSim" not in name]
    assert told == ["people by JuPedSim: left out: SUMO crashes here"]
    missing = "chair.plant=mwd"
    with pytest.raises(TownError):
        told_apart.sensitivity(order, (), told.append)


@pytest.mark.proof
def test_a_change_is_measured_against_the_same_episodes_driven_clean(corner, tmp_path, monkeypatch):
    few = {name: told_apart.DISTURBANCES[name] for name in ("clean", "10 km/h")}
    monkeypatch.setattr(told_apart, "DISTURBANCES", few)
    order = SuiteOrder(suite=suite_in(corner, block_of(corner, max_steps=80)), out=tmp_path)
    said: list[object] = []
    with in_this_process():
        rows = told_apart.sensitivity(order, ("follow",), said.append)
    clean, faster = rows
    assert (clean.disturbance, clean.score_change, clean.score_change_ci) == ("clean", 0.0, None)
    assert faster.row.speed_mps > 1.2 * clean.row.speed_mps
    assert faster.score_change == pytest.approx(faster.row.score - clean.row.score, abs=1e-6)
    assert faster.score_change != 0.0
    assert said == ["clean: follow, 1 of 1 blocks", "10 km/h: follow, 1 of 1 blocks"]
