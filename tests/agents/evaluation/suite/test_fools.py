"""Whoever has one fault is caught by the column that is there for it, in real drives through Helsinki."""

from pathlib import Path

import pytest

from wcsim.agents.evaluation.suite.rows import pooled_rows
from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
from wcsim.agents.opening.list_file import open_suite, suite_from_file
from wcsim.agents.policy_api import UNAIDED

FOOLS = ("Stands", "NeverCrosses", "FreezesBeforeWalkers", "Oscillates", "ReversesHome", "WarnsAlways")
BLOCKS = {"free": 2, "crossing": 3, "hazard": 2}  # of each part


@pytest.mark.proof
def test_every_fool_is_caught_by_its_column(tmp_path: Path) -> None:
    file = open_suite("dev").file
    blocks = [b for part, many in BLOCKS.items() for b in [b for b in file.blocks if b.part == part][:many]]
    named = {f"{__package__}.fools:{name}": name for name in FOOLS}
    order = SuiteOrder(suite=suite_from_file(file.model_copy(update={"blocks": tuple(blocks)})), out=tmp_path, jobs=2)
    driven = run_suite(order, (UNAIDED, "oracle", *named), lambda *_: None)
    parts, whole = {}, {}
    for policy, records in driven.items():
        rows, row = pooled_rows(policy, records, driven[UNAIDED])
        name = named.get(policy, policy)
        whole[name], parts[name] = row.to_json(), {item.part: item.to_json() for item in rows}
    sane, follow = whole["oracle"], whole[UNAIDED]

    # 9 and 3 own crashes in these blocks since wheels fall off kerbs; 10 and 1 before.
    assert follow["crashes_own"] >= 3 * max(1, sane["crashes_own"])
    assert follow["missed"] == follow["crashes_own"]
    alone, seeing = (parts[name]["hazard"]["crashes_any"] for name in (UNAIDED, "oracle"))
    assert alone > 0.7 * parts[UNAIDED]["hazard"]["episodes"] > seeing

    stands = whole["Stands"]
    assert stands["arrived"] == 0 and stands["score"] < 0.05
    assert stands["blocked_share"] > 10 * max(0.01, sane["blocked_share"])  # its user lets go after a while
    assert stands["freezes"] > 10 * max(1, sane["freezes"])

    shy = parts["NeverCrosses"]["crossing"]
    assert shy["arrived"] <= 0.3 * parts["oracle"]["crossing"]["arrived"] and shy["freezes"] > 0

    afraid = whole["FreezesBeforeWalkers"]
    assert afraid["blocked_share"] > 5 * sane["blocked_share"] and afraid["freezes"] > 3 * max(1, sane["freezes"])
    assert afraid["score"] < sane["score"]

    shaky = whole["Oscillates"]
    assert shaky["stick_travel_per_s"] > 5 * shaky["asked_travel_per_s"] and shaky["kpi1_free_within"] < 0.5
    assert shaky["score"] < 0.1 * sane["score"]

    back = whole["ReversesHome"]
    assert back["arrived"] <= 0.1 * sane["arrived"] and back["score"] < 0.1 and back["kpi1_free_within"] < 0.5

    loud = whole["WarnsAlways"]
    (heard,) = (records for policy, records in driven.items() if named.get(policy) == "WarnsAlways")
    assert all(record.warned == record.to_warn for record in heard if record.steps > 0)  # nobody warns before it drives
    assert loud["warned_share"] > 0.8 and loud["false_warnings_per_km"] > 100
    assert (sane["warned_share"], loud["crashes_own"]) != (1.0, 0)  # who warns always saves nobody
