"""Every printed cure does what it says when it is typed as it stands."""

import shlex
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.support.typed import printed, typed
from tests.towns.checks.test_faults import FINE
from tests.towns.conftest import run_in_sumo, tool_output
from tests.towns.made.nets import hilly
from tests.towns.made.strangers import made
from tests.towns.made.unpaved import BEGIN_S, write_unpaved
from wcsim.cli.main import main
from wcsim.cli.shared.common import parse_options
from wcsim.cli.town.import_ import OsmImportOptions
from wcsim.errors import TownError
from wcsim.towns.checks.check import STEEPEST, _faults_of, _unroutable_trips
from wcsim.towns.checks.cures import FASTEST_MPS, Cures
from wcsim.towns.ground.relief import steepest_grade
from wcsim.towns.scenario.town import Town, open_town
from wcsim.towns.sumo.net import read_net

_TYPES = '<vType id="slow" vClass="passenger" maxSpeed="9"/>'
_LOST = """<vehicle id="lost" depart="50400"><route edges="elsewhere nowhere"/></vehicle>
<trip id="found" type="slow" depart="50400" from="A0B0" to="B1C1"/>
<trip id="far" type="slow" depart="58000" from="A0B0" to="B1C1"/>
<trip id="below" type="slow" depart="50399" from="A0B0" to="B1C1"/>"""


@pytest.fixture
def theirs(tmp_path: Path) -> Town:
    """A scenario in a folder whose name needs quotes, with a type in an additional file and a trip that is lost."""
    sumocfg = write_unpaved(tmp_path / "it's theirs")
    for name, more, end in (("u.add.xml", _TYPES, "</additional>"), ("u.rou.xml", _LOST, "</routes>")):
        path = sumocfg.with_name(name)
        path.write_text(path.read_text(encoding="utf-8").replace(end, more + end), encoding="utf-8")
    return open_town(sumocfg)


def grid(folder: Path, count: int = 3, speed_mps: float = 13.8) -> Town:
    """A scenario without pavements or pedestrians."""
    words = ("--grid", "--grid.number", str(count), "--grid.length", "60")
    return open_town(made(folder, words, persons=False, speed_mps=speed_mps))


def asked(command: str) -> tuple[int, str]:
    """What `typed` gives of a `wcsim` command, asked in this process."""
    with redirect_stdout(StringIO()) as said, redirect_stderr(said):
        code = main(shlex.split(command)[1:])
    return code, said.getvalue()


def named(town: Town, old: str, new: str) -> Town:
    """The scenario with another file named in it, as the cure says."""
    text = town.sumocfg.read_text(encoding="utf-8")
    assert old in text
    town.sumocfg.write_text(text.replace(old, new), encoding="utf-8")
    return open_town(town.sumocfg)


def _without_calibrators(path: Path) -> None:
    tree = ElementTree.parse(path)  # noqa: S314 - our own
    root = tree.getroot()
    for element in root.findall("calibrator"):
        root.remove(element)
    tree.write(path)


def _with_an_island(net: Path) -> None:
    """Add a street that no other one leads to."""
    nodes = '<nodes><node id="p" x="900" y="900"/><node id="q" x="950" y="900"/></nodes>'
    edges = '<edges><edge id="alone" from="p" to="q"/></edges>'
    for name, text in (("i.nod.xml", nodes), ("i.edg.xml", edges)):
        net.with_name(name).write_text(text, encoding="utf-8")
    tool_output("netconvert", ["-s", net.name, "-n", "i.nod.xml", "-e", "i.edg.xml", "-o", net.name], net.parent)


def test_trips_without_a_way_are_dropped_by_what_is_printed(theirs: Town, tmp_path: Path) -> None:
    assert _unroutable_trips(theirs) == 2
    (fault,) = _faults_of(theirs, read_net(theirs.net), replace(FINE, unroutable=1))
    assert "move each <calibrator> of u.add.xml into a file of its own" in fault
    _without_calibrators(theirs.folder / "u.add.xml")
    (fault,) = _faults_of(theirs, read_net(theirs.net), replace(FINE, unroutable=1))
    code, said = typed(printed(fault, "to drop or repair them"), tmp_path)
    assert code == 0, said
    better = named(theirs, "u.rou.xml", "better.rou.xml")
    text = better.routes[0].read_text(encoding="utf-8")
    assert _unroutable_trips(better) == 0 and 'id="found"' in text and 'id="lost"' not in text
    assert 'id="below"' in text
    assert 'busStop="stop"' in text and 'departLane="0"' in text
    run_in_sumo(better.sumocfg, BEGIN_S + 60.0, tmp_path)


def test_a_demand_is_looked_at_from_its_own_begin(theirs: Town) -> None:
    named(theirs, '"50300"', '"0"')
    assert _unroutable_trips(open_town(theirs.sumocfg)) == 1  # below a later one; nobody departs in those ten minutes


def test_who_departs_before_the_begin_is_not_missed(theirs: Town) -> None:
    _with_an_island(theirs.net)
    for depart_s, missed in ((BEGIN_S, 1), (100.0, 0)):  # SUMO drops who departs before its begin
        trip = f'<trip id="late" depart="{depart_s}" from="A0B0" to="alone"/>'
        theirs.routes[0].write_text(f"<routes>{trip}</routes>", encoding="utf-8")
        assert _unroutable_trips(theirs) == missed


def test_trips_between_districts_find_them(theirs: Town, tmp_path: Path) -> None:
    trips = '<trip id="{}" depart="50400" fromTaz="district" toTaz="{}"/>'
    text = trips.format("there", "other") + trips.format("nowhere", "island")
    theirs.routes[0].write_text(f"<routes>{text}</routes>", encoding="utf-8")
    more = theirs.folder / "u.add.xml"
    districts = '<tazs><taz id="other" edges="C1B1"/></tazs><taz id="island" edges="alone"/></additional>'
    more.write_text(more.read_text(encoding="utf-8").replace("</additional>", districts), encoding="utf-8")
    _with_an_island(theirs.net)
    assert _unroutable_trips(theirs) == 1
    _without_calibrators(more)
    code, said = typed(Cures(theirs).routes().partition(": ")[2], tmp_path)
    assert code == 0, said
    text = (theirs.folder / "better.rou.xml").read_text(encoding="utf-8")
    assert 'id="there"' in text and 'id="nowhere"' not in text


def test_steep_streets_are_flattened_by_what_is_printed(theirs: Town, tmp_path: Path) -> None:
    hilly(theirs.net, theirs.folder / "steep.net.xml", lambda x, y: 0.4 * x)
    steep = named(theirs, "u.net.xml", "steep.net.xml")
    net = read_net(steep.net)
    assert steepest_grade(net) > STEEPEST
    (fault,) = _faults_of(steep, net, FINE)
    code, said = typed(printed(fault, "has a grade of"), tmp_path)
    assert code == 0, said
    better = named(steep, "steep.net.xml", "better.net.xml")
    assert steepest_grade(read_net(better.net)) <= STEEPEST


def test_parts_are_joined_in_the_netedit_that_is_printed(theirs: Town, tmp_path: Path) -> None:
    (fault,) = _faults_of(theirs, read_net(theirs.net), replace(FINE, walkable_largest_share=0.5))
    command = printed(fault, "join the parts")
    assert shlex.split(command)[1:] == ["-s", str(theirs.net)]
    code, said = typed(f"{command} --version", tmp_path)  # without it a window opens
    assert code == 0 and "netedit" in said


def test_a_larger_area_is_downloaded(tmp_path: Path) -> None:
    town = open_town(write_unpaved(tmp_path / "it's theirs"))
    words = "wcsim town import --name u --split test --osm osm/u.osm.xml.gz --out . --bbox=25.0,60.0,25.01,60.01"
    town = replace(town, file=town.file.model_copy(update={"rebuild": f"{words} --righthand --seed 7"}))
    (fault,) = _faults_of(town, read_net(town.net), replace(FINE, walkable_largest_share=0.5))
    place, _, command = printed(fault, "take a larger area from the internet").partition(" && ")
    options = parse_options(OsmImportOptions, shlex.split(command)[3:], "town import")
    west, south, east, north = (float(part) for part in options.bbox.split(","))
    assert west < 25.0 and south < 60.0 and east > 25.01 and north > 60.01
    assert shlex.split(place) == ["cd", str(town.folder)]
    assert (options.osm, options.seed, options.replace) == (None, 7, True)
    assert "this discards your changes" in fault


@pytest.mark.parametrize(
    "odd",
    ["--osm o --bbox=7.1,50.2,7.3", "--osm o --bbox=W,S,E,N", "--osm ../../o --bbox=7.1,50.2,7.3,50.4", "--osm o"],
)
def test_a_town_whose_command_says_anything_is_checked_all_the_same(theirs: Town, odd: str) -> None:
    (theirs.folder / "o").write_text("no map")
    town = replace(theirs, file=theirs.file.model_copy(update={"rebuild": f"wcsim town import {odd}"}))
    told = Cures(town).larger()
    assert told.startswith("join the parts: ") or ("from the internet" in told and "../o" not in told)


def test_walkers_come_in_the_scenarios_first_hour_at_most(theirs: Town) -> None:
    assert f"-b {BEGIN_S:g} -e {BEGIN_S + 600.0:g} " in Cures(theirs).walkers()
    assert "-b 50300 -e 53900 " in Cures(named(theirs, '"50900"', '"900000"')).walkers()
    with pytest.raises(TownError, match="is not a time"):
        Cures(named(theirs, '"900000"', '"${HOME}"')).walkers()


def test_a_scenario_of_fast_streets_is_told_how_fast_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    fast = grid(tmp_path / "fast", speed_mps=25.0)
    (fault,) = _faults_of(fast, read_net(fast.net), replace(FINE, walkingareas=0))
    command = printed(fault, "add pavements")
    assert (
        command == Cures(fast).pave().partition(": ")[2] and command.endswith(" --max-speed 25") and FASTEST_MPS < 25.0
    )
    code, said = asked(command)
    assert code == 0 and "24 streets got a pavement" in said and "note: the demand has no pedestrians" in said, said


def test_the_cure_of_a_check_and_of_a_paved_copy_is_one_that_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mixed = grid(tmp_path / "mixed", 2)
    root = ElementTree.parse(mixed.net)  # noqa: S314 - our own
    for lane in root.iterfind("./edge/lane"):
        if not lane.get("id", "").startswith(("A0A1", ":")):
            lane.set("speed", "22.5")
    root.write(mixed.net)
    (tmp_path / "mixed-paved").mkdir()
    (fault,) = _faults_of(mixed, read_net(mixed.net), replace(FINE, walkingareas=0))
    assert "--out mixed-paved-2 --max-speed 23" in fault
    assert asked(printed(fault, "add pavements"))[0] == 0
    code, said = asked(f"wcsim town pave {mixed.sumocfg} --out slow")
    lines = [line for line in said.splitlines() if "--max-speed 23" in line]
    assert code == 1 and len(lines) == 2 and lines[0].split(": ")[-1] == lines[1].split(": ")[-1]
    assert asked(printed(lines[1], "pave the fast streets too"))[0] == 0


def test_a_park_gets_walking_areas(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    park = grid(tmp_path / "park")
    text = park.net.read_text(encoding="utf-8").replace(' speed="', ' allow="pedestrian" speed="')
    park.net.write_text(text, encoding="utf-8")
    park.routes[0].write_text('<routes><person id="p" depart="0"><walk edges="A0A1"/></person></routes>')
    (fault,) = _faults_of(park, read_net(park.net), replace(FINE, walkingareas=0, crossings=0))
    code, said = asked(printed(fault, "no walking areas"))
    assert code == 0 and "walking areas" in said, said


def test_a_scenario_of_rails_is_told_that_there_is_no_street(tmp_path: Path) -> None:
    rails = grid(tmp_path / "rails")
    text = rails.net.read_text(encoding="utf-8").replace(' speed="', ' allow="tram" speed="')
    rails.net.write_text(text, encoding="utf-8")
    (fault,) = (fault for fault in _faults_of(rails, read_net(rails.net), replace(FINE, walkingareas=0)))
    assert "no street is open to cars" in fault and "town pave" not in fault
    code, said = asked(f"wcsim town pave {rails.sumocfg} --out {tmp_path / 'ours'}")
    assert code == 2 and "no street is open to cars" in said


def test_types_of_two_files_are_not_told_twice(theirs: Town) -> None:
    assert "remove the vehicle types" not in Cures(theirs).routes()
    path = theirs.routes[0]
    path.write_text(path.read_text(encoding="utf-8").replace("<routes>", '<routes><vType id="x"/>'), encoding="utf-8")
    wanted = "remove the vehicle types from u.add.xml, because better.rou.xml will contain them, create"
    assert wanted in Cures(theirs).routes()
