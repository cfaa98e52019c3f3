"""`wcsim town import --opendrive`: the map's own pavements, and what is lost of it."""

import json
import shlex
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.towns.conftest import tool_output
from wcsim.towns.scenario.town import find_town, own_work
from wcsim.towns.sumo.net import LaneKind, read_net

pytestmark = pytest.mark.usefixtures("own_cache")

_MAP = """<?xml version="1.0"?>
<OpenDRIVE xmlns="http://code.asam.net/simulation/standard/opendrive_schema">
<header revMajor="1" revMinor="7" vendor="somebody"/>
<road id="1" length="120" junction="-1">
<planView><geometry s="0" x="0" y="0" hdg="0" length="120"><line/></geometry></planView>
<elevationProfile><elevation s="0" a="5" b="0.03" c="0" d="0"/></elevationProfile>
<lateralProfile><superelevation s="0" a="0.02" b="0" c="0" d="0"/></lateralProfile>
<lanes>
<laneSection s="0">
<left>
<lane id="1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
<lane id="2" type="biking"><width sOffset="0" a="1.5" b="0" c="0" d="0"/></lane>
<lane id="3" type="border"><width sOffset="0" a="0.3" b="0" c="0" d="0"/></lane>
<lane id="4" type="sidewalk"><width sOffset="0" a="2.4" b="0" c="0" d="0"/></lane></left>
<center>
<lane id="0" type="none"/></center>
<right>
<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
<lane id="-2" type="biking"><width sOffset="0" a="1.5" b="0" c="0" d="0"/></lane>
<lane id="-3" type="border"><width sOffset="0" a="0.3" b="0" c="0" d="0"/></lane>
<lane id="-4" type="sidewalk"><width sOffset="0" a="2.4" b="0" c="0" d="0"/></lane></right></laneSection></lanes>
<objects><object id="7" type="building" s="5" t="20"/></objects>
<signals><signal id="8" type="274" s="9" t="-5" orientation="+" dynamic="no"/></signals>
</road></OpenDRIVE>
"""
"""A street of 120 m that climbs by 3 %, with a house, a sign and a slope across."""


def test_a_map_is_imported_with_its_own_pavements_and_told_what_is_lost(wcsim: Run, folder: Path) -> None:
    Path("m.xodr").write_text(_MAP)
    made = wcsim("town", "import", "--opendrive", "m.xodr", "--name", "m", "--traffic", "0", "--json", "m.json")
    assert made.code == 1, "a single street has two sides"
    written = json.loads(Path("m.json").read_text())
    (lost,) = [note for note in written["notes"] if note.startswith("left out of the map")]
    told = "objects (1), signs and signals (1), slopes across (1), border lanes (2); traffic lights, with netconvert's"
    assert told in lost and "guessed" not in lost
    (fault,) = written["faults"]
    assert "of the walkable area is connected" in fault and "join the parts: " in fault
    town = find_town("m")
    net = read_net(town.net)
    assert [lane.width_m for lane in net.lanes(LaneKind.SIDEWALK)] == [2.4, 2.4] and net.lanes(LaneKind.BIKE)
    heights_m = [lane.z_m for lane in net.lanes(LaneKind.SIDEWALK)]
    assert all(abs(z_m[-1] - z_m[0]) > 3.0 for z_m in heights_m)
    assert (
        own_work(town.folder) == () and "ask its author for the licence" in (town.folder / "LICENSE-DATA").read_text()
    )


def test_an_exported_town_comes_back_and_is_made_again_by_its_own_command(
    wcsim: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = ["--grid", "--grid.number", "3", "--grid.length", "80", "--sidewalks.guess", "--crossings.guess"]
    tool_output("netgenerate", [*grid, "--walkingareas", "-j", "traffic_light", "-o", "g.net.xml"], folder)
    tool_output("netconvert", ["-s", "g.net.xml", "--opendrive-output", "g.xodr"], folder)
    made = wcsim("town", "import", "--opendrive", "g.xodr", "--name", "g", "--traffic", "0.2")
    assert made.code == 0 and "traffic lights, with netconvert's programs: 9" in made.out, made.out
    town = find_town("g")
    assert len(read_net(town.net).lanes(LaneKind.CROSSING)) == 20
    before = {path: path.read_bytes() for path in sorted(town.folder.rglob("*.*"))}
    monkeypatch.chdir(town.folder)
    assert wcsim(*shlex.split(town.file.rebuild)[1:]).code == 0
    assert {path: path.read_bytes() for path in sorted(town.folder.rglob("*.*"))} == before


@pytest.mark.parametrize(
    ("text", "told"),
    [("", "no such file"), ("<osm/>", "expected <OpenDRIVE>"), ("<OpenDRIVE/>", "no net could be built"), ("x", "XML")],
)
def test_what_is_no_map_is_refused(wcsim: Run, folder: Path, text: str, told: str) -> None:
    if text:
        Path("m.xodr").write_text(text)
    refused = wcsim("town", "import", "--opendrive", "m.xodr", "--name", "m")
    assert refused.code == 2 and told in refused.err.replace("No such", "no such") and "m.xodr" in refused.err
    assert not Path("scenarios").exists()


@pytest.mark.parametrize("command", ["import", "import --sumocfg x", "import --opendrive x", "make", "check", "pave"])
def test_each_command_says_how_it_ends(wcsim: Run, command: str) -> None:
    rule = "Ends with 0 when the town has no faults (notes are none), 1 when it has, 2 when none was"
    assert rule in " ".join(wcsim("town", *command.split(), "-h").out.split())
