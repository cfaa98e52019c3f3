"""What a scenario names outside of its folder, and what SUMO writes without being asked."""

import os
import shlex
import zlib
from pathlib import Path

import pytest

from tests.support.worlds import quick_config
from tests.towns.conftest import WriteScenario
from tests.towns.made import hostile
from tests.towns.scenario.test_stage import SETTINGS, staged_in
from wcsim.bridge.world import World
from wcsim.cli.main import main
from wcsim.errors import TownError
from wcsim.towns.importing.adopt import adopt_scenario
from wcsim.towns.scenario.stage import stage_scenario
from wcsim.towns.scenario.town import Town, find_town, open_town
from wcsim.types.episode import RunPlace

EVIL = '<routes><vType id="t"><param key="device.ssm.file" value="/anywhere/x"/></vType></routes>'
HIDDEN = {
    "EBCDIC": ('<?xml version="1.0" encoding="ebcdic-cp-us"?>' + EVIL).encode("cp037"),
    "zlib": zlib.compress(EVIL.encode()),
    "XML 1.1": b'<?xml version="1.1"?>' + EVIL.replace(" value", "\u0085value").encode(),
    "another mark": EVIL.encode("utf-16"),
}


@pytest.mark.parametrize("name", HIDDEN)
@pytest.mark.parametrize("option", ["routes", "a", "weight-files", "load-state", "device.fcd-replay.files"])
def test_no_file_that_hides_its_names_gets_to_sumo(
    write_theirs: WriteScenario, tmp_path: Path, name: str, option: str
) -> None:
    sumocfg = write_theirs()
    (tmp_path / "theirs" / "evil.xml").write_bytes(HIDDEN[name])
    text = sumocfg.read_text(encoding="utf-8")
    more = {"routes": "a.rou.xml", "a": "a.add.xml"}
    if option in more:
        text = text.replace(more[option], f"{more[option]},evil.xml")
    else:
        text = text.replace("</configuration>", f"<{option} value='evil.xml'/></configuration>")
    sumocfg.write_text(text, encoding="utf-8")
    with pytest.raises(TownError, match=r"evil\.xml"):
        staged_in(tmp_path, sumocfg)


UNASKED = """
    <device.ssm.probability value="1"/> <device.toc.probability value="0"/> <device.btreceiver.probability value="1"/>
    <device.emissions.probability value="1"/> <device.battery.probability value="1"/>
    <device.bluelight.probability value="1"/> <device.fcd.probability value="1"/>
    <device.tripinfo.probability value="1"/> <device.vehroute.probability value="1"/>
    <device.rerouting.probability value="1"/> <device.driverstate.probability value="1"/>
    <device.elechybrid.probability value="1"/> <device.glosa.probability value="1"/>
    <device.friction.probability value="1"/> <device.stationfinder.probability value="0"/>
    <person-device.fcd.probability value="1"/> <person-device.rerouting.probability value="1"/>
    <save-state.times value="1,2"/> <elechybrid-output value="elec.xml"/> <elechybrid-output.aggregated value="false"/>
"""


@pytest.mark.parametrize("names", [("one", "two", "three"), ("one", "a/b", "stdout")])
def test_with_every_device_on_the_current_folder_stays_empty(
    write_theirs: WriteScenario, lane: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...]
) -> None:
    edge = lane.rpartition("_")[0]
    lane = f"{edge}_1"
    more = f"""<edgeData id="e" file="NULL" period="1"/><laneData id="l" file="null" period="1"/>
        <e1Detector id="d" lane="{lane}" pos="5" period="1" file="NULL"/>
        <calibrator id="c" edge="{edge}" pos="0"><flow begin="0" end="9" vehsPerHour="1000" speed="8"/></calibrator>
        <vType id="x"><param key="has.ssm.device" value="true"/><param key="has.toc.device" value="true"/>
            <param key="device.toc.manualType" value="m"/><param key="device.toc.automatedType" value="x"/></vType>
        <vType id="m"/>"""
    cars = "".join(
        f'<vehicle id="{name}" type="x" depart="0" departPos="{10 * k}"><route edges="{edge}"/>'
        '<param key="has.ssm.device" value="true"/></vehicle>'
        for k, name in enumerate(names)
    )
    town = open_town(write_theirs(UNASKED, more, cars))
    theirs = sorted((tmp_path / "theirs").iterdir())
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    with World(town, quick_config("world.warmup_s=0"), (), 1, RunPlace(folder=tmp_path / "run")) as world:
        for _ in range(60):
            world.tick(())
    assert not list((tmp_path / "empty").iterdir())
    assert sorted((tmp_path / "theirs").iterdir()) == theirs
    made = {path.name for path in (tmp_path / "run" / "sumo").iterdir()}
    assert {"ssm.xml", "state_1.00.xml.gz", "state_2.00.xml.gz", "elec.xml", "NULL", "null-2"} <= made, made


@pytest.mark.parametrize("place", ["route", "include", "link", "gui", "weights", "list", "parent", "picture"])
def test_nothing_of_the_user_is_taken_along(write_theirs: WriteScenario, tmp_path: Path, place: str) -> None:
    private = tmp_path / "private"
    private.mkdir()
    for name in ("key.txt", "key.xml"):
        (private / name).write_text("<routes><!-- secret --></routes>" if name.endswith("xml") else "secret")
    theirs = tmp_path / "theirs"
    options = {
        "gui": "<gui-settings-file value='../private/key.xml'/>",
        "weights": f"<weight-files value='{private}/key.xml'/>",
        "list": "<fcd-output.filter-edges.input-file value='../private/key.txt'/>",
    }
    more = {
        "include": '<include href="../private/key.xml"/>',
        "picture": '<poi id="p" x="1" y="1" imgFile="../private/key.txt"/>',
    }
    sumocfg = write_theirs(options.get(place, ""), more.get(place, ""))
    if place == "route":
        sumocfg.write_text(sumocfg.read_text().replace("a.rou.xml", "a.rou.xml,../private/key.txt"))
    if place == "parent":
        sumocfg.write_text(sumocfg.read_text().replace("a.rou.xml", "../private/key.xml"))
    if place == "link":
        (theirs / "a.rou.xml").unlink()
        (theirs / "a.rou.xml").symlink_to(private / "key.xml")
    (theirs / "README.md").symlink_to(private / "key.txt")
    try:
        town = adopt_scenario(sumocfg, "stolen", tmp_path / "stolen")
    except TownError as error:
        assert "which is outside of its folder" in str(error) and "--allow-outside" in str(error)
        assert not (tmp_path / "stolen").exists()
    else:
        assert place == "picture"
        assert "key.txt" not in {path.name for path in town.folder.rglob("*")}
        assert not (town.folder / "README.md").exists()
    if place not in ("gui", "picture"):
        with pytest.raises(TownError, match="outside of its folder"):
            staged_in(tmp_path, sumocfg)
    if place in ("include", "link", "parent"):
        stage_scenario(open_town(sumocfg, outside=True), SETTINGS, tmp_path / "run2")


def test_a_flag_trusts_a_scenario_and_an_import_that_fails_leaves_nothing(
    write_theirs: WriteScenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    sumocfg = write_theirs()
    (tmp_path / "parts").mkdir()
    (tmp_path / "theirs" / "a.rou.xml").rename(tmp_path / "parts" / "b.rou.xml")
    sumocfg.write_text(sumocfg.read_text().replace("a.rou.xml", "../parts/b.rou.xml"))
    words = ["town", "import", "--name", "mine", "--sumocfg", str(sumocfg), "--out", "made"]
    run = ["town", "run", str(sumocfg), "--seconds", "1", "--chairs", "0", "--out", "run"]
    for command in (words, run):
        assert main(command) == 2
        assert "b.rou.xml, which is outside of" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "made").exists() and not (tmp_path / "run").exists()
    assert main([*run, "--allow-outside"]) == 0
    assert main([*words, "--allow-outside"]) == 0
    told = capsys.readouterr().out
    assert "check made before you share it" in told and "note: the demand has no pedestrians" in told
    assert (tmp_path / "made" / "parts" / "b.rou.xml").is_file()
    assert find_town("made").border == Path("made")
    (tmp_path / "parts" / "b.rou.xml").write_text('<routes><vType id="t" accel="much"/></routes>', encoding="utf-8")
    words[-1] = "other"
    assert main([*words, "--allow-outside"]) == 2
    told = capsys.readouterr()
    assert "demand cannot be checked" in told.err and "wrote" not in told.out
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("name, text", [("notes.xml", "<html>x</html>"), ("notes.txt", "root:x:0"), ("e.txt", "a\nb")])
def test_what_is_none_of_sumos_files_does_not_go_with_a_copy(
    write_theirs: WriteScenario, tmp_path: Path, name: str, text: str
) -> None:
    option = "fcd-output.filter-edges.input-file" if name == "e.txt" else "weight-files"
    sumocfg = write_theirs(f"<{option} value='{name}'/>")
    (tmp_path / "theirs" / name).write_text(text, encoding="utf-8")
    with pytest.raises(TownError, match=rf"{name}.*(well-formed|which is no SUMO file|not a list of edges)"):
        adopt_scenario(sumocfg, "mine", tmp_path / "mine")
    assert not (tmp_path / "mine").exists()


def test_the_scenario_that_town_toml_names_lies_in_the_towns_folder(corner_town: Town, tmp_path: Path) -> None:
    hostile.scenario(corner_town, tmp_path / "evil")
    mine = tmp_path / "mine"
    mine.mkdir()
    for place in ("../evil/a.sumocfg", str(tmp_path / "evil" / "a.sumocfg"), "link/a.sumocfg"):
        (mine / "town.toml").write_text(f'name = "mine"\nsplit = "train"\nsumocfg = "{place}"\n', encoding="utf-8")
        if place.startswith("link"):
            (mine / "link").symlink_to(tmp_path / "evil")
        with pytest.raises(TownError, match=r"town\.toml: names .*which is outside"):
            find_town(str(mine))


def test_a_file_that_is_none_cannot_hold_a_scenario_up(write_theirs: WriteScenario, tmp_path: Path) -> None:
    sumocfg = write_theirs()
    (tmp_path / "theirs" / "a.rou.xml").unlink()
    os.mkfifo(tmp_path / "theirs" / "a.rou.xml")
    with pytest.raises(TownError, match=r"a\.rou\.xml"):
        open_town(sumocfg)


@pytest.mark.parametrize(
    "net", ['projParameter="+proj=utm +zone=32 +nadgrids=/etc/hostname"', 'projParameter="+init=/etc/passwd:x"']
)
def test_a_projection_names_no_file(write_theirs: WriteScenario, tmp_path: Path, net: str) -> None:
    sumocfg = write_theirs()
    path = tmp_path / "theirs" / "a.net.xml"
    text = path.read_text(encoding="utf-8")
    assert 'projParameter="!"' in text
    path.write_text(text.replace('projParameter="!"', net), encoding="utf-8")
    with pytest.raises(TownError, match=r"a\.net\.xml: has projParameter"):
        staged_in(tmp_path, sumocfg)


def test_a_scenario_with_files_elsewhere_is_told_the_command_that_copies_them(
    corner_town: Town, tmp_path: Path
) -> None:
    sumocfg = hostile.scenario(corner_town, tmp_path / "my town")
    (sumocfg.parent / "a.rou.xml").rename(tmp_path / "shared.rou.xml")
    sumocfg.write_text(sumocfg.read_text().replace("a.rou.xml", "../shared.rou.xml"))
    with pytest.raises(TownError, match="a copy for all commands: ") as caught:
        open_town(sumocfg)
    words = shlex.split(str(caught.value).partition("for all commands: ")[2])
    assert words == [
        *("wcsim", "town", "import", "--sumocfg", str(sumocfg)), *("--name", "my_town", "--allow-outside")
    ]  # fmt: skip
    town = adopt_scenario(sumocfg, "my_town", tmp_path / "copy", outside=True)
    assert town.routes[0].is_relative_to(tmp_path / "copy")
