"""The chart of the first screen shows what docs/results.md says, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.speed_chart import PICTURES, drawn, rate

NUMBERS = json.loads((PICTURES / "speed.json").read_text(encoding="utf-8"))
RESULTS = (Path(__file__).parents[3] / "docs" / "results.md").read_text(encoding="utf-8")


def test_the_drawing_is_of_the_numbers():
    assert (PICTURES / "speed.svg").read_text(encoding="utf-8") == drawn(NUMBERS)


@pytest.mark.parametrize("row", NUMBERS["rows"], ids=lambda row: row["name"])
def test_each_number_stands_in_the_results(row):
    assert row["told_as"] in RESULTS
    told = row.get("ticks_per_s", row.get("tick_ms"))
    assert str(told) in row["told_as"]
    assert f"{rate(row):.0f} a second" in drawn(NUMBERS)


def test_bars_are_as_long_as_their_numbers():
    told = {**NUMBERS, "rows": [{"name": "a", "ticks_per_s": 40}, {"name": "b", "tick_ms": 100.0}]}
    widths = [float(part.split("'")[0]) for part in drawn(told).split("width='")[3:] if "fill='#2f7fd6'" in part]
    assert widths[0] == pytest.approx(4.0 * widths[1], rel=0.01)
