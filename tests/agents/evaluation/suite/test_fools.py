"""Whoever has one fault is caught by a column that is there for it, in real drives of `guard` and `hard`.

The column stands in the first table, or in one that is folded below it.
"""

from pathlib import Path

import pytest

from tests.agents.evaluation.suite.fools import FOOLS
from wcsim.agents.evaluation.suite.rows import row_of
from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
from wcsim.agents.opening.list_file import open_suite, suite_from_file
from wcsim.agents.policy_api import UNAIDED


def rows_on(name: str, every: int, work: Path) -> dict[str, dict[str, object]]:
    """Rows of the user alone, the oracle and all fools on every so manieth block of a list."""
    file = open_suite(name).file
    few = suite_from_file(file.model_copy(update={"blocks": file.blocks[::every]}))
    named = {f"{FOOLS[0].__module__}:{fool.__name__}": fool.__name__ for fool in FOOLS}
    driven = run_suite(SuiteOrder(suite=few, out=work, jobs=2), (UNAIDED, "oracle", *named), lambda *_: None)
    return {
        named.get(policy, policy): row_of(policy, "", records, driven[UNAIDED]).to_json()
        for policy, records in driven.items()
    }


@pytest.mark.proof
def test_on_ways_every_fool_is_caught_by_its_column(tmp_path: Path) -> None:
    rows = rows_on("guard", 3, tmp_path)
    alone, little = rows[UNAIDED], rows["OverridesLittle"]
    assert alone["harm"] == "none" and rows["oracle"]["harm"] == "meddling", "even who knows all helps too often"
    for name in rows.keys() - {UNAIDED, "oracle", "WarnsOnly", "WarnsAlways"}:
        assert "arrivals" in rows[name]["harm"], name
    assert rows["FreezesBeforeWalkers"]["harm"] == rows["StandsAtKerbs"]["harm"] == "arrivals, meddling"
    assert rows["Stands"]["arrived"] == 0 and rows["Oscillates"]["followed"] < 0.5
    # Each of its steps counts as what was asked.
    assert little["followed"] > 0.95 and little["kpi1"] > alone["kpi1"]
    assert rows["WarnsAlways"]["false_warnings_per_km"] > 3 * rows["WarnsOnly"]["false_warnings_per_km"]


@pytest.mark.proof
def test_in_dangers_no_fool_scores_what_it_does_not_do(tmp_path: Path) -> None:
    rows = rows_on("hard", 6, tmp_path)
    alone, sane = rows[UNAIDED], rows["oracle"]
    assert alone["crashes_any"] > 0.8 * alone["episodes"] > 2 * sane["crashes_any"] and alone["saved"] == 0
    for name in ("WarnsAlways", "WarnsOnly"):
        assert rows[name]["saved"] == 0 and rows[name]["score"] == alone["score"], name
    assert rows["WarnsOnly"]["warned_share"] > 0.3
    for name in rows.keys() - {UNAIDED, "oracle"}:
        assert rows[name]["score"] < 0.8 * sane["score"], name
