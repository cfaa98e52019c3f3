"""Counts of towns against their maps, on nets and maps made by hand: a degree of the map is a metre of the net."""

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sumolib

from benchmarks.__main__ import main
from benchmarks.map_truth import denied_pavements, mapped_places
from benchmarks.map_truth.raw_map import RawMap, read_raw_map
from wcsim.types import F64, ClassId, StreetGrid, WalkEdge, WalkGraph, WayKind

HERE = np.zeros(2)
NET = """<net version="1.20"><location netOffset="0,0" convBoundary="0,0,60,60" origBoundary="0,0,60,60"
projParameter="+proj=longlat +datum=WGS84"/>{}</net>"""
LANE = """<lane id="{0}_{1}" index="{1}" allow="{2}" speed="1" length="9" width="4" shape="{3}">
<param key="origId" value="{4}"/></lane>"""
EDGE = '<edge id="{0}" from="a" to="b">{1}</edge>'
CROSSING = '<edge id=":{0}_c0" function="crossing" crossingEdges=":{0}_c0">{1}</edge>'


def tags_of(text: str) -> dict[str, str]:
    return dict(pair.split("=") for pair in text.split(", ") if pair)


def xml(text: str) -> str:
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags_of(text).items())


def made(tmp_path: Path, edges: list[str], *parts: str, form: str = EDGE, more: str = "") -> tuple[Any, RawMap]:
    """A net and a map.

    Args:
        tmp_path: Where their files go.
        edges: Each its lanes as "class|shape|ways of the map; ..."; the first lane of all is 0_0.
        parts: Nodes as "x,y|key=value, key=value", then ways as "x,y x,y|...", whose ids count from 0.
        form: XML of an edge.
        more: XML of the map.
    """
    text = ""
    for number, lanes in enumerate(edges):
        split = enumerate(lanes.split("; "))
        text += form.format(number, "".join(LANE.format(number, n, *lane.split("|")) for n, lane in split))
    (tmp_path / "net.xml").write_text(NET.format(text))
    net = sumolib.net.readNet(str(tmp_path / "net.xml"), withInternal=True)
    tagged = dict[str, str]()
    for number, part in enumerate(parts):
        line, tags = part.split("|")
        refs = line.split()
        more += f'<way id="{number}">' + "".join(f'<nd ref="{place}"/>' for place in refs) + f"{xml(tags)}</way>"
        tagged = dict.fromkeys(refs, "" if " " in line else tags) | tagged
    for place, tags in tagged.items():
        x, y = place.split(",")
        more += f'<node id="{place}" lon="{x}" lat="{y}">{xml(tags)}</node>'
    path = tmp_path / "map.osm.xml.gz"
    path.write_bytes(gzip.compress(f"<osm>{more}</osm>".encode()))
    return net, read_raw_map(path, net)


def metres(net: Any, raw: RawMap) -> dict[str, float]:
    return {each.verdict: round(each.lines.length, 6) for each in denied_pavements.judge_lanes(net, raw)}


@pytest.mark.parametrize("drawn", ["0,10 40,10", "40,10 0,10"])
@pytest.mark.parametrize("shape", ["0,7 40,7", "40,7 0,7", "0,13 40,13", "40,13 0,13"])
def test_the_side_is_that_of_the_way_wherever_its_edge_leads_and_traffic_keeps(tmp_path, drawn, shape):
    left = ("13" in shape) == drawn.startswith("0")
    edge = f"pedestrian|{shape}|0; passenger|{drawn}|0"
    net, raw = made(tmp_path, [edge], f"{drawn}|highway=tertiary, sidewalk:left=no")
    assert metres(net, raw) == {denied_pavements.NO_SIDEWALK if left else denied_pavements.ALLOWED: 40.0}


def test_each_piece_of_a_joined_edge_is_judged_by_its_own_way(tmp_path):
    edge = "pedestrian|0,7 40,7|0 1 99; passenger|0,10 40,10|0 1"
    first, second = "0,10 24,10|highway=tertiary, sidewalk:both=separate", "24,10 40,10|highway=tertiary"
    net, raw = made(tmp_path, [edge], first, second, "10,6 60,6|highway=footway")
    assert metres(net, raw) == {denied_pavements.SEPARATE: 24.0, denied_pavements.ALLOWED: 16.0}
    counts = denied_pavements.count_lanes(denied_pavements.judge_lanes(net, raw), raw)
    assert counts["pavement where sidewalk=separate, on a mapped one, m"] == pytest.approx(14.0 + 2.3, abs=0.1)


def test_rails_have_no_pavement_and_a_way_on_foot_is_none(tmp_path):
    edges = ["pedestrian|0,7 40,7|0; tram|0,10 40,10|0", "pedestrian|0,20 30,20|1", "pedestrian|0,30 5,30|9"]
    net, raw = made(tmp_path, edges, "0,10 40,10|railway=tram", "0,20 30,20|highway=footway")
    assert metres(net, raw) == {
        denied_pavements.RAILS: 40.0,
        denied_pavements.OWN_WAY: 30.0,
        denied_pavements.UNKNOWN: 5.0,
    }


DENIALS = (
    " > - > -",
    "sidewalk=none > sidewalk=no > sidewalk=no",
    "sidewalk=right > sidewalk=no > -",
    "sidewalk=right, sidewalk:left=separate > sidewalk=separate > -",
    "sidewalk:both=no, sidewalk:left=yes > - > sidewalk=no",
    "foot=no > foot=no > foot=no",
    "foot=no, sidewalk=left > - > sidewalk=no",
)


@pytest.mark.parametrize("case", DENIALS)
def test_denials(case):
    tags, *reasons = case.split(" > ")
    found = [denied_pavements.denial(tags_of(tags), side).removeprefix("where ") or "-" for side in ("left", "right")]
    assert found == reasons


def test_routes_count_what_they_lead_over(tmp_path):
    net, raw = made(tmp_path, ["pedestrian|0,7 40,7|; tram|0,10 40,10|"], "0,6 20,6|highway=footway")
    line = np.array([[-5.0, 2.0], [35.0, 2.0]])
    edge = WalkEdge(sumo_id="0_0", kind=WayKind.SIDEWALK, start=0, end=1, points_W_m=line, width_m=2.0)
    walk, stretches = WalkGraph(nodes_W_m=line, edges=(edge,)), denied_pavements.judge_lanes(net, raw)
    counts = denied_pavements.count_routes(walk, HERE + 5.0, stretches, raw, 5, 7)
    assert [*counts.values()] == pytest.approx([0.2, 100.0, 100.0, 100.0 * (40.0 - 22.3) / 40.0, 100.0], abs=0.1)


def ground(height_m: F64, low: ClassId = ClassId.ROAD) -> StreetGrid:
    """Cells of 0.1 m from the origin on; what is raised is pavement."""
    kinds = np.where(height_m > 0.0, ClassId.SIDEWALK, low).astype(np.uint8)
    height_cm = np.round(100.0 * height_m).astype(np.uint8)
    return StreetGrid(origin_W_m=(0.0, 0.0), cell_m=0.1, height_cm=height_cm, ground_class=kinds, clearance_dm=kinds)


def test_crossings_upon_each_other_and_denied_ones(tmp_path):
    edges = [f"pedestrian|{x},0 {x},10|" for x in (0, 1, 4, 20)]
    nodes = ("1,5|crossing=no", "12,5|crossing=no", "20,5|crossing=unmarked", "99,5|crossing=no")  # one is off the net
    net, raw = made(tmp_path, edges, *nodes, form=CROSSING)
    zebra = ground(np.zeros((100, 300)), ClassId.CROSSWALK)
    counts = mapped_places.count_crossings(mapped_places.Crossings(net), raw, zebra, HERE)
    # Each is 4 m wide: those 1 m apart share three quarters, those 3 m apart one.
    assert [*counts.values()] == [4, 1, 2, 1, 1, 1]


def test_kerbs_are_measured_where_the_street_has_them(tmp_path):
    raised_m = np.outer(np.arange(120) >= 80, np.where(np.arange(600) < 300, 0.12, 0.02))  # from y = 8 m on
    nodes = ("20,9|kerb=lowered", "50,9|kerb=lowered", "50,7|kerb=raised", "50,2|kerb=raised", "50,8|kerb=rolled")
    # Of a node amid the street both ends of its crossing count, and without a crossing nothing.
    amid = ("10,6|kerb=raised", "40,6|kerb=raised", "10,6 40,6|highway=service")
    net, raw = made(tmp_path, ["pedestrian|10,4 10,8|"], *nodes, *amid, form=CROSSING)
    counts = mapped_places.count_kerbs(mapped_places.Crossings(net), raw, ground(raised_m), HERE)
    assert [*counts.values()] == [4, 2, 1, 2, 2, 1]


KERBS = (
    "kerb=raised > raised",
    "kerb=flush > lowered",
    "height=3 > ",
    "kerb=lowered, kerb:height=4 cm > raised",
    "kerb:height=0.02 > lowered",
    "barrier=kerb, height=1 > raised",
)


@pytest.mark.parametrize("case", KERBS)
def test_what_the_map_calls_a_kerb(case):
    tags, called = case.split(" > ")
    assert mapped_places.mapped_kerb(tags_of(tags)) == called


def test_squares_are_areas_in_the_open_without_their_holes(tmp_path):
    ways = (
        "0,0 10,0 10,10 0,10 0,0|",
        "2,2 4,2 4,4 2,4 2,2|",
        "50,50 70,50 70,70 50,70 50,50|place=square",
        "20,20 30,20 30,30 20,20|highway=pedestrian, area=yes, layer=-1",
        "20,20 30,20 30,30 20,20|highway=pedestrian",
    )
    more = f"""<relation id="1"><member type="way" ref="0"/><member type="way" ref="1"/>
    {xml("type=multipolygon, highway=pedestrian")}</relation>"""
    raised_m = np.outer(np.ones(700), np.arange(700) < 20)
    net, raw = made(tmp_path, [], *ways, more=more)
    counts = mapped_places.count_squares(net, raw, ground(raised_m), HERE)
    assert [*counts.values()] == [2, 196, 20]


def test_a_town_without_its_map_is_refused(corner, capsys):
    assert main(["map_truth", "--towns", str(corner)]) == 2
    assert "osm/*.osm.xml.gz, expected one" in capsys.readouterr().err


@pytest.mark.proof
def test_a_shipped_town_has_only_ways_of_its_map(tmp_path):
    assert main(["map_truth", "--towns", "monaco", "--json", str(tmp_path / "a")]) == 0
    assert json.loads((tmp_path / "a").read_text())["monaco"]["pavement of no way in the map, m"] == 0.0
