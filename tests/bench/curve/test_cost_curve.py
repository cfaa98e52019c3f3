"""What grows faster than linearly is found, and the three axes run."""

import json

import pytest

from wcsim.bench.curve.cost_curve import CurvePoint, steep
from wcsim.cli.main import main


def point(at, **stages_ms):
    return CurvePoint(at=at, cpu_ms=sum(stages_ms.values()), actors=0.0, stages_ms=stages_ms)


def test_a_stage_that_grows_by_more_than_the_axis_is_named_with_its_exponent():
    points = [point(1.0, sumo=9.0, user=9.0), point(4.0, sumo=1.0, user=1.0), point(8.0, sumo=2.0, user=4.0)]
    assert steep(points) == (("user", pytest.approx(2.0)),)
    assert steep([point(1.0, user=1.0)]) == ()


def test_what_costs_next_to_nothing_is_not_named():
    assert steep([point(1.0, user=0.001), point(2.0, user=0.05)]) == ()


@pytest.mark.proof  # builds four towns
def test_all_three_axes_run(tmp_path):
    file = tmp_path / "curve.json"
    few = ["--chairs", "1,2", "--actors", "8,16", "--sides-km", "0.4,0.6", "--ticks", "10"]
    assert main(["bench", "curve", "--town", "manhattan", *few, "--json", str(file)]) in (0, 1)
    told = json.loads(file.read_text())
    assert {axis: [p["at"] for p in curve["points"]] for axis, curve in told.items()} == {
        "wheelchairs": [1.0, 2.0],
        "actors": [8.0, 16.0],
        "kilometres": [0.4, 0.6],
    }
    assert all(p["cpu_ms"] > 0.0 for curve in told.values() for p in curve["points"])


@pytest.mark.parametrize("words", [["--chairs", "2,1"], ["--sides-km", "x"], ["--actors", "1"]])
def test_numbers_that_make_no_curve_are_refused(words, capsys):
    assert main(["bench", "curve", *words]) == 2
    assert words[0] in capsys.readouterr().err
