from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import pytest

from wcsim.errors import SumoError, TownError
from wcsim.towns import trial
from wcsim.towns.check import unroutable_trips
from wcsim.towns.importer import ImportOrder, import_town
from wcsim.towns.osmfilter import filter_osm
from wcsim.towns.tools import run_tool
from wcsim.towns.town import Town
from wcsim.towns.xmlio import parse_root, read_bytes, read_root

SHARED = Path(__file__).resolve().parents[3] / "shared" / "towns"


@pytest.fixture
def order(manhattan_town: Town, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ImportOrder:
    monkeypatch.setattr(trial, "TRIAL_S", 20)
    osm = manhattan_town.folder / "osm"
    west, south, east, north = (float(text) for text in (osm / "bbox").read_text(encoding="utf-8").split(","))
    return ImportOrder(
        osm=osm / "manhattan.osm.xml.gz",
        bbox=(west, south, east, north),
        name="small",
        split="test",
        out=tmp_path / "towns" / "small",
    )


def test_two_builds_give_the_same_bytes_and_leave_nothing_behind(order: ImportOrder) -> None:
    town = import_town(order)
    first = {path.relative_to(town.folder): path.read_bytes() for path in town.folder.rglob("*") if path.is_file()}
    import_town(order)  # over the first one
    second = {path.relative_to(town.folder): path.read_bytes() for path in town.folder.rglob("*") if path.is_file()}
    assert first == second
    assert [path.name for path in order.out.parent.iterdir()] == ["small"]
    assert {"small.sumocfg", "small.net.xml.gz", "small.poly.xml.gz", "small.rou.xml.gz", "small.add.xml"} <= {
        path.name for path in town.folder.iterdir()
    }


def test_shipped_net_is_what_its_extract_gives(order: ImportOrder, manhattan_town: Town) -> None:
    town = import_town(order)
    assert read_bytes(town.net) == read_bytes(manhattan_town.net)
    assert town.poly is not None and manhattan_town.poly is not None
    assert read_bytes(town.poly) == read_bytes(manhattan_town.poly)


def test_failed_import_leaves_the_old_town_and_no_rubbish(order: ImportOrder, tmp_path: Path) -> None:
    import_town(order)
    before = sorted(path.name for path in order.out.iterdir())
    broken = tmp_path / "broken.osm.xml"
    broken.write_text("<osm><way id='1'/></osm>", encoding="utf-8")
    with pytest.raises((SumoError, TownError), match="small"):
        import_town(replace(order, osm=broken))
    assert sorted(path.name for path in order.out.iterdir()) == before
    assert [path.name for path in order.out.parent.iterdir()] == ["small"]


def test_bad_orders_are_refused(order: ImportOrder, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine", encoding="utf-8")
    cases = [
        (replace(order, name="a b"), "cannot be named"),
        (replace(order, split="both"), "unknown split"),
        (replace(order, bbox=(2.0, 0.0, 1.0, 1.0)), "west,south,east,north"),
        (replace(order, osm=Path("x.osm.pbf")), "osmium cat"),
        (replace(order, out=tmp_path / "full"), "not a town"),
        (replace(order, osm=tmp_path / "none.osm"), "cannot be read"),
    ]
    for bad, reason in cases:
        with pytest.raises(TownError, match=reason):
            import_town(bad)
    assert (tmp_path / "full" / "thesis.txt").read_text(encoding="utf-8") == "mine"


def test_filter_takes_out_what_crashes_netconvert_or_lies_under_ground() -> None:
    text = b"""<osm>
      <node id="1"><tag k="highway" v="crossing"/></node><node id="2"><tag k="highway" v="crossing"/></node>
      <way id="10"><nd ref="1"/><tag k="highway" v="footway"/></way>
      <way id="11"><nd ref="2"/><tag k="highway" v="footway"/><tag k="layer" v="-1"/></way>
      <way id="12"><nd ref="2"/><tag k="highway" v="corridor"/></way>
      <way id="13"><nd ref="2"/><tag k="building" v="yes"/></way>
      <way id="14"><nd ref="2"/><tag k="railway" v="subway"/></way></osm>"""
    filtered = filter_osm(parse_root(text, "text"))
    root = parse_root(filtered.data, "filtered")
    assert [way.get("id") for way in root.iterfind("way")] == ["10", "13"]
    assert (filtered.dropped_ways, filtered.orphan_crossings) == (3, 1)
    assert [len(node) for node in root.iterfind("node")] == [1, 0]


def test_shipped_demand_runs_without_errors_and_never_runs_dry(manhattan_town: Town, tmp_path: Path) -> None:
    summary = tmp_path / "summary.xml"
    options = ["-c", str(manhattan_town.sumocfg), "--end", "200", "--summary-output", str(summary)]
    run = run_tool("sumo", options, tmp_path)
    assert run.returncode == 0
    assert not [line for line in run.output.splitlines() if "route" in line.lower() or line.startswith("Error")]
    steps = list(read_root(summary))
    assert int(steps[-1].attrib["running"]) > 5
    assert unroutable_trips(manhattan_town) == 0
    flows = list(read_root(manhattan_town.routes[0]))
    ends = [float(flow.attrib["end"]) for flow in flows if flow.tag in ("flow", "personFlow")]
    begins = [float(flow.attrib["begin"]) for flow in flows if flow.tag == "personFlow"]
    assert max(ends) >= 1e6 and max(begins) >= 86_400 and begins == sorted(begins)


def test_unroutable_trips_are_counted(corner_town: Town, tmp_path: Path) -> None:
    routes = tmp_path / "x.rou.xml"
    routes.write_text(
        '<routes><trip id="a" depart="0" from="WC" to="NC"/><trip id="b" depart="1" from="WC" to="CE"/>'
        '<person id="p" depart="2"><walk from="WC" to="nope"/></person></routes>',
        encoding="utf-8",
    )
    assert unroutable_trips(replace(corner_town, routes=(routes,))) == 2


def test_left_hand_town_can_be_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not (SHARED / "leeds.osm.xml.gz").is_file():
        pytest.skip("the left-hand extract lies in the development material beside the checkout, which is not here")
    monkeypatch.setattr(trial, "TRIAL_S", 20)
    bbox = tuple(float(text) for text in (SHARED / "leeds.bbox").read_text(encoding="utf-8").split(","))
    order = ImportOrder(
        osm=SHARED / "leeds.osm.xml.gz",
        bbox=(bbox[0], bbox[1], bbox[2], bbox[3]),
        name="leeds",
        split="test",
        out=tmp_path / "leeds",
        lefthand=True,
    )
    net = gzip.decompress(import_town(order).net.read_bytes())
    assert b'lefthand="true"' in net[:2000]
