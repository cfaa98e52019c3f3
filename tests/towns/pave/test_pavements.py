import math
import re
import shlex
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import pytest
import sumolib

from tests.support.typed import printed
from tests.towns.conftest import run_in_sumo, tool_output
from tests.towns.made.unpaved import BEGIN_S, write_unpaved
from wcsim.cli.shared.common import parse_options
from wcsim.cli.town.import_ import TownPaveOptions
from wcsim.errors import TownError
from wcsim.towns.pave.elements import _padded, _SignalLinks, _VehicleLink
from wcsim.towns.pave.pavements import Paved, pave_town
from wcsim.towns.scenario.town import Town, open_town
from wcsim.towns.sumo.net import read_net

OWN_PROGRAM = 'type="actuated" programID="mine" offset="17"'
POSITIONS = ("pos", "startPos", "endPos")
CROSS = _SignalLinks(
    count=5,
    was={0: 0, 1: 1, 2: 2},
    drives=[
        _VehicleLink(link=0, start="west", end="east", straight=True),
        _VehicleLink(link=1, start="west", end="south", straight=False),
        _VehicleLink(link=2, start="north", end="south", straight=True),
    ],
    crossings={3: frozenset(("west",)), 4: frozenset(("south",))},
)


@pytest.fixture(scope="module", params=[False, True], ids=["right", "left"])
def paved(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Paved]:
    """The scenario before and after, traffic on either side."""
    folder = tmp_path_factory.mktemp("unpaved")
    before = write_unpaved(folder / "theirs", lefthand=request.param)
    return before.parent, folder / "ours", pave_town(open_town(before), folder / "ours")


def ours_of(theirs: Path) -> Paved:
    """The paved copy beside a scenario."""
    return pave_town(open_town(theirs), theirs.parents[1] / "ours")


def place_of(net: sumolib.net.Net, lane: str, text: str) -> tuple[float, float]:
    """Where a position lies, by SUMO's own library."""
    found = net.getLane(lane)
    pos_m = float(text) if float(text) >= 0.0 else float(text) + found.getLength()
    assert -1e-6 <= pos_m <= found.getLength() + 1e-6
    place: tuple[float, float] = sumolib.geomhelper.positionAtShapeOffset(found.getShape(), pos_m)
    return place


def elements(folder: Path, name: str) -> list[Element]:
    return list(ElementTree.parse(folder / name).getroot().iter())  # noqa: S314 - our own


def test_every_stop_and_detector_lies_where_it_lay(paved: tuple[Path, Path, Paved]) -> None:
    theirs, ours, told = paved
    nets = [sumolib.net.readNet(str(folder / "u.net.xml")) for folder in (theirs, ours)]
    compared, moved = 0, 0
    for name in ("u.add.xml", "u.rou.xml"):
        for old, new in zip(elements(theirs, name), elements(ours, name), strict=True):
            if "lane" not in old.attrib:
                continue
            assert nets[1].getLane(new.attrib["lane"]).allows("passenger")
            for key in (key for key in POSITIONS if key in old.attrib):
                far_m = math.dist(
                    place_of(nets[0], old.attrib["lane"], old.attrib[key]),
                    place_of(nets[1], new.attrib["lane"], new.attrib[key]),
                )
                compared += 1
                moved += far_m > 0.05
                assert far_m < 0.05 or any(old.get("id", "") in thing for thing, _ in told.moved_m)
    assert compared >= 15 and moved <= 2


def test_names_of_lanes_follow_wherever_they_stand(paved: tuple[Path, Path, Paved]) -> None:
    theirs, ours, told = paved
    assert told.streets == 24 and told.crossings >= 20 and told.placed == 12 and told.programs == 10
    things = {element.get("id"): element for element in elements(ours, "u.add.xml") if element.get("id")}
    assert things["long"].get("lanes") == "A1B1_2 B1C1_2" and things["sign"].get("lanes") == "A1B1_1 A1B1_2"
    assert "B1C1_1" in things and things["district"].get("edges") == "A1B1 B1C1"
    vehicles = {element.get("id"): element for element in elements(ours, "u.rou.xml")}
    bus = vehicles["bus"]
    assert (bus.get("departLane"), bus.get("departPos")) == ("1", "18")  # a junction has grown by 2 m
    assert (vehicles["named"].get("departLane"), vehicles["named"].get("arrivalLane")) == ("2", "2")
    assert vehicles["cars"].get("departLane") == "best"
    assert "<!-- kept as it is -->" in (ours / "u.add.xml").read_text()
    assert (ours / "u.sumocfg").read_bytes() == (theirs / "u.sumocfg").read_bytes()


def test_signal_programs_of_the_author_know_the_crossings(paved: tuple[Path, Path, Paved]) -> None:
    theirs, ours, _ = paved
    old, new = (
        [phase.attrib["state"] for phase in elements(folder, "signals/u.tll.xml") if phase.tag == "phase"]
        for folder in (theirs, ours)
    )
    net = read_net(ours / "u.net.xml")
    links = max(link.tls_link for link in net.connections if link.tls_id == "B1") + 1
    assert {len(state) for state in new} == {links} and links == len(old[0]) + 4
    assert [state[:16].lower() for state in new] == [state.lower() for state in old]
    walk = [state[16:] for state in new]
    assert sorted(walk[0]) == sorted(walk[2]) == ["G", "G", "r", "r"]
    assert walk[1] == walk[3] == "rrrr" and walk[0] != walk[2]


def test_signal_programs_in_the_net_stay_the_authors_too(theirs: Path, tmp_path: Path) -> None:
    net = theirs.with_name("u.net.xml")
    text = net.read_text().replace('type="static" programID="0" offset="0"', OWN_PROGRAM)
    net.write_text(text.replace('duration="42"', 'duration="30" name="drive"'))
    told = ours_of(theirs)
    places = (net.parent, tmp_path / "ours")
    old, new = ([item for item in elements(place, net.name) if item.tag == "tlLogic"] for place in places)
    assert len(old) == 9 and told.programs == len(old) + 1  # one lies in an additional file
    for was, now in zip(old, new, strict=True):
        assert now.attrib == was.attrib and now.get("programID") == "mine" and len(now) == len(was)
        for before, after in zip(was, now, strict=True):
            states = [phase.attrib.pop("state") for phase in (before, after)]
            assert after.attrib == before.attrib and len(states[1]) > len(states[0])
            assert states[1][: len(states[0])].lower() == states[0].lower()
    assert any("G" in phase[16:] for logic, phase in read_net(tmp_path / "ours" / net.name).phases if logic == "B1")
    run_in_sumo(told.sumocfg, BEGIN_S + 10.0, tmp_path)


def test_sumo_runs_it_without_an_error(paved: tuple[Path, Path, Paved], tmp_path: Path) -> None:
    _, _, told = paved
    options = ("--stop-output", str(tmp_path / "stops.xml"), "--tripinfo-output", str(tmp_path / "trips.xml"))
    run_in_sumo(told.sumocfg, BEGIN_S + 150.0, tmp_path, "--xml-validation", "never", *options)
    stops = [stop for stop in elements(tmp_path, "stops.xml") if stop.tag == "stopinfo"]
    assert [stop.get("busStop") for stop in stops] == ["stop", None] and stops[1].get("lane") == "B1C1_1"


def test_a_paved_net_is_not_paved_again(paved: tuple[Path, Path, Paved], tmp_path: Path) -> None:
    _, _, told = paved
    with pytest.raises(TownError, match=r"has pavements and crossings already.*netedit'? -s"):
        pave_town(open_town(told.sumocfg), tmp_path / "again")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    return write_unpaved(tmp_path / "theirs")


def test_a_net_without_lanes_within_junctions_gets_crossings_too(theirs: Path) -> None:
    tool_output("netconvert", ["-s", "u.net.xml", "--no-internal-links", "-o", "u.net.xml"], theirs.parent)
    told = ours_of(theirs)
    assert told.crossings > 0 and told.walkingareas > 0
    assert any("lanes inside junctions were added" in note for note in told.notes)


def test_a_net_of_any_number_of_paths_is_paved(theirs: Path) -> None:
    ways = range(800)  # their names are more than the 128 KiB that a word of a command line has room for
    nodes = "".join(f'<node id="p{i}" x="{900 + 20 * i}" y="900"/>' for i in (*ways, len(ways)))
    edges = "".join(f'<edge id="{"way" * 60}#{i}" from="p{i}" to="p{i + 1}" allow="bicycle"/>' for i in ways)
    for name, kind, text in (("i.nod.xml", "nodes", nodes), ("i.edg.xml", "edges", edges)):
        theirs.with_name(name).write_text(f"<{kind}>{text}</{kind}>")
    options = ["-s", "u.net.xml", "-n", "i.nod.xml", "-e", "i.edg.xml", "-o", "u.net.xml"]
    tool_output("netconvert", options, theirs.parent)
    told = ours_of(theirs)
    assert told.streets == 24


def test_a_lane_that_is_not_there_is_refused_by_name(theirs: Path) -> None:
    text = theirs.with_name("u.add.xml").read_text()
    theirs.with_name("u.add.xml").write_text(text.replace('lane="B0A0_0"', 'lane="B0A0_7"'))
    with pytest.raises(TownError, match=r"u\.add\.xml: parkingArea 'park': names lane 'B0A0_7'"):
        ours_of(theirs)


def test_a_town_keeps_what_sumo_has_no_word_for(theirs: Path, tmp_path: Path) -> None:
    toml = 'name = "mine"\nsplit = "test"\norigin_m = [5, 5]\n\n[hashes]\n"u.net.xml" = "0"\n'
    theirs.with_name("town.toml").write_text(toml)
    pave_town(open_town(theirs.parent), tmp_path / "ours")
    town: Town = open_town(tmp_path / "ours")
    assert (town.name, town.split, town.file.origin_m, town.file.hashes) == ("mine", "test", (5, 5), {})


def test_crossings_are_green_while_nobody_may_drive_over_them() -> None:
    states, seconds = ("GGr", "yyr", "rrr", "rrG", "rry"), (30.0, 3.0, 2.0, 30.0, 3.0)
    assert _padded(states, seconds, CROSS) == ("GgrrG", "yyrrr", "rrrGr", "rrGGr", "rryrr")
    only_straight = _padded(("Grr", "rrG"), (30.0, 30.0), CROSS)
    assert only_straight == ("GrrrG", "rrGGr")
    turning = _padded(("rGr", "rrr"), (30.0, 20.0), CROSS)
    assert turning == ("rgrrG", "rrrGG")
    assert _padded(("ooo",), (30.0,), CROSS) == ("ooooo",)


DISTRIBUTIONS = """<routes>
    <route id="r0" edges="A1B1 B1C1"/>
    <routeDistribution id="holds"><route edges="A1B1 B1C1"/><route edges="B2C2 C2C1"/></routeDistribution>
    <routeDistribution id="names" routes="r0 way" probabilities="1 3"/>
    <routeDistribution id="refers"><route refId="way" probability="1"/></routeDistribution>
    <flow id="f0" route="holds" begin="50300" end="50340" number="4" departLane="0"/>
    <flow id="f1" route="names" begin="50300" end="50340" number="4" departLane="1"/>
    <flow id="f2" route="refers" begin="50300" end="50340" number="4" departLane="0" arrivalLane="1"/>
    <vehicle id="f3" depart="50341" departLane="1"><routeDistribution routes="way r0"/></vehicle>
    <route id="longer" edges="A0B0 B0B1"/>
    <vehicle id="f4" depart="50342" route="longer" departEdge="1" departPos="106.1"/>
    <vehicle id="f5" depart="50342" departPos="106.1"><route edges="B0B1"/></vehicle>
    <vehicle id="f6" depart="50343" route="longer" departPos="106.1" arrivalEdge="random" arrivalPos="30"/>
    <trip id="f7" depart="50344" from="A0B0" to="B1C1" departEdge="1" departPos="106.1"/>
    <person id="p0" depart="50345" departPos="106.1"><stop lane="B0B1_0" duration="5"/></person>
    <person id="p1" depart="50345" departPos="106.1">
        <ride from="B0B1" to="B0B1" lines="ANY" arrivalPos="106.1"/><walk to="B0B1" arrivalPos="106.1"/>
    </person>
    <person id="p2" depart="triggered" departPos="106.1">
        <ride to="B0B1" lines="f5" arrivalPos="106.1"/>
    </person>
    <container id="p3" depart="50345" departPos="106.1">
        <tranship from="B0B1" to="B0B1" departPos="106.1" arrivalPos="106.1"/>
        <transport to="B0B1" lines="ANY" arrivalPos="106.1"/>
    </container>
</routes>"""


def test_who_drives_one_of_several_routes_departs_from_the_lane_that_was_meant(theirs: Path, tmp_path: Path) -> None:
    theirs.with_name("u.rou.xml").write_text(DISTRIBUTIONS)
    told = ours_of(theirs)
    found = {element.get("id"): element for element in elements(tmp_path / "ours", "u.rou.xml")}
    assert [found[f"f{k}"].get("departLane") for k in range(4)] == ["1", "2", "1", "2"]
    assert found["f2"].get("arrivalLane") == "2"
    at = {name: (found[name].get("departPos"), found[name].get("arrivalPos")) for name in ("f4", "f5", "f6")}
    assert at["f4"][0] == at["f5"][0] != at["f6"][0] and at["f6"][1] == "30", at
    assert found["f7"].get("departPos") == "106.1"  # where its second edge is, only routing says
    moved = at["f5"][0]
    assert [found[f"p{k}"].get("departPos") for k in range(4)] == [moved, moved, "106.1", moved]
    stages = [stage for k in range(4) for stage in found[f"p{k}"] if stage.tag != "stop"]
    places = {stage.get(key) for stage in stages for key in ("departPos", "arrivalPos")}
    assert len(stages) == 5 and places == {moved, None} and moved != "106.1"
    run_in_sumo(told.sumocfg, BEGIN_S + 50.0, tmp_path, "--xml-validation", "never")


def test_streets_that_are_too_fast_are_counted_and_paved_by_what_is_printed(theirs: Path, tmp_path: Path) -> None:
    net = theirs.parent / "u.net.xml"
    root = ElementTree.parse(net)  # noqa: S314 - our own
    for edge in ("A0A1", "A1A0", "B0B1"):
        for lane in root.iterfind(f"./edge[@id='{edge}']/lane"):
            lane.set("speed", "19.44" if edge == "B0B1" else "16.67")
    root.write(net)
    told = pave_town(open_town(theirs), tmp_path / "our copy")
    (note,) = [note for note in told.notes if "got no pavement" in note]
    assert told.streets == 21 and note.startswith("3 of 24 streets are faster than 13.9 m/s and got no pavement; ")
    options = parse_options(TownPaveOptions, shlex.split(printed(note, "got no pavement"))[3:], "town pave")
    assert options.out != told.sumocfg.parent and options.max_speed == 20.0
    again = pave_town(open_town(Path(options.town)), options.out, options.max_speed)
    assert again.streets == 24 and not [note for note in again.notes if "got no pavement" in note]
    with pytest.raises(
        TownError, match=r"none of its.*of up to 2 m/s; add pavements and crossings: wcsim town pave /.* --out .*/ours"
    ):
        pave_town(open_town(theirs), tmp_path / "ours", 2.0)
    assert not (tmp_path / "ours").exists()


def never_green(told: Paved) -> list[str]:
    return [note for note in told.notes if "never get green" in note]


def test_a_crossing_that_is_never_green_is_told(paved: tuple[Path, Path, Paved], theirs: Path) -> None:
    _, _, told = paved
    (note,) = never_green(told)  # B1 has room for walkers, in its additional file
    assert (
        "program in the net" in note
        and "NEMA" not in note
        and "at A1" in note
        and "at B1" not in note
        and "--tls.rebuild" in note
    )
    names = [logic.attrib["id"] for logic in elements(theirs.parent, "u.net.xml") if logic.tag == "tlLogic"]
    logics = "".join(
        f'<tlLogic id="{name}" type="static" programID="own" offset="0">'
        f'<phase duration="30" state="{("G" if name == "B1" else "r") * 16}"/></tlLogic>'
        for name in names
    )
    signals = theirs.parent / "signals" / "u.tll.xml"
    signals.write_text(f"<additional>{logics}</additional>")
    (note,) = never_green(ours_of(theirs))  # no program in the net is in force
    assert "program in an additional file" in note and re.findall(r"over \w+ at (\w+)", note) == ["B1"] * 4
    assert "add a phase there" in note and "--tls.rebuild" not in note


def test_no_ring_of_a_nema_controller_lets_walkers_go(tmp_path: Path) -> None:
    theirs = write_unpaved(tmp_path / "theirs", signals="NEMA")
    text = theirs.read_text().replace(",signals/u.tll.xml", "")
    theirs.write_text(text)
    told = ours_of(theirs)
    old, new = (
        {logic.get("id"): logic for logic in elements(place, "u.net.xml") if logic.get("type") == "NEMA"}
        for place in (theirs.parent, tmp_path / "ours")
    )
    assert old.keys() == new.keys() and "B1" in old
    for name, logic in old.items():
        for before, after in zip(logic.iter("phase"), new[name].iter("phase"), strict=True):
            was, now = before.attrib["state"], after.attrib["state"]
            assert now[: len(was)] == was and set(now[len(was) :]) == {"r"}
    (note,) = never_green(told)
    assert "NEMA" in note and "--tls.rebuild" in note
    assert "etector" not in run_in_sumo(told.sumocfg, BEGIN_S + 30.0, tmp_path)
