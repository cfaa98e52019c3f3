"""Flyovers, motorways, and streets that the map says have no pavement."""

from pathlib import Path

import pytest

from tests.cli.towns import way
from wcsim.towns.checks.check import _find_overlaps
from wcsim.towns.importing.importer import ImportOrder, _build_net, _BuiltNet
from wcsim.towns.osm.clean import _quicken_motorways, cut_bridges
from wcsim.towns.osm.read import read_extract
from wcsim.towns.sumo.net import LaneKind
from wcsim.towns.sumo.xml_io import parse_root

NODES = {
    **{1: (0, 0), 2: (300, 0), 3: (300, 300), 4: (0, 300), 5: (150, 0), 6: (150, 300), 8: (0, 150), 9: (300, 150)},
    **{10: (80, 150), 11: (220, 150)},
}
Tags = dict[str, str]
RING: list[tuple[int, list[int], Tags]] = [
    (20, [1, 5, 2, 9, 3, 6, 4, 8, 1], {"highway": "residential"}),
]
BRIDGE = {"bridge": "yes", "layer": "1"}


def osm(*ways: tuple[int, list[int], Tags]) -> bytes:
    """An extract of the nodes above, in metres, with these ways."""
    lines = [
        f'<node id="{k}" lat="{52 + y / 111_320:.7f}" lon="{13 + x / 68_500:.7f}"/>' for k, (x, y) in NODES.items()
    ]
    lines += [way(number, nodes, **tags) for number, nodes, tags in ways]
    return f'<osm version="0.6">{"".join(lines)}</osm>'.encode()


def built(folder: Path, *ways: tuple[int, list[int], Tags]) -> _BuiltNet:
    (folder / "a.osm").write_bytes(osm(*ways))
    return net_of(folder / "a.osm")


def net_of(osm: Path) -> _BuiltNet:
    extract, folder = read_extract(osm), osm.parent
    return _build_net(
        ImportOrder(map_file=folder, name="x", split="train", out=folder, bbox=extract.box, lefthand=False),
        extract.root,
        folder,
    )


@pytest.mark.parametrize(
    ("upper", "lower", "left", "told"),
    [
        ({"highway": "primary", "name": "Flyover"}, {"highway": "secondary"}, {11: 1, 12: 2}, ("Flyover",)),
        ({"highway": "motorway", "ref": "A1"}, {"highway": "footway"}, {11: 1, 12: 2}, ("A1",)),
        ({"highway": "footway"}, {"railway": "tram"}, {11: 1, 12: 2}, ("a footway without a name",)),
        ({"highway": "primary"}, {"railway": "rail"}, {12: 1}, ()),
        ({"railway": "rail"}, {"highway": "primary"}, {11: 1, 12: 2}, ()),
        ({"highway": "primary"}, {"waterway": "river"}, {11: 1, 12: 1}, ()),
        ({"highway": "primary", "bridge": "no", "layer": "0"}, {"highway": "secondary"}, {11: 1, 12: 1}, ()),
    ],
    ids=["road", "motorway over footway", "footbridge", "over rails", "rail bridge", "over water", "no bridge"],
)
def test_the_lower_of_two_ways_stays(upper: Tags, lower: Tags, left: dict[int, int], told: tuple[str, ...]) -> None:
    crossing = (12, [8, 10, 11, 9], BRIDGE | upper)
    side = (13, [10, 4], {"highway": "residential"}), (14, [11, 3], {"highway": "residential"})
    root = parse_root(osm(*RING, (11, [5, 6], lower), crossing, *side), "text")
    assert cut_bridges(root) == told
    kept = {int(way.get("id", "0")): [int(nd.get("ref", "0")) for nd in way.iterfind("nd")] for way in root.iter("way")}
    pieces = [nodes for number, nodes in kept.items() if number == 12 or number > 20]
    assert {11: int(11 in kept), 12: len(pieces)} == {11: 0} | left
    assert pieces == ([[8, 10], [11, 9]] if left[12] == 2 else [[8, 10, 11, 9]])


def test_no_street_of_a_built_town_lies_on_the_pavement_of_another(tmp_path: Path) -> None:
    ways = [*RING, (11, [5, 6], {"highway": "secondary"}), (12, [8, 9], {"highway": "primary", "name": "Flyover"})]
    flat = _find_overlaps(built(tmp_path, *ways).net)  # the map does not say that it is a bridge
    assert {item.street.lstrip("-")[:2] for item in flat} == {"11", "12"} and flat[0].area_m2 > 10.0
    ways[-1][2].update(BRIDGE)
    made = built(tmp_path, *ways)
    assert made.bridges == ("Flyover",) and _find_overlaps(made.net) == ()
    assert not [edge for edge in made.net.edges if edge.id.lstrip("-").startswith("12")]


@pytest.mark.parametrize(
    "tags",
    [
        {"highway": "motorway", "oneway": "yes", "maxspeed": "50"},
        {"highway": "trunk", "motorroad": "yes", "maxspeed": "30 mph"},
        {"highway": "motorway_link", "oneway": "yes"},
        {"highway": "primary", "foot": "no"},
        {"highway": "residential", "sidewalk": "none"},
    ],
    ids=lambda tags: tags["highway"],
)
def test_streets_that_have_no_pavement_get_none(tmp_path: Path, tags: Tags) -> None:
    across = (12, [8, 10, 11, 9], tags), (13, [10, 4], {"highway": "residential"})
    net = built(tmp_path, *RING, *across).net
    paved = {lane.edge_id.lstrip("-").split("#")[0] for lane in net.lanes(LaneKind.SIDEWALK)}
    assert {"13", "20"} <= paved and "12" not in paved
    crossed = {edge.lstrip("-").split("#")[0] for item in net.edges for edge in item.crossed}
    assert net.lanes(LaneKind.CROSSING) and ("12" not in crossed or tags["highway"] not in ("motorway", "trunk"))


def test_a_town_of_footways_alone_has_no_bridges_and_no_overlaps(tmp_path: Path) -> None:
    assert cut_bridges(parse_root(osm((1, [1, 2], {"waterway": "river"})), "text")) == ()
    made = built(tmp_path, (20, RING[0][1], {"highway": "footway"}), (11, [5, 6], {"highway": "footway"}))
    assert made.bridges == () and _find_overlaps(made.net) == ()


def test_only_slow_motorways_are_made_faster() -> None:
    speeds = {"50": "66", "30 mph": "66", "80": "80", "none": "none", "signals": "signals"}
    for given, made in speeds.items():
        for tags, wanted in (({"highway": "motorway"}, made), ({"highway": "trunk"}, given)):
            root = parse_root(osm((12, [8, 9], tags | {"maxspeed": given})), "text")
            _quicken_motorways(root)
            assert {tag.get("v") for tag in root.iter("tag") if tag.get("k") == "maxspeed"} == {wanted}
