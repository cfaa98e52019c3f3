from pathlib import Path

import pytest

from tests.towns.conftest import WriteScenario, bytes_in
from tests.towns.made import hostile
from wcsim.errors import TownError
from wcsim.towns.checks.check import check_town
from wcsim.towns.importing.adopt import adopt_scenario
from wcsim.towns.scenario.town import Town, find_changes, find_town, net_middle, open_town, own_work


def test_a_scenario_becomes_a_town_of_its_own(write_theirs: WriteScenario, tmp_path: Path) -> None:
    sumocfg = write_theirs("<g value='look.xml'/>", '<include href="in/b.xml"/>')
    (tmp_path / "theirs" / "in").mkdir()
    (tmp_path / "theirs" / "in" / "b.xml").write_text("<additional><edgeData id='e' file='../e.xml'/></additional>")
    (tmp_path / "theirs" / "look.xml").write_text("<viewsettings/>")
    (tmp_path / "theirs" / "notes.txt").write_text("not named")
    (tmp_path / "theirs" / "README.md").write_text("ours")
    before = bytes_in(tmp_path / "theirs")
    town = adopt_scenario(sumocfg, "mine", tmp_path / "towns" / "mine", "test")
    assert bytes_in(tmp_path / "theirs") == before
    made = bytes_in(tmp_path / "towns" / "mine")
    ours = {"town.toml", "LICENSE-DATA"}
    assert set(made) - ours == set(before) - {"notes.txt"}
    assert all(made[name] == before[name] for name in set(made) - ours)
    assert b"README.md" in made["LICENSE-DATA"]
    assert (town.name, town.split, town.file.origin_m) == ("mine", "test", net_middle(town.net))
    assert set(town.file.hashes) == set(made) - ours - {"README.md"}
    assert find_town(str(tmp_path / "towns" / "mine")) == town
    assert find_town(town.address) == town
    assert [path.name for path in (tmp_path / "towns").iterdir()] == ["mine"]


def test_chairs_drive_on_cycle_paths_of_a_scenario_where_they_may(corner_town: Town, tmp_path: Path) -> None:
    usual, law = (
        adopt_scenario(corner_town.sumocfg, "mine", tmp_path / str(ways), cycle_paths=ways) for ways in (False, True)
    )
    assert law.file.chair_ways == (*usual.file.chair_ways, "cycleway")
    assert law.file == usual.file.model_copy(update={"chair_ways": law.file.chair_ways})


@pytest.mark.parametrize(
    "theirs, copied",
    [
        ("<gui-settings><delay value='20'/></gui-settings>",) * 2,
        ("<bank><account/></bank>", "<viewsettings/>\n"),
        ("secret", "<viewsettings/>\n"),
    ],
)
def test_settings_of_a_window_never_refuse_a_copy_and_are_no_way_for_private_files(
    write_theirs: WriteScenario, tmp_path: Path, theirs: str, copied: str
) -> None:
    sumocfg = write_theirs("<gui-settings-file value='look.xml'/>")
    (tmp_path / "theirs" / "look.xml").write_text(theirs)
    town = adopt_scenario(sumocfg, "mine", tmp_path / "mine")
    assert (town.folder / "look.xml").read_text() == copied
    assert find_changes(town.folder, town.file) == ()


def test_an_edit_of_an_adopted_scenario_is_noted_and_no_fault(write_theirs: WriteScenario, tmp_path: Path) -> None:
    town = adopt_scenario(write_theirs(), "mine", tmp_path / "mine")
    assert own_work(town.folder) and find_changes(town.folder, town.file) == ()
    for name in ("a.net.xml", "a.rou.xml"):
        path = town.folder / name
        text = path.read_text(encoding="utf-8").replace(' speed="', ' speed="1').replace("one", "two")
        path.write_text(text, encoding="utf-8")
    report = check_town(town)
    assert not [fault for fault in report.faults if "changed" in fault]
    changed = [note for note in report.notes if "changed since the import" in note]
    assert len(changed) == 2 and "a.rou.xml" in changed[0] and "duarouter" in changed[1] and str(town.net) in changed[1]


def test_files_beside_the_scenarios_folder_keep_their_structure(corner_town: Town, tmp_path: Path) -> None:
    hostile.scenario(corner_town, tmp_path / "all" / "common")
    folder = tmp_path / "all" / "runs" / "a"
    folder.mkdir(parents=True)
    (folder / "run.sumocfg").write_text(
        "<c><n value='../../common/a.net.xml'/><r value='../../common/a.rou.xml'/></c>", encoding="utf-8"
    )
    with pytest.raises(TownError, match=r"run\.sumocfg: names .*a\.net\.xml, which is outside .*--allow-outside"):
        adopt_scenario(folder / "run.sumocfg", "mine", tmp_path / "mine")
    assert not (tmp_path / "mine").exists()
    town = adopt_scenario(folder / "run.sumocfg", "mine", tmp_path / "mine", outside=True)
    assert town.sumocfg == tmp_path / "mine" / "runs" / "a" / "run.sumocfg"
    assert town.net.resolve() == tmp_path / "mine" / "common" / "a.net.xml"
    assert find_town(town.address) == town


def test_a_copy_may_go_beside_the_folder_one_is_in(
    write_theirs: WriteScenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_theirs()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    adopt_scenario(Path("../theirs/a.sumocfg"), "mine", Path("../mine"))
    assert find_town(str(tmp_path / "mine")).name == "mine"


def test_names_in_any_letters_are_noted(write_theirs: WriteScenario, tmp_path: Path) -> None:
    sumocfg = write_theirs()
    name = "\u00fc \U0001f600.rou.xml"
    (tmp_path / "theirs" / "a.rou.xml").rename(tmp_path / "theirs" / name)
    sumocfg.write_text(sumocfg.read_text(encoding="utf-8").replace("a.rou.xml", name), encoding="utf-8")
    town = adopt_scenario(sumocfg, "mine", tmp_path / "mine", source="\U0001f600 \x7f")
    assert name in town.file.hashes and town.file.source == "\U0001f600 \x7f"
    assert find_changes(town.folder, town.file) == ()


@pytest.mark.parametrize("fault", ["absolute", "missing", "in the way", "name", "no such file"])
def test_what_cannot_be_adopted_is_said_and_leaves_nothing(
    write_theirs: WriteScenario, tmp_path: Path, fault: str
) -> None:
    sumocfg, out, name = write_theirs(), tmp_path / "mine", "mine"
    if fault == "absolute":
        sumocfg.write_text(sumocfg.read_text().replace("a.rou.xml", str(tmp_path / "theirs" / "a.rou.xml")))
    if fault == "missing":
        (tmp_path / "theirs" / "a.rou.xml").unlink()
    if fault == "in the way":
        out.mkdir()
        (out / "thing").touch()
    if fault == "name":
        name = "my town!"
    if fault == "no such file":
        sumocfg = tmp_path / "none.sumocfg"
    says = {
        "absolute": "by a path that a copy cannot follow",
        "missing": "names a file that does not exist",
        "in the way": "already exists",
        "name": "expected letters, digits",
        "no such file": "there is no such file",
    }
    with pytest.raises(TownError, match=says[fault]):
        adopt_scenario(sumocfg, name, out)
    assert {path.name for path in tmp_path.iterdir()} <= {"theirs", "cache"} | ({"mine"} if out.exists() else set())
    assert not (out / "town.toml").exists()


def test_a_bare_sumocfg_gets_a_name_and_the_middle_of_its_net(corner_town: Town, tmp_path: Path) -> None:
    sumocfg = hostile.scenario(corner_town, tmp_path / "Their Town (v2)")
    town = open_town(sumocfg)
    assert (town.name, town.split) == ("Their-Town-v2", "train")
    assert town.file.origin_m == net_middle(corner_town.net)
    sumocfg.with_name("night.sumocfg").write_bytes(sumocfg.read_bytes())
    assert open_town(sumocfg).name == "Their-Town-v2-a"
    assert find_town(open_town(sumocfg).address).sumocfg == sumocfg
    with pytest.raises(TownError, match=r"expected one \.sumocfg"):
        open_town(sumocfg.parent)


def test_the_middle_of_a_net_is_that_of_its_boundary_or_of_its_junctions(tmp_path: Path) -> None:
    net = tmp_path / "a.net.xml"
    net.write_text('<net><location convBoundary="100.0,200.0,300.4,500.0"/></net>', encoding="utf-8")
    assert net_middle(net) == (200, 350)
    net.write_text('<net><junction id="a" x="10" y="20"/><junction id="b" x="30" y="60"/></net>', encoding="utf-8")
    assert net_middle(net) == (20, 40)
    net.write_text('<net><location convBoundary="broken"/></net>', encoding="utf-8")
    assert net_middle(net) == (0, 0)
