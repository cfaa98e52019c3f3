"""Figures: the same bytes each time, and nothing from outside in them."""

import dataclasses
import re
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest

from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street
from wcsim.types import ClassId
from wcsim.view.report.charts import (
    Curve,
    DrivenWay,
    Estimate,
    TownPicture,
    bar_chart,
    curve_chart,
    obedience_chart,
    score_chart,
    share_chart,
    town_chart,
)
from wcsim.view.report.figures import _ground_around, _levels_of
from wcsim.view.report.learning_curve import running_means

CURVE = Curve(name="c", steps=[1, 2], values=[1.0, 2.0], means=[1.0, 1.5], switch=1, crossing=2)
PLACES = {"$a_1$": 0, "b@0.5": 1, "b@0.75": 2}
SOME = Estimate(value=0.5, low=0.25, high=0.75)
GROUND = TownPicture(image=np.full((4, 8, 3), 200, np.uint8), west_m=0.0, east_m=8.0, south_m=0.0, north_m=4.0)
WAYS = [DrivenWay(policy=name, points_m=((0.0, 0.0), (1.0, 2.0)), crash_m=(1.0, 2.0)) for name in PLACES]
CHARTS = {
    "obedience": lambda: obedience_chart({name: (SOME, SOME) for name in PLACES}, [["b@0.5", "b@0.75"]], PLACES),
    "scores": lambda: score_chart([("all", [(name, SOME) for name in PLACES])], PLACES),
    "town": lambda: town_chart("corner", GROUND, WAYS, PLACES),
    "bars": lambda: bar_chart("comfort", "m/s²", {"$a_1$": 1.0, "b@0.5": 2.0}, PLACES),
    "shares": lambda: share_chart("status", {"$a_1$": {"finished": 3, "gave_up": 1}}),
    "curves": lambda: curve_chart("fig", "y", [CURVE], 1.5),
}


@pytest.mark.parametrize("name", sorted(CHARTS))
def test_a_chart_is_the_same_bytes_each_time_and_asks_for_nothing(name):
    svg = CHARTS[name]()
    assert svg == CHARTS[name]()
    root = ElementTree.fromstring(svg)  # noqa: S314  made here
    links = [value for node in root.iter() for key, value in node.attrib.items() if key.endswith("href")]
    assert all(link.startswith(("#", "data:image/png")) for link in links)
    assert not re.search(rb"<dc:date>|url\(http|<script", svg)


@pytest.mark.parametrize("name", ["_run", "_" * 28])
def test_a_run_whose_name_begins_with_a_line_has_its_curve_and_its_legend(name):
    svg = curve_chart("fig", "y", [dataclasses.replace(CURVE, name=name)])
    assert f"_{name[1:]}".encode() in svg or f"…{name[1:]}".encode() in svg
    assert obedience_chart({name: (SOME, SOME)}, [], {name: 0}).count(b"legend_") > 0


def test_levels_of_one_policy_are_joined_in_their_order():
    lines = _levels_of(["n@0.75", "follow", "n@0.5", "m@1", "n@10", "x@y"])
    assert lines == [["n@0.5", "n@0.75", "n@10"]]
    with_line, without = CHARTS["obedience"](), obedience_chart({name: (SOME, SOME) for name in PLACES}, [], PLACES)
    assert with_line.count(b"#888888") > without.count(b"#888888")


def test_the_ground_shows_the_street_around_the_points_and_nothing_where_there_is_no_town(corner):
    ground = _ground_around(str(corner), [(-10.0, -5.0), (20.0, 5.0)])
    assert (ground.west_m, ground.east_m, ground.south_m, ground.north_m) == (-35.0, 45.0, -30.0, 30.0)
    rows, columns, _ = ground.image.shape
    assert columns / rows == pytest.approx(80 / 60, rel=0.01)
    x = -35.0 + (np.arange(columns) + 0.5) * 80.0 / columns
    y = 30.0 - (np.arange(rows) + 0.5) * 60.0 / rows
    street = load_street(find_town(str(corner))).grid
    points = np.stack(np.meshgrid(x, y), axis=-1)
    classes, open_ground = street.class_at(points), street.clearance_at(points) > 0.0
    colours = [
        {tuple(rgb) for rgb in ground.image[(classes == each) & open_ground].tolist()}
        for each in (ClassId.ROAD, ClassId.SIDEWALK)
    ]
    assert [len(each) for each in colours] == [1, 1] and colours[0] != colours[1]
    assert _ground_around("atlantis", [(0.0, 0.0)]) is None and _ground_around(str(corner), []) is None


def test_means_go_over_the_last_values_alone():
    assert running_means([2.0] * 30) == [2.0] * 30
    rising = running_means([float(value) for value in range(40)])
    assert rising[-1] == pytest.approx(29.5) and all(a < b for a, b in pairwise(rising))
