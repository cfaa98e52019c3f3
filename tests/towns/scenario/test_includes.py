"""What a scenario's files include is a part of it, for whoever reads them beside SUMO."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from tests.towns.furniture.standing_samples import signal_net
from wcsim.errors import TownError
from wcsim.towns.build_street import build_street
from wcsim.towns.cache.street_cache import unpack_street
from wcsim.towns.checks.check import _demand_classes, _find_notes, _for_routes, _unroutable_trips
from wcsim.towns.checks.cures import Cures
from wcsim.towns.scenario.files import with_included
from wcsim.towns.scenario.town import Town, content_hash, open_town
from wcsim.towns.street import _street_key
from wcsim.towns.sumo.net import read_net
from wcsim.towns.sumo.xml_io import content_digest

CONFIG = """<configuration><input><net-file value="s.net.xml"/><route-files value="{routes}"/>
    <additional-files value="{additional}"/></input></configuration>"""
THINGS = """<poly id="house" type="building.yes" fill="1" shape="20,20 40,20 40,40 20,40"/>
    <poi id="bin" type="wcsim.bin" lane="A1B1_0" pos="20"/>
    <busStop id="stop" lane="A1B1_1" startPos="30" endPos="42"/>"""
CALIBRATOR = """<calibrator id="c" lane="B1C1_1" pos="5" period="60">
    <flow type="cab" begin="0" end="9" from="B1C1" to="C1B1"/></calibrator>"""
PEOPLE = """<person id="p" type="walker" depart="3"><walk edges="A1B1 B1C1"/></person>
    <trip id="lost" type="cab" depart="4" from="A1B1" to="nowhere"/>"""
PARTS = {
    "parts/types.add.xml": '<vType id="cab" vClass="taxi"/><vType id="walker" vClass="pedestrian"/>',
    "parts/things.poly.xml": THINGS,
    "parts/calibrator.add.xml": CALIBRATOR,
    "parts/own.rou.xml": '<trip id="t" type="cab" depart="1" from="A1B1" to="B1C1"/>',
    "parts/people.rou.xml": PEOPLE,
    "parts/more.add.xml": '<include href="deeper/signals.tll.xml"/>',  # from its own folder
}
ADDITIONAL = ("parts/types.add.xml", "parts/things.poly.xml", "parts/calibrator.add.xml")
ROUTES = ("parts/own.rou.xml", "parts/people.rou.xml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario whose files do nothing but include others, and `plain.sumocfg`, which names those itself."""
    place = tmp_path_factory.mktemp("including")
    name, state = signal_net(place).phases[0]
    mixed = "".join("rGyg"[i % 4] for i in range(len(state)))
    program = f'<tlLogic id="{name}" type="static" programID="n"><phase duration="9" state="{mixed}"/></tlLogic>'
    top = {
        "city.add.xml": "".join(f'<include href="{name}"/>' for name in (*ADDITIONAL, "parts/more.add.xml")),
        "city.rou.xml": "".join(f'<include href="{name}"/>' for name in ROUTES),
    }
    (place / "parts" / "deeper").mkdir(parents=True)
    for path, text in (PARTS | top | {"parts/deeper/signals.tll.xml": program}).items():
        (place / path).write_text(f"<additional>{text}</additional>")
    named = ",".join((*ADDITIONAL, "parts/deeper/signals.tll.xml"))
    for config, routes, more in (("city", "city.rou.xml", "city.add.xml"), ("plain", ",".join(ROUTES), named)):
        text = CONFIG.format(routes=routes, additional=more)
        (place / f"{config}.sumocfg").write_text(text)
    return place


@pytest.fixture(scope="module")
def including(folder: Path) -> Town:
    return open_town(folder / "city.sumocfg")


@pytest.fixture(scope="module")
def plain(folder: Path) -> Town:
    return open_town(folder / "plain.sumocfg")


def test_the_street_is_that_of_all_files(including: Town, plain: Town) -> None:
    got, expected = (unpack_street(build_street(town)) for town in (including, plain))
    assert len(got.signal_heads) == len(expected.signal_heads) and len(got.mesh.faces) == len(expected.mesh.faces)
    assert np.array_equal(got.mesh.vertices_W_m, expected.mesh.vertices_W_m)


def test_a_check_knows_who_travels_and_who_has_no_way(including: Town, plain: Town) -> None:
    assert _demand_classes(including) == _demand_classes(plain) == ("pedestrian", "taxi")
    assert _unroutable_trips(including) == _unroutable_trips(plain) == 1
    assert not any("no buildings" in note for note in _find_notes(including, read_net(including.net)))


def test_what_is_included_stands_where_it_is_named(tmp_path: Path) -> None:
    """A distribution that comes before its types would be empty, and its trips would be routed as cars."""
    mix = '<vTypeDistribution id="mix" vTypes="train tram"/>'
    texts = {
        "types.add.xml": '<include href="deeper/trains.add.xml"/><vType id="tram" vClass="tram"/>',
        "deeper/trains.add.xml": '<vType id="train" vClass="rail"/><e1Detector id="d"/>',
        "mix.add.xml": f'<vType id="first"/><include href="types.add.xml"/>{mix}',
    }
    (tmp_path / "deeper").mkdir()
    for name, text in texts.items():
        (tmp_path / name).write_text(f"<additional>{text}</additional>")
    needed = _for_routes([tmp_path / "mix.add.xml"]).getroot()
    assert needed is not None
    assert [element.get("id") for element in needed] == ["first", "train", "tram", "mix"]


def test_the_cure_of_trips_without_a_way_names_the_parts_that_matter(including: Town) -> None:
    told = Cures(including).routes()
    assert "move each <calibrator> of calibrator.add.xml into a file of its own" in told
    assert "--vtype-output /dev/null" in told and f"-a {including.folder.resolve()}/city.add.xml" in told


def test_what_is_included_counts_in_the_hashes(including: Town, plain: Town, folder: Path) -> None:
    before = content_hash(including), _street_key(including)
    parts = {name: (folder / name).read_bytes() for name in ("parts/people.rou.xml", "parts/deeper/signals.tll.xml")}
    seen = []
    for name, data in parts.items():
        (folder / name).write_bytes(data.replace(b"<additional>", b'<additional x="1">'))
        seen.append((content_hash(including), _street_key(including)))
        (folder / name).write_bytes(data)
    (people, same_street), (signals, other_street) = seen
    assert len({before[0], people, signals}) == 3 and same_street == before[1] != other_street
    named = sorted(content_digest(path) for path in (plain.net, *plain.routes, *plain.additional))
    assert content_hash(plain) == hashlib.sha256("\n".join(named).encode()).hexdigest()  # as it always was


def test_every_file_comes_once_and_none_from_outside(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()

    def written(name: str, *included: str) -> Path:
        path = inside / name
        body = "".join(f'<include href="{other}"/>' for other in included)
        path.write_text(f"<additional><!-- <include href='x'/> -->{body}</additional>")
        return path

    last, first = written("last.xml"), written("first.xml", "last.xml", "../inside/last.xml", "")
    assert with_included((first, last), inside) == (first, last)
    for included, told in (
        ("gone.xml", r"first\.xml: names a file that does not exist"),
        ("../secret.xml", r"first\.xml: names .*secret\.xml, which is outside"),
        ("../inside/first.xml", r"include each other \(first\.xml -> first\.xml\); remove one <include>"),
    ):
        (tmp_path / "secret.xml").write_text("<additional/>")
        with pytest.raises(TownError, match=told):
            with_included((written("first.xml", included),), inside)
    assert len(with_included((written("first.xml", "../secret.xml"),), None)) == 2
    chain = [written(f"{k}.xml", f"{k + 1}.xml") for k in range(20)]
    with pytest.raises(TownError, match="include each other"):
        with_included(chain[:1], inside)
