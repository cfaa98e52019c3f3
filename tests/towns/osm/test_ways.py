from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.towns import way
from tests.support.tracked import ROOT
from tests.towns.conftest import run_in_sumo
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.furniture.road_marks import unmarked_crossings
from wcsim.towns.importing.importer import ImportOrder, import_town
from wcsim.towns.osm.tags import ROWS
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.additional import read_items
from wcsim.towns.sumo.net import WALK_KINDS, LaneKind, read_net

_NODE = '<node id="{}" lat="{:.7f}" lon="{:.7f}">{}</node>'
_TAG = '<tag k="{}" v="{}"/>'
# Tags of the streets amid a grid, and where they have pavements.
_STREETS: tuple[tuple[dict[str, str], str], ...] = (
    ({}, "left right"),
    ({"sidewalk": "separate", "foot": "yes"}, ""),
    ({"sidewalk:left": "separate", "sidewalk:right": "no"}, ""),
    ({"sidewalk": "right"}, "right"),
    ({"sidewalk:right": "no"}, "left"),
    ({"sidewalk:both": "no", "sidewalk:left": "yes"}, "left"),
    ({"foot": "no"}, ""),
    ({"oneway": "yes", "sidewalk": "both"}, "left right"),
    ({"oneway": "-1"}, "against"),
    ({"railway": "tram", "highway": ""}, ""),
)


def node(number: int, x_m: float, y_m: float, **tags: str) -> str:
    told = "".join(_TAG.format(key.replace("__", ":"), value) for key, value in tags.items())
    return _NODE.format(number, 60.0 + y_m / 111_320.0, 25.0 + x_m / 55_660.0, told)


def town(folder: Path, *elements: str, lefthand: bool = False) -> Town:
    (folder / "map.osm").write_text("\n".join(['<osm version="0.6">', *elements, "</osm>"]), "utf-8")
    order = ImportOrder(map_file=folder / "map.osm", name="small", split="test", out=folder / "small")
    return import_town(replace(order, traffic=0.0, lefthand=lefthand)).town


@pytest.mark.parametrize("lefthand", [False, True])
def test_pavements_are_where_the_map_does_not_deny_them(tmp_path: Path, lefthand: bool) -> None:
    """Streets from the south to the north between two that have pavements, 80 m apart."""
    nodes, ways, ends = [], [], range(len(_STREETS))
    for number in ends:
        nodes += [node(100 + number, 80.0 * number, 0.0), node(200 + number, 80.0 * number, 120.0)]
    for row in (100, 200):
        ways.append(way(row, [row + number for number in ends], highway="residential", sidewalk="both"))
    for number, (tags, _) in enumerate(_STREETS):
        text = way(10 + number, [100 + number, 200 + number], **{"highway": "residential", **tags})
        ways.append(text.replace(_TAG.format("highway", ""), ""))
    net = read_net(town(tmp_path, *nodes, *ways, lefthand=lefthand).net)
    paved = {edge.id for edge in net.streets if edge.has(LaneKind.SIDEWALK)}
    for number, (tags, told) in enumerate(_STREETS):
        sides = told.replace("against", "right" if lefthand else "left").split()
        along, against = ("left", "right") if lefthand else ("right", "left")
        edges = {along: str(10 + number), against: f"-{10 + number}"}
        assert {edges[side] for side in sides} == paved & set(edges.values()), tags


def test_the_side_of_a_way_is_known_where_it_was_joined_to_another_one_that_runs_against_it(tmp_path: Path) -> None:
    nodes = [node(1, 0.0, 0.0), node(2, 0.0, 60.0), node(3, 0.0, 120.0), node(4, 80.0, 120.0), node(5, 80.0, 0.0)]
    ring = [way(10, [3, 4, 5, 1], highway="residential", sidewalk="both"), way(11, [1, 2], highway="residential")]
    denied = way(12, [3, 2], highway="residential").replace("</way>", _TAG.format("sidewalk:right", "no") + "</way>")
    net = read_net(town(tmp_path, *nodes, *ring, denied).net)
    joined = {edge.id: edge.has(LaneKind.SIDEWALK) for edge in net.streets if "10" not in edge.id}
    assert sorted(joined.values()) == [False, True] and not joined.get("-11", joined.get("12"))


_CROSSINGS = (
    {"crossing": "no"},
    {"crossing": "uncontrolled", "kerb": "raised"},
    {"crossing": "unmarked", "kerb": "flush"},
    {"crossing": "marked", "crossing__markings": "no"},
    {"crossing": "informal", "kerb": "lowered"},
)


@pytest.fixture(scope="module")
def crossed(tmp_path_factory: pytest.TempPathFactory) -> Town:
    """A block of streets with crossings amid two of them, and ways on foot through its middle."""
    corners = [node(1, 0.0, 0.0), node(2, 300.0, 0.0), node(3, 300.0, 150.0), node(4, 0.0, 150.0)]
    amid, rows = [], {}
    for row, y_m in ((10, 0.0), (20, 150.0)):
        rows[row] = [row + number for number in range(len(_CROSSINGS))]
        for number, tags in enumerate(_CROSSINGS):
            amid.append(node(row + number, 50.0 + 40.0 * number, y_m, highway="crossing", **tags))
    paths = [node(30 + number, 50.0 + 40.0 * number + 20.0 * (number % 2), 75.0) for number in range(4)]
    on_foot = [
        way(91, [10, 30, 20], highway="footway", surface="asphalt"),
        way(92, [11, 31, 21], highway="footway", wheelchair="no"),
        way(93, [12, 32, 22], highway="footway", smoothness="horrible"),
        way(94, [13, 33, 23], highway="steps").replace("</way>", _TAG.format("ramp:wheelchair", "yes") + "</way>"),
    ]
    streets = [
        way(61, [1, *rows[10], 2], highway="residential", sidewalk="both"),
        way(62, [4, *rows[20], 3], highway="residential"),
        way(63, [1, 4], highway="residential"),
        way(64, [2, 3], highway="residential"),
    ]
    return town(tmp_path_factory.mktemp("crossed"), *corners, *amid, *paths, *streets, *on_foot)


def test_a_crossing_of_the_map_is_one_and_painted_as_it_says(crossed: Town, tmp_path: Path) -> None:
    net = read_net(crossed.net)
    plain = unmarked_crossings(read_items(crossed.additional, (0, 0), net), net)
    lines = [lane.edge_id for lane in net.lanes(LaneKind.CROSSING)]
    for row in (10, 20):
        for number in range(len(_CROSSINGS)):
            there = [edge for edge in lines if edge.startswith(f":{row + number}_")]
            assert len(there) == (number > 0)
            assert [edge in plain for edge in there] == [number > 1] * len(there)
    run_in_sumo(crossed.sumocfg, 5, tmp_path)


def test_kerbs_of_crossings_are_as_high_as_the_map_says(crossed: Town) -> None:
    street = unpack_street(build_street(crossed))
    net = read_net(crossed.net, crossed.file.origin_m)
    for lane in net.lanes(LaneKind.CROSSING):
        number = int(lane.edge_id[1:3]) % 10 if lane.edge_id[1:3].isdigit() else 0
        if lane.edge_id[3:4] == "_" and number:
            highest = max(street.grid.raised_at(end) for end in (lane.points_m[0], lane.points_m[-1]))
            assert (highest > 0.1) == (_CROSSINGS[number].get("kerb") == "raised"), lane.edge_id


def test_wheelchairs_are_not_routed_over_ways_that_they_cannot_use(crossed: Town) -> None:
    net, walk = read_net(crossed.net), unpack_street(build_street(crossed)).walk
    lanes = {lane.id for lane in net.lanes(*WALK_KINDS) if lane.edge_id.startswith("9")}
    assert {lane[:2] for lane in lanes} == {"91", "92", "93", "94"}
    assert {edge.sumo_id[:2] for edge in walk.edges if edge.sumo_id in lanes} == {"91", "94"}


def test_the_manual_shows_what_becomes_of_each_tag() -> None:
    manual = (ROOT / "docs" / "authoring.md").read_text("utf-8")
    for row in ROWS:
        tags = "; ".join(part.replace("|", ", ") for part in row.tags.split())
        assert f"| {row.on} | `{tags}` | {row.becomes} |" in manual
