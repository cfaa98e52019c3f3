"""Figures: the same bytes each time, and nothing from outside in them."""

import dataclasses
import re
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.view.report.results import record, with_episodes, write_result
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.towns.street import load_street
from wcsim.types import ClassId
from wcsim.view.report.figures import Curve, _ground_around, _levels_of, curve_chart, figures_of
from wcsim.view.report.learning_curve import running_means

CURVE = Curve(name="c", steps=[1, 2], values=[1.0, 2.0], means=[1.0, 1.5], switch=1, crossing=2)


def test_charts_are_the_same_bytes_each_time_and_ask_for_nothing(corner, tmp_path):
    names = ("$a_1$", "_" * 28, "b@0.5", "b@0.75")
    driven = [dataclasses.replace(record(place), town=str(corner), path_m=((0.0, 0.0), (1.0, 2.0))) for place in (0, 1)]
    write_result(tmp_path)
    result = with_episodes(read_result(tmp_path), dict.fromkeys(names, driven))
    charts, again = ([each.svg for each in figures_of(result, tmp_path)] for _ in range(2))
    curve = curve_chart("fig", "y", [CURVE], (1.5, "limit"))
    assert charts == again and len(charts) == 2 and curve == curve_chart("fig", "y", [CURVE], (1.5, "limit"))
    for svg in (*charts, curve):
        root = ElementTree.fromstring(svg)  # noqa: S314  made here
        links = [value for node in root.iter() for key, value in node.attrib.items() if key.endswith("href")]
        assert all(link.startswith(("#", "data:image/png")) for link in links)
        assert not re.search(rb"<dc:date>|url\(http|<script", svg)
    assert b"data:image/png" in charts[1] and b"#888888" in charts[0] and b"legend_" in charts[0]


@pytest.mark.parametrize("name", ["_run", "_" * 28])
def test_a_run_whose_name_begins_with_a_line_has_its_curve_and_its_legend(name):
    svg = curve_chart("fig", "y", [CURVE._replace(name=name)])
    assert f"_{name[1:]}".encode() in svg or f"…{name[1:]}".encode() in svg


def test_levels_of_one_policy_are_joined_in_their_order():
    assert _levels_of(["n@0.75", "follow", "n@0.5", "m@1", "n@10", "x@y"]) == [["n@0.5", "n@0.75", "n@10"]]


def test_the_ground_shows_the_street_around_the_points_and_nothing_where_there_is_no_town(corner, corner_town):
    image, edges_m = _ground_around(str(corner), [(-10.0, -5.0), (20.0, 5.0)])
    assert edges_m == (-35.0, 45.0, -30.0, 30.0)
    rows, columns, _ = image.shape
    assert columns / rows == pytest.approx(80 / 60, rel=0.01)
    x = -35.0 + (np.arange(columns) + 0.5) * 80.0 / columns
    y = 30.0 - (np.arange(rows) + 0.5) * 60.0 / rows
    street = load_street(corner_town).grid
    points = np.stack(np.meshgrid(x, y), axis=-1)
    classes, open_ground = street.class_at(points), street.clearance_at(points) > 0.0
    colours = [
        {tuple(rgb) for rgb in image[(classes == each) & open_ground].tolist()}
        for each in (ClassId.ROAD, ClassId.SIDEWALK)
    ]
    assert [len(each) for each in colours] == [1, 1] and colours[0] != colours[1]
    assert _ground_around("atlantis", [(0.0, 0.0)]) is None and _ground_around(str(corner), []) is None


def test_means_go_over_the_last_values_alone():
    assert running_means([2.0] * 30) == [2.0] * 30
    rising = running_means([float(value) for value in range(40)])
    assert rising[-1] == pytest.approx(29.5) and all(a < b for a, b in pairwise(rising))
