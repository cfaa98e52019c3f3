from __future__ import annotations

from pathlib import Path

import pytest

from wcsim.errors import TownError
from wcsim.towns.scenario_options import Treatment, read_configuration, sumo_options


def configuration(tmp_path: Path, inside: str, root: str = "sumoConfiguration"):
    path = tmp_path / "x.sumocfg"
    path.write_text(f"<{root}>{inside}</{root}>", encoding="utf-8")
    return read_configuration(path)


@pytest.mark.parametrize(
    "inside",
    [
        '<input><net-file value="a.net.xml"/></input>',
        '<n v="a.net.xml"/>',
        "<anything><deep><net> a.net.xml </net></deep></anything>",
        '<input><net value="a.net.xml"/></input>',
    ],
)
def test_every_spelling_that_sumo_takes_is_read(tmp_path: Path, inside: str) -> None:
    for root in ("configuration", "sumoConfiguration", "whatever"):
        config = configuration(tmp_path, inside, root)
        assert config.files("net-file") == (tmp_path / "a.net.xml",)


def test_several_files_and_variables_are_taken_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HERE", "sub")
    config = configuration(tmp_path, '<r value="a.xml, ${HERE}/b%20c.xml,/d.xml"/>')
    assert config.files("route-files") == (tmp_path / "a.xml", tmp_path / "sub" / "b c.xml", Path("/d.xml"))


@pytest.mark.parametrize(
    ("inside", "says"),
    [
        ('<nosuch value="1"/>', "no option <nosuch>"),
        ('<lateral-resolution value="wide"/>', "<lateral-resolution> is 'wide'; expected a number"),
        ('<lateral-resolution value="nan"/>', "expected a number"),
        ('<end value="soon"/>', "expected a time"),
        ('<ignore-route-errors value="maybe"/>', "expected true or false"),
        ('<n value="a"/><net-file value="b"/>', "sets <net-file> twice"),
    ],
)
def test_what_sumo_would_refuse_is_refused_with_the_file_named(tmp_path: Path, inside: str, says: str) -> None:
    with pytest.raises(TownError, match=rf"x\.sumocfg: .*{says}"):
        configuration(tmp_path, inside)


def test_every_option_that_takes_a_file_has_a_treatment() -> None:
    options = sumo_options()
    read = {name for name, item in options.items() if item.name == name and item.treatment is Treatment.INPUT}
    assert read == {
        "net-file",
        "route-files",
        "additional-files",
        "weight-files",
        "load-state",
        "fcd-output.filter-edges.input-file",
        "device.ssm.filter-edges.input-file",
        "astar.all-distances",
        "astar.landmark-distances",
        "phemlight-path",
        "device.fcd-replay.files",
    }
    for name in ("log", "error-log", "device.ssm.file", "device.toc.file", "device.rerouting.output", "netstate-dump"):
        assert options[name].treatment is Treatment.OUTPUT, name
    for name in ("save-configuration", "gui-settings-file", "remote-port", "output-prefix"):
        assert options[name].treatment is Treatment.DROP, name
    for name in ("fcd-output.geo", "step-length", "collision.action", "lateral-resolution", "precision"):
        assert options[name].treatment is Treatment.KEEP, name
