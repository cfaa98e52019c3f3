"""Scenarios of strangers with one thing wrong: which command says so, of which file, and what cures it."""

import gzip
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Result, files_in, parsed
from tests.cli.test_bad_input import refused
from tests.towns.made import hostile
from tests.towns.made.nets import PAVED, moved
from wcsim.towns.sumo.tools import run_tool

RUN = ("--seconds", "1", "--set", "cameras.0.width_px=32", "--set", "cameras.0.height_px=24", "--out", "run")


@pytest.fixture
def theirs(corner_town: object, folder: Path) -> Path:
    """The sound town as a stranger's scenario: no town.toml, nothing compressed."""
    return hostile.scenario(corner_town, folder.parent / "theirs").parent


def one_line(result: Result) -> str:
    """What was printed, long lines joined again."""
    return " ".join((result.out + result.err).split())


def put_net(theirs: Path, *options: str) -> None:
    """Another net in its place, of three streets by three, and a car that fits it."""
    words = ["--grid", "--grid.number", "3", "--grid.length", "60", *options, "-o", "a.net.xml"]
    run = run_tool("netgenerate", words, theirs)
    assert run.returncode == 0, run.output
    text = '<routes><vehicle id="one" depart="0"><route edges="A0A1 A1A2"/></vehicle></routes>'
    (theirs / "a.rou.xml").write_text(text, encoding="utf-8")


def change(path: Path, pattern: str, by: str | Callable[[re.Match[str]], str]) -> None:
    text, count = re.subn(pattern, by, path.read_text(encoding="utf-8"))
    assert count
    path.write_text(text, encoding="utf-8")


def test_a_net_without_pavements(wcsim, folder, theirs):
    put_net(theirs)
    refused(
        wcsim("town", "run", theirs, *RUN),
        *("a.net.xml", "no pavement", f"wcsim town pave {theirs}/", f"wcsim town run {theirs}/a.sumocfg --chairs 0)"),
    )
    assert files_in(folder) == set()
    alone = wcsim("town", "run", theirs, *RUN, "--chairs", "0")
    assert alone.code == 0
    assert f"no walking areas; add pavements and crossings: wcsim town pave {theirs}/" in alone.out


def test_a_net_without_crossings(wcsim, theirs):
    put_net(theirs, *(word for word in PAVED if word != "--crossings.guess"))
    checked = wcsim("town", "check", theirs, "--json", "check.json")
    assert checked.code == 1
    assert "pedestrians cannot cross a street; add crossings and walking areas: wcsim town pave /" in one_line(checked)
    assert parsed("check.json")["crossings"] == 0
    assert wcsim("town", "run", theirs, *RUN).code == 0


def refused_at_once(wcsim, folder, theirs, *message):
    """By each command that reads a scenario."""
    for words in (
        ("check", theirs),
        ("run", theirs, *RUN),
        ("import", "--sumocfg", theirs / "a.sumocfg", "--name", "x"),
    ):
        refused(wcsim("town", *words), *message)
    assert files_in(folder) == set()


def test_a_net_that_was_never_projected(wcsim, folder, theirs):
    net = theirs / "a.net.xml"
    moved(net, net, lambda x, y: f"{25 + x / 6e4:.7f},{60 + y / 1.1e5:.7f}")
    refused_at_once(wcsim, folder, theirs, "a.net.xml", "degrees", "with netconvert's option --proj.utm")


def test_nobody_in_the_street(wcsim, theirs):
    (theirs / "a.rou.xml").write_text("<routes/>", encoding="utf-8")
    ran = wcsim("town", "run", theirs, *RUN)
    assert ran.code == 0
    assert "no pedestrians: the demand has none" in one_line(ran) and "--pedestrians" in ran.out


def test_polygons_of_another_town(wcsim, theirs):
    house = '<poly id="h" type="building" color="red" fill="1" shape="9000,9000 9010,9000 9010,9010"/>'
    (theirs / "a.poly.xml").write_text(f"<additional>{house}</additional>", encoding="utf-8")
    change(theirs / "a.sumocfg", "a.add.xml", "a.add.xml,a.poly.xml")
    checked = wcsim("town", "check", theirs)
    assert checked.code == 1
    assert "none of the 1 objects of a.poly.xml is near the streets, so it belongs to another net" in one_line(checked)
    assert "build it from its map again, with polyconvert's option --net-file a.net.xml" in one_line(checked)


def test_routes_for_another_net(wcsim, folder, theirs):
    car = '<vehicle id="one" depart="0"><route edges="elsewhere nowhere"/></vehicle>'
    walker = '<person id="two" depart="0"><walk edges="elsewhere"/></person>'
    (theirs / "a.rou.xml").write_text(f"<routes>{car}{walker}</routes>", encoding="utf-8")
    refused(wcsim("town", "run", theirs, *RUN), "a.rou.xml", "'elsewhere'", "correct the file", "sumo -c")
    assert files_in(folder) == set()
    checked = wcsim("town", "check", theirs)
    assert checked.code in (1, 2)
    assert "trips have no route through the net, or SUMO" in (told := one_line(checked))
    assert "to drop or repair them, create better.rou.xml" in told


def test_archives_that_are_none_and_files_that_are_archives(wcsim, folder, theirs):
    shutil.move(theirs / "a.net.xml", theirs / "a.net.xml.gz")
    change(theirs / "a.sumocfg", "a.net.xml", "a.net.xml.gz")
    plain = (theirs / "a.net.xml.gz").read_bytes()
    assert wcsim("town", "run", theirs, *RUN).code == 0  # plain XML under a name that says otherwise
    shutil.rmtree(folder / "run")
    for data in (gzip.compress(plain)[:-500], b"\x1f\x8b" + plain):
        (theirs / "a.net.xml.gz").write_bytes(data)
        for words in (("check", theirs), ("run", theirs, *RUN)):
            refused(wcsim("town", *words), "a.net.xml.gz", "cannot be read", "expected an XML file")
    assert files_in(folder) == set()


def test_a_scenario_that_kills_sumo(wcsim, folder, theirs):
    change(theirs / "a.net.xml", r"<connection [^>]*/>", "")
    refused_at_once(wcsim, folder, theirs, "a.net.xml", "SUMO cannot open this net", "netconvert")
