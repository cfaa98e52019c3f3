"""Each disturbance alone, against the same episodes driven clean."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.agents.evaluation.suite.lists import block_of, suite_in
from tests.support.one_process import in_this_process
from wcsim.agents.evaluation.suite import sensitivity as told_apart
from wcsim.agents.evaluation.suite.run import SuiteOrder
from wcsim.config import load_run_config


def test_every_disturbance_is_a_setting_that_exists() -> None:
    for settings in told_apart.DISTURBANCES.values():
        config = load_run_config("quick", (*told_apart.CLEAN, *settings))
        assert (config == load_run_config("quick", told_apart.CLEAN)) is (not settings)


@pytest.mark.proof
def test_a_change_is_measured_against_the_same_episodes_driven_clean(
    corner: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = {name: told_apart.DISTURBANCES[name] for name in ("clean", "10 km/h")}
    monkeypatch.setattr(told_apart, "DISTURBANCES", few)
    order = SuiteOrder(suite=suite_in(corner, block_of(corner, max_steps=80)), out=tmp_path)
    said: list[object] = []
    with in_this_process():
        rows = told_apart.sensitivity(order, ("follow",), said.append)
    clean, faster = rows
    assert (clean["disturbance"], clean["score_change"], clean["score_change_ci"]) == ("clean", 0.0, [0.0, 0.0])
    assert faster["speed_mps"] > 1.2 * clean["speed_mps"]
    assert faster["score_change"] == pytest.approx(faster["score"] - clean["score"], abs=1e-6)
    assert faster["score_change"] != 0.0
    assert said == ["clean: follow, 1 of 1 blocks", "10 km/h: follow, 1 of 1 blocks"]
