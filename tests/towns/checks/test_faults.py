import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.towns import tiny_osm
from tests.support.typed import printed
from tests.towns.made.nets import edge, lane, write_net
from tests.towns.made.unpaved import write_unpaved
from tests.towns.osm.test_bridges import net_of
from wcsim.towns.checks.check import (
    TownReport,
    _demand_classes,
    _faults_of,
    _find_notes,
    _no_walkers,
    _Overlap,
    check_town,
)
from wcsim.towns.importing.importer import ImportOrder, _build_net, _convert_net
from wcsim.towns.osm.clean import filter_osm
from wcsim.towns.osm.read import Box, read_extract
from wcsim.towns.scenario.town import Town, chair_ways, open_town
from wcsim.towns.sumo.net import Net, read_net
from wcsim.towns.sumo.xml_io import read_bytes
from wcsim.towns.walking.islands import _linked, largest_share, stray_footways, walkable_parts

FINE = TownReport(
    town="corner",
    crossings=4,
    walkingareas=4,
    walkable_largest_share=1.0,
    walk_km=1.0,
    classes=("passenger", "pedestrian"),
    unroutable=0,
    lefthand=False,
)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"walkable_largest_share": 0.6}, "only 60.0% of the walkable.*join the parts: .*/netedit'? -s .*net.xml.gz"),
        ({"unroutable": 7}, "7 trips have no route.*/duarouter'? -n .* -r .* --ignore-errors -o ."),
    ],
)
def test_each_fault_comes_with_its_cure(corner_town: Town, change: dict[str, object], told: str) -> None:
    net = read_net(corner_town.net)
    assert _faults_of(corner_town, net, FINE) == ()
    (fault,) = _faults_of(corner_town, net, replace(FINE, **change))  # type: ignore[arg-type]
    assert re.search(told, fault) and "\n" not in fault
    assert len(_find_notes(replace(corner_town, poly=None), net)) == 1


def test_a_demand_without_walkers_is_a_note_with_its_cure(corner_town: Town) -> None:
    (note,) = _no_walkers(corner_town, read_net(corner_town.net), replace(FINE, classes=("bus",)))
    assert re.search("no pedestrians.*/randomTrips.py'? -n .* --pedestrians .* -b 0 -e 3600 ", note)
    assert not _faults_of(corner_town, read_net(corner_town.net), replace(FINE, classes=("bus",)))


@pytest.mark.parametrize(("lacks", "told"), [("walkingareas", "no walking areas"), ("crossings", "no crossings")])
def test_a_net_without_ways_on_foot_is_paved(lacks: str, told: str, tmp_path: Path) -> None:
    town = open_town(write_unpaved(tmp_path / "u"))
    (fault,) = _faults_of(town, read_net(town.net), replace(FINE, **{lacks: 0}))  # type: ignore[arg-type]
    assert re.search(told + ".*wcsim town pave /.*sumocfg --out .*-paved", fault) and "\n" not in fault


def test_nobody_is_told_to_make_walkers_for_a_net_where_no_way_can_be_laid(corner_town: Town, tmp_path: Path) -> None:
    track = write_net(tmp_path, edge("t", lane("0,0 60,0", 'allow="rail"')))
    faults = _faults_of(corner_town, track, replace(FINE, walkingareas=0, classes=("rail",)))
    assert [fault for fault in faults if "walk" in fault] == [fault for fault in faults if "no walking areas" in fault]
    assert not _no_walkers(corner_town, track, replace(FINE, walkingareas=0, classes=("rail",)))


def test_streets_over_the_pavements_of_others_are_a_note_however_many(corner_town: Town) -> None:
    net = read_net(corner_town.net)
    for area_m2 in (172.0, 1e6):
        over = (_Overlap(street="a", pavement="b", area_m2=area_m2),)
        assert _faults_of(corner_town, net, replace(FINE, overlaps=over)) == ()
        (told,) = [note for note in _find_notes(corner_town, net, over) if "edge b under a" in note]
        assert f"{area_m2:.0f} m2 of pavement overlap the carriageway" in told and "places of more than 3 m2" in told
        assert shlex.split(printed(told, "move or delete"))[1:] == ["-s", str(corner_town.net)]


def test_the_side_of_the_traffic_is_told_behind_a_long_comment(corner_town: Town, tmp_path: Path) -> None:
    text = read_bytes(corner_town.net).decode().replace("<net ", f'<!-- {"x" * 5000} -->\n<net lefthand="1" ', 1)
    (tmp_path / "left.net.xml").write_text(text, encoding="utf-8")
    assert check_town(replace(corner_town, net=tmp_path / "left.net.xml", border=None)).lefthand


def test_types_that_a_distribution_names_count(corner_town: Town, tmp_path: Path) -> None:
    types = '<vType id="slow" vClass="pedestrian"/>\n<vTypeDistribution id="all"><vType refId="slow" probability="1"/>'
    person = '<person id="p" type="all" depart="0"><walk edges="A0A1"/></person>'
    routes = tmp_path / "own.rou.xml"
    routes.write_text(f"<routes>{types}</vTypeDistribution>{person}</routes>", encoding="utf-8")
    assert _demand_classes(replace(corner_town, routes=(routes,), border=None)) == ("pedestrian",)


def test_buildings_of_a_file_of_any_name_are_seen(corner_town: Town, tmp_path: Path) -> None:
    net, more = read_net(corner_town.net), tmp_path / "own.add.xml"
    house = '<poly id="house" type="building" fill="1" shape="10,10 20,10 20,20 10,20 10,10"/>'
    for shapes, missed in (("", 1), (house, 0)):
        more.write_text(f"<additional>{shapes}</additional>", encoding="utf-8")
        notes = _find_notes(replace(corner_town, poly=None, additional=(more,), border=None), net)
        assert len([note for note in notes if "no buildings or trees" in note]) == len(notes) == missed


@pytest.mark.proof
@pytest.mark.shared
def test_footways_that_nobody_can_walk_to_are_left_out(tmp_path: Path, shared: Path) -> None:
    extract = read_extract(shared / "towns" / "leeds.osm.xml.gz", Box(-1.538528, 53.795722, -1.531532, 53.799858))
    order = ImportOrder(map_file=tmp_path, name="x", split="train", out=tmp_path, bbox=extract.box, lefthand=True)
    filter_osm(extract.root)
    (tmp_path / "all.osm.xml").write_bytes(extract.xml())
    whole = _convert_net(order, "all.osm.xml", tmp_path)
    linked_share = share_of_links(read_net(whole))
    assert len(stray_footways(read_net(whole), whole)) >= 5 and linked_share < 0.98
    built = _build_net(order, extract.root, tmp_path)
    assert built.share == largest_share(walkable_parts(built.net, chair_ways(cycle_paths=False))) > 0.95
    assert share_of_links(built.net) > linked_share


def share_of_links(net: Net) -> float:
    """Share of the walkable ground that SUMO's walkers can reach from its largest part."""
    sizes_m2 = _linked(net)[1].values()
    return max(sizes_m2) / sum(sizes_m2)


def test_fast_streets_have_pavements_and_crossings_too(tmp_path: Path) -> None:
    osm = tmp_path / "tiny.osm"
    text = tiny_osm().replace('<tag k="sidewalk" v="both"/>', '<tag k="maxspeed" v="40 mph"/>')
    osm.write_text(text.replace('v="residential"', 'v="primary"'), encoding="utf-8")
    net = net_of(osm).net
    streets = [edge for edge in net.edges if not edge.function]
    assert all(any(lane.permits("pedestrian") for lane in edge.lanes) for edge in streets)
    assert len([edge for edge in net.edges if edge.function == "crossing"]) >= 12
