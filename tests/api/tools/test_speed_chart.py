"""The chart of the first screen shows what docs/results.md says, and nothing else."""

import json
from pathlib import Path

import pytest

from tools.speed_chart import PICTURES, drawn

NUMBERS = json.loads((PICTURES / "speed.json").read_text())
RESULTS = (Path(__file__).parents[3] / "docs" / "results.md").read_text()


def test_the_drawing_is_of_the_numbers():
    assert (PICTURES / "speed.svg").read_text() == drawn(NUMBERS)


@pytest.mark.parametrize("row", NUMBERS["rows"], ids=lambda row: row["name"])
def test_each_number_stands_in_the_results(row):
    assert row["told_as"] in RESULTS
    assert str(row["ticks_per_s"]) in row["told_as"]
    assert f"{row['ticks_per_s']} a second" in drawn(NUMBERS)


def test_bars_are_as_long_as_their_numbers():
    told = {**NUMBERS, "rows": [{"name": "a", "ticks_per_s": 40}, {"name": "b", "ticks_per_s": 10}]}
    shapes = [part.rpartition('d="M ')[2].split() for part in drawn(told).split("fill: #2f7fd6")[:-1]]
    widths = [float(shape[3]) - float(shape[0]) for shape in shapes]
    assert widths[0] == pytest.approx(4.0 * widths[1], rel=0.01)
