"""A wheelchair drives over every pavement, walking area and crossing, and always stands on something."""

from __future__ import annotations

import pytest

from tests.support.worlds import open_world
from wcsim.bench.tour.lines import walking_lines
from wcsim.bench.tour.tour import TourReport, tour
from wcsim.cli.town.tour import TOUR
from wcsim.physics.engine import Engine
from wcsim.towns.scenario.town import find_town
from wcsim.towns.sumo.net import read_net
from wcsim.types import SeatSpec


def drive(folder, every: int = 1) -> TourReport:
    town = find_town(str(folder))
    lines = walking_lines(read_net(town.net, town.file.origin_m), town.file.chair_ways)
    with open_world(folder, *TOUR, "chair.v_max_mps=2.8", spec=SeatSpec(max_steps=10**9)) as world:
        return tour(world, lines[::every], lambda done: None)


def test_every_way_of_a_street_corner_holds_the_chair(corner):
    report = drive(corner, every=2)
    assert report.lines >= 8
    assert report.on_nothing == 0
    assert report.driven_m > 0.7 * report.length_m


def test_a_ground_that_is_not_there_is_noticed(corner, monkeypatch):
    monkeypatch.setattr(Engine, "add_street", lambda self, mesh: None)
    town = find_town(str(corner))
    lines = walking_lines(read_net(town.net, town.file.origin_m), town.file.chair_ways)[:1]
    with open_world(corner, *TOUR, spec=SeatSpec(max_steps=10**9)) as world:
        assert tour(world, lines, lambda done: None).on_nothing > 0


def test_lines_cover_every_walkable_lane_once(corner):
    town = find_town(str(corner))
    net = read_net(town.net, town.file.origin_m)
    lines = walking_lines(net, town.file.chair_ways)
    assert len(lines) == len({line.tobytes() for line in lines})
    assert len(lines) >= 12  # eight pavements, four crossings, and the walking areas between them


@pytest.mark.proof
@pytest.mark.timeout(1500)
def test_every_way_of_manhattan_holds_the_chair():
    report = drive("manhattan")
    assert report.on_nothing == 0, report
    assert report.driven_m > 0.8 * report.length_m
