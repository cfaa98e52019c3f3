"""A check ends with SUMO itself, which opens the whole scenario."""

import shlex
from pathlib import Path

import pytest

from tests.cli.conftest import Run, files_in, parsed
from tests.support.menagerie import HITTING, build_street
from tests.support.typed import printed
from tests.towns.made import hostile
from wcsim.cli.shared.common import parse_options
from wcsim.cli.town import town_check
from wcsim.cli.town.run import TownRunOptions
from wcsim.towns.scenario.town import open_town
from wcsim.towns.sumo.tools import Limits, ToolRun

LOOP = '<inductionLoop id="loop" lane="nowhere_0" pos="5" period="5" file="loop.xml"/>'


pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.mark.parametrize(
    ("options", "more", "culprit", "text"),
    [
        ("", LOOP, "a.add.xml", "nowhere"),
        ("<default.carfollowmodel value='fly'/>", "", "a.sumocfg", "'fly'"),
    ],
)
def test_what_only_sumo_refuses_is_a_fault_in_its_words(
    wcsim: Run, folder: Path, corner_town, options, more, culprit, text
):
    sound = hostile.scenario(corner_town, folder / "sound")
    broken = hostile.scenario(corner_town, folder / "broken", options, more)
    before, faults = files_in(folder), []
    for town in (sound, broken):
        result = wcsim("town", "check", town, "--json", "check.json")
        faults.append(parsed("check.json")["faults"])
    assert (result.code, len(faults[1])) == (1, len(faults[0]) + 1)
    (fault,) = [fault for fault in faults[1] if "SUMO cannot run" in fault]
    assert fault in result.out and f"/{culprit}: SUMO cannot run this scenario" in fault
    assert "Error: " in fault and text in fault and fault.endswith(f"sumo -c {broken.resolve()}")
    assert files_in(folder) == before | {"check.json"}


def test_collisions_of_the_traffic_are_told_with_a_command(corner_town, folder: Path, monkeypatch) -> None:
    hits = [("a", "b", ":j_0_0"), ("b", "a", ":j_0_0"), ("p", "q", "e_0")]

    def sumo(name: str, words: list[str], folder: Path, limits: Limits) -> ToolRun:
        rows = "".join(f'<collision collider="{one}" victim="{other}" lane="{on}"/>' for one, other, on in hits)
        Path(words[words.index("--collision-output") + 1]).write_text(f"<collisions>{rows}</collisions>")
        return ToolRun(name=name, returncode=0, output="")

    monkeypatch.setattr(town_check, "run_tool", sumo)
    (note,) = town_check._traffic_notes(corner_town)
    assert "reports 2 collisions in the first 300 s of this traffic: b with a on :j_0_0, p with q on e_0;" in note
    parse_options(TownRunOptions, shlex.split(printed(note, "about half as often"))[3:], "town run")
    hits.clear()
    assert list(town_check._traffic_notes(corner_town)) == []


def test_collisions_are_those_that_plain_sumo_reports(folder: Path, monkeypatch) -> None:
    monkeypatch.setattr(town_check, "COLLIDING_S", 30.0)
    *_, note = town_check._traffic_notes(open_town(build_street(folder, HITTING, lanes=1)))
    assert "reports 1 collision in the first 30 s" in note and "behind with ahead on " in note


def test_warnings_are_told_with_a_command_that_writes_them(wcsim: Run, folder: Path) -> None:
    phases = '<phase duration="9" state="GgrrgGG"/><phase duration="9" state="rrGGrrr"/>'
    light = f'<tlLogic id="C" type="static" programID="own" offset="0">{phases}</tlLogic>'
    town = build_street(folder / "street", HITTING, light, "traffic_light", lanes=1)
    note = next(line for line in wcsim("town", "check", town).out.splitlines() if "SUMO warns 5 times in " in line)
    assert "the first 30 s of this traffic: Missing yellow phase in tlLogic 'C'" in note and "performs emer" in note
    words = (*shlex.split(printed(note, "into a file"))[1:], "--seconds", 9, "--out")
    assert "warnings of SUMO: 5, in run/sumo; the first of each kind:\nMissing yellow " in wcsim(*words, "run").out
    assert Path("run/sumo/sumo-warnings.log").read_text().count("Warning: ") == 5
    assert f"wcsim town check {town}\n" in wcsim(*words, "empty", "--set", "world.demand_scale=0").out


def test_an_import_says_it_too(wcsim: Run, folder: Path, corner_town) -> None:
    broken = hostile.scenario(corner_town, folder / "broken", "", LOOP)
    result = wcsim("town", "import", "--sumocfg", broken, "--name", "mine")
    assert result.code == 1 and "testing the first steps in SUMO" in result.err
    assert "a.add.xml: SUMO cannot run this scenario" in result.out and "nowhere" in result.out
