import gzip
from pathlib import Path

import pytest

from tests.towns.conftest import WriteScenario, bytes_in
from tests.towns.made import hostile
from wcsim.config import WorldConfig
from wcsim.errors import ConfigError, TownError
from wcsim.towns.scenario import files
from wcsim.towns.scenario.options import Treatment, sumo_options
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scenario.stage import Scenario, stage_scenario
from wcsim.towns.scenario.town import Town, open_town
from wcsim.towns.sumo.tools import run_tool
from wcsim.towns.sumo.xml_io import read_root

SETTINGS = Settings(seed=5)
UNUSUAL = ("pedestrian.jupedsim.wkt", "pedestrian.jupedsim.py")  # need another model of pedestrians


def staged_in(tmp_path: Path, sumocfg: Path) -> Scenario:
    return stage_scenario(open_town(sumocfg), SETTINGS, tmp_path / "run")


def made_in(tmp_path: Path) -> set[str]:
    return {path.name for path in (tmp_path / "run").iterdir()}


def run_staged(sumocfg: Path, seconds: float = 12.0) -> None:
    run = run_tool("sumo", ["-c", str(sumocfg), "--end", str(seconds)], sumocfg.parent)
    assert run.returncode == 0, run.output[-1500:]


def assert_nothing_escapes(sumocfg: Path, escape: Path, tmp_path: Path) -> Scenario:
    before = bytes_in(tmp_path / "theirs")
    staged = staged_in(tmp_path, sumocfg)
    run_staged(staged.sumocfg)
    assert not list(escape.rglob("*"))
    assert bytes_in(tmp_path / "theirs") == before
    return staged


def test_no_option_of_sumo_can_write_outside_the_folder(write_theirs: WriteScenario, tmp_path: Path) -> None:
    escape = tmp_path / "escape"
    escape.mkdir()
    writers = [
        item.name
        for name, item in sumo_options().items()
        if name == item.name and item.treatment is Treatment.OUTPUT and name not in UNUSUAL
    ]
    assert len(writers) >= 40
    names = {name: f"../escape/deep/{k}.xml" if k % 2 else f"{escape}/{name}.xml" for k, name in enumerate(writers)}
    options = "".join(f'<{name} value="{value}"/>' for name, value in names.items())
    options += f'<save-state.times value="5"/><output-prefix value="{escape}/TIME_"/><remote-port value="9999"/>'
    options += f'<C value="{escape}/saved.xml"/><device.ssm.probability value="1"/><summary-output.period value="5"/>'
    sumocfg = write_theirs(options)
    staged = assert_nothing_escapes(sumocfg, escape, tmp_path)
    made = bytes_in(tmp_path / "run")
    assert {"stop-output.xml", "a.sumocfg", Path(staged.warnings).name} <= set(made) - {"sumo-warnings.log"}
    assert len(made) > 30
    kept = {row.option: row for row in staged.overrides}
    assert kept["remote-port"].wcsim == kept["output-prefix"].wcsim == "(left out)"


def test_no_element_can_write_outside_the_folder(write_theirs: WriteScenario, lane: str, tmp_path: Path) -> None:
    escape = tmp_path / "escape"
    escape.mkdir()
    edge = lane.rpartition("_")[0]
    cars = (
        f'<vehicle id="one" type="watched" depart="0"><route edges="{edge}"/>'
        f'<param key="device.ssm.file" value="{escape}/own&#46;xml"/></vehicle>'
    )
    sumocfg = write_theirs("", '<include href="more.xml"/>', cars)
    more = f"<additional>{hostile.hostile_additional(lane, '../escape')}</additional>"
    (tmp_path / "theirs" / "more.xml").write_text(more, encoding="utf-8")
    assert_nothing_escapes(sumocfg, escape, tmp_path)
    made = made_in(tmp_path)
    wanted = {"e1.xml", "instant.xml", "e2.xml", "e3.xml", "edges.xml", "lanes.xml", "probe.xml", "routes.xml"}
    assert wanted | {"calibrator.xml", "own.xml"} <= made
    copy = (tmp_path / "run" / "inputs" / "more.xml").read_text()
    assert 'maxAccelProfile="0 2 10 1"' in copy  # a profile is no file


def test_a_socket_and_the_console_become_files(write_theirs: WriteScenario, tmp_path: Path) -> None:
    options = '<summary value="localhost:9999"/><tripinfo value="stdout"/><fcd-output value="/dev/null"/>'
    options += '<error-log value="NUL"/>'
    staged = staged_in(tmp_path, write_theirs(options))
    run_staged(staged.sumocfg, 2.0)
    names = made_in(tmp_path)
    assert names == {"a.sumocfg", "localhost_9999", "tripinfo-output.xml", "sumo-warnings.log"}


@pytest.mark.parametrize(
    "options",
    [
        '<tripinfo-output value="t.parquet"/>',
        '<personroute-output value="sub/r.parquet"/>',
        '<full-output value="f.csv"/><output.format value="parquet"/>',
        '<log value="l.txt"/><output.format value="parquet"/>',
        '<fcd-output value="f.parquet"/><fcd-output.attributes value="x, vehicle,signals"/>',
        '<fcd-output value="f.parquet"/><fcd-output.max-leader-distance value="9"/>',
    ],
)
def test_what_sumo_cannot_write_as_parquet_is_refused_by_name(
    write_theirs: WriteScenario, tmp_path: Path, options: str
) -> None:
    said = rf"a\.sumocfg: SUMO dies when it writes {options.partition(' ')[0]}> as parquet; .* in \.xml, without "
    with pytest.raises(TownError, match=said):
        staged_in(tmp_path, write_theirs(options))


@pytest.mark.parametrize("given", ["", '<output.format value="parquet"/>'])
def test_what_sumo_can_write_as_parquet_it_writes(write_theirs: WriteScenario, tmp_path: Path, given: str) -> None:
    fcd = '<fcd-output value="f.parquet"/><fcd-output.attributes value="x,y,speed"/>'
    run_staged(staged_in(tmp_path, write_theirs(f'{fcd}<summary value="s.parquet"/>{given}')).sumocfg)
    assert (tmp_path / "run" / "f.parquet").read_bytes()[:4] == (tmp_path / "run" / "s.parquet").read_bytes()[:4]


def test_outputs_of_one_name_stay_apart_and_one_file_stays_one(
    write_theirs: WriteScenario, lane: str, tmp_path: Path
) -> None:
    more = "".join(
        f'<e1Detector id="e{k}" lane="{lane}" pos="5" period="5" file="{file}"/>'
        for k, file in enumerate(("out.xml", "./out.xml", "other/out.xml"))
    )
    staged = staged_in(tmp_path, write_theirs("", more))
    root = read_root(tmp_path / "run" / "inputs" / "a.add.xml")
    assert [Path(element.get("file", "")).name for element in root] == ["out.xml", "out.xml", "out-2.xml"]
    assert [path.name for path in staged.outputs] == ["out-2.xml", "out.xml"]


def test_what_writes_nothing_is_read_where_it_lies(write_theirs: WriteScenario, lane: str, tmp_path: Path) -> None:
    more = (
        f'<parkingArea id="p" lane="{lane}" startPos="2" endPos="12" roadsideCapacity="2"/>'
        f'<busStop id="b" lane="{lane}" startPos="2" endPos="12"/><poi id="x" x="1" y="2" type="wcsim.bench"/>'
        '<vType id="t" vClass="bus"/><poly id="q" shape="0,0 1,0 1,1" color="red" type="building"/>'
    )
    sumocfg = write_theirs("", more)
    staged = staged_in(tmp_path, sumocfg)
    assert made_in(tmp_path) == {"a.sumocfg"}
    text = staged.sumocfg.read_text()
    for name in ("a.net.xml", "a.rou.xml", "a.add.xml"):
        assert f'value="{tmp_path / "theirs" / name}"' in text
    run_staged(staged.sumocfg, 1.0)


def test_files_that_a_copied_file_reads_are_found_from_its_new_place(
    corner_town: Town, lane: str, tmp_path: Path
) -> None:
    sign = f'<variableSpeedSign id="v" lanes="{lane}" file="speeds.xml"/>'
    writer = '<edgeData id="ed" file="edges.xml"/>'
    sumocfg = hostile.scenario(corner_town, tmp_path / "their town", "", sign + writer)
    (tmp_path / "their town" / "speeds.xml").write_text('<vss><step time="0" speed="1"/></vss>', encoding="utf-8")
    staged = staged_in(tmp_path, sumocfg)
    run_staged(staged.sumocfg, 3.0)
    assert (tmp_path / "run" / "edges.xml").is_file()


def test_compressed_files_and_other_outputs_are_taken(write_theirs: WriteScenario, tmp_path: Path) -> None:
    more = '<edgeData id="ed" file="edges.xml.gz"/>'
    sumocfg = write_theirs("", more)
    add = tmp_path / "theirs" / "a.add.xml"
    add.write_bytes(gzip.compress(add.read_bytes()))
    staged = stage_scenario(open_town(sumocfg), SETTINGS, tmp_path / "run", ("fcd", "tripinfo"))
    run_staged(staged.sumocfg, 3.0)
    assert {"edges.xml.gz", "fcd.xml", "tripinfo.xml"} <= made_in(tmp_path)
    with pytest.raises(ConfigError, match=r"no such output; expected .*fcd"):
        stage_scenario(open_town(sumocfg), SETTINGS, tmp_path / "other", ("fdc",))


@pytest.mark.parametrize(
    "more, says",
    [
        ('<include href="a.add.xml"/>', "include each other"),
        ('<include href="none.xml"/>', "names a file that does not exist"),
        ('<edgeData id="x" file="x.xml"', "not well-formed"),
    ],
)
def test_broken_files_are_refused_by_name(write_theirs: WriteScenario, tmp_path: Path, more: str, says: str) -> None:
    sumocfg = write_theirs("", more)
    with pytest.raises(TownError, match=rf"a\.add\.xml.*{says}"):
        staged_in(tmp_path, sumocfg)


def test_files_with_odd_names_are_read_from_copies_with_plain_ones(write_theirs: WriteScenario, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    sumocfg = write_theirs("", '<include href="weg \u00e4%41.xml"/>')
    (theirs / "weg \u00e4%41.xml").write_text('<additional><poi id="x" x="1" y="1"/></additional>', encoding="utf-8")
    (theirs / "a.rou.xml").rename(theirs / "r&\u00fc.rou.xml")
    text = sumocfg.read_text(encoding="utf-8").replace("a.rou.xml", "r&amp;\u00fc.rou.xml")
    sumocfg.write_text(text, encoding="utf-8")
    staged = staged_in(tmp_path, sumocfg)
    run_staged(staged.sumocfg, 1.0)
    assert {path.name for path in (tmp_path / "run" / "inputs").iterdir()} == {"a.add.xml", "weg_41.xml", "r_.rou.xml"}


def test_overrides_name_only_what_differs(write_theirs: WriteScenario, tmp_path: Path) -> None:
    options = "<time><step-length value='0.1'/><end value='50'/></time><seed value='9'/><time-to-teleport value='77'/>"
    town = open_town(write_theirs(options + "<scale value='2'/>"))
    rows = {row.option: row for row in stage_scenario(town, SETTINGS, tmp_path / "run").overrides}
    assert "step-length" not in rows and "time-to-teleport" not in rows and "scale" not in rows
    assert (rows["seed"].author, rows["seed"].wcsim) == ("9", "5")
    assert "flows" in rows["end"].why
    settings = Settings(world=WorldConfig(tick_s=0.05, demand_scale=0.5, jam_teleport_s=-1.0), seed=5)
    rows = {row.option: row for row in stage_scenario(town, settings, tmp_path / "two").overrides}
    assert rows["scale"].wcsim == "1.0" and rows["time-to-teleport"].author == "77"
    text = (tmp_path / "two" / "a.sumocfg").read_text()
    assert (
        '<time-to-teleport value="-1.0"' in text and '<step-length value="0.05"' in text and '<end value="50"' in text
    )


def test_shorter_steps_than_the_authors_are_told_and_drivers_may_decide_as_before(
    write_theirs: WriteScenario, tmp_path: Path
) -> None:
    town = open_town(write_theirs())
    (row,) = (row for row in stage_scenario(town, SETTINGS, tmp_path / "a").overrides if row.option == "step-length")
    assert row.author == "1 (default)" and "faster" in row.why and "world.action_step_s" in row.why
    staged = stage_scenario(town, Settings(world=WorldConfig(action_step_s=1.0), seed=5), tmp_path / "b")
    rows = {row.option: row for row in staged.overrides}
    assert rows["default.action-step-length"].wcsim == "1.0" and "faster" not in rows["step-length"].why
    assert '<default.action-step-length value="1.0"' in staged.sumocfg.read_text()
    set_by_author = "<default.action-step-length value='0.5'/>"
    own = open_town(write_theirs(set_by_author))
    kept = stage_scenario(own, SETTINGS, tmp_path / "c")
    assert not [row for row in kept.overrides if "faster" in row.why or row.option == "default.action-step-length"]
    assert '<default.action-step-length value="0.5"' in kept.sumocfg.read_text()


def test_the_digest_follows_the_files_and_not_the_seed_or_place(
    corner_town: Town, write_theirs: WriteScenario, tmp_path: Path
) -> None:
    sumocfg = write_theirs()
    first = staged_in(tmp_path, sumocfg).digest
    assert stage_scenario(open_town(sumocfg), Settings(seed=6), tmp_path / "run2").digest == first
    copy = hostile.scenario(corner_town, tmp_path / "copy")
    assert stage_scenario(open_town(copy), SETTINGS, tmp_path / "run3").digest == first
    other = write_theirs("", '<poi id="x" x="1" y="2"/>')
    assert stage_scenario(open_town(other), SETTINGS, tmp_path / "run4").digest != first


def test_a_mesoscopic_scenario_is_refused(write_theirs: WriteScenario, tmp_path: Path) -> None:
    town = open_town(write_theirs("<mesosim value='true'/>"))
    with pytest.raises(TownError, match="mesoscopic"):
        stage_scenario(town, SETTINGS, tmp_path / "run")


def test_a_folder_that_sumo_cannot_write_to_is_refused(write_theirs: WriteScenario, tmp_path: Path) -> None:
    town = open_town(write_theirs())
    with pytest.raises(TownError, match="SUMO cannot write"):
        stage_scenario(town, SETTINGS, tmp_path / "at 12:30")


def test_a_large_file_that_names_no_other_is_looked_through_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until it changes, however little; one that writes is looked through every time."""
    scanned = list[str]()
    whole = files.scan
    monkeypatch.setattr(files, "scan", lambda data, where, visit: (scanned.append(where), whole(data, where, visit)))
    path = tmp_path / "large.rou.xml"
    rest = f"<!-- {'.' * 200_000} -->"
    for number, inside in enumerate(("", '<flow id="a"/>', '<edgeData id="a" file="b.xml"/>')):
        path.write_text(f"<routes>{inside}{rest}</routes>", "utf-8")
        for k in range(2):
            placed = files.FilteredFiles(tmp_path / f"run-{number}-{k}", None).place(path, path)
            assert (placed == path) is (number < 2)
    assert len(scanned) == 1 + 1 + 2
    assert (tmp_path / "run-2-0" / "inputs" / "large.rou.xml").is_file()
