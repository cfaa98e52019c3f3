import gzip
import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.towns.made import hostile
from wcsim.errors import SumoError, TownError
from wcsim.towns.build_street import build_street
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import read_net
from wcsim.towns.sumo.tools import Limits, run_tool

LANE = '<edge id="a" from="x" to="y"><lane id="a_0" index="0" speed="5" length="9" shape="0,0 9,0"/></edge>'

SIDES = "".join(LANE.replace("0,0 9,0", f"24.93,{y} 24.97,{y}") for y in (58.6, 61.7))  # metres wide all the same
NODES = '<junction id="x" type="priority" x="24.93" y="60.17"/><junction id="y" type="priority" x="24.97" y="60.15"/>'
DEGREES = LANE.replace("0,0 9,0", "24.93,60.17 24.94,60.18")


@pytest.mark.parametrize("change", [("9,0", "nan,0"), ("9,0", "9,0,inf"), ('"5"', '"nan"'), ('"9"', '"1e999"')])
def test_every_reader_of_a_net_names_the_lane_with_a_number_that_is_none(
    tmp_path: Path, change: tuple[str, str]
) -> None:
    (tmp_path / "a.net.xml").write_text(f"<net>{LANE.replace(*change)}</net>")
    with pytest.raises(TownError, match=r"a\.net\.xml: <lane id='a_0'> has .*; expected numbers: correct it"):
        read_net(tmp_path / "a.net.xml")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not well-formed"),
        ("<net/>", "no edge with lanes"),
        ("<routes/>", "root element is <routes>"),
        (f"<net>{LANE}</net>", "no junction"),
        (f'<net>{LANE.replace("9,0", "nan,0")}<junction id="x"/></net>', "expected numbers"),
        (f'<net>{LANE.replace("9,0", "1e999,0")}<junction id="x"/></net>', "expected numbers"),
        ('<!DOCTYPE net [<!ENTITY a "b">]><net/>', "document type"),
        (f'<net>{LANE}<junction id="x" type="priority"/></net>', "SUMO cannot open"),
        (f'<net>{DEGREES}{DEGREES}<junction id="x"/></net>', "look like degrees.*--proj.utm"),
        (f"<net>{SIDES}{NODES}</net>", "is only 0.0400 m across; .*look like degrees.*--proj.utm"),
        (f'<net>{LANE}<junction id="x" x="" y="1"/></net>', "<junction id='x'> has x=''; expected numbers"),
        (
            f'<net>{LANE.replace("9,0", "90000,0")}<junction id="x"/></net>',
            "lane 'a_0' is 9 m long and drawn over 90000",
        ),
        (f'<net>{LANE}<junction id="x" shape="0,0 5,5 90000,0"/></net>', "junction 'x' is 90000 m across"),
        (f'<net>{LANE.replace("9,0", "900000,0")}<junction id="x"/></net>', "900 km.*--proj.utm"),
    ],
)
def test_bad_nets_are_refused_in_at_most_two_lines(text: str, reason: str, tmp_path: Path) -> None:
    net = tmp_path / "bad.net.xml"
    net.write_text(text, encoding="utf-8")
    with pytest.raises(TownError, match=reason) as caught:
        validate_net(net)
    assert str(caught.value).count("\n") <= 1


def test_net_that_kills_sumo_is_refused_not_cached(corner_town: Town, tmp_path: Path, own_cache: Path) -> None:
    text = gzip.decompress(corner_town.net.read_bytes()).decode()
    net = tmp_path / "deadly.net.xml"
    net.write_text(re.sub(r"<connection [^>]*/>", "", text), encoding="utf-8")
    for _ in range(2):
        with pytest.raises(TownError, match="was ended by SIGSEGV"):
            validate_net(net)
    assert not list(own_cache.rglob("*.ok"))


def test_good_net_is_opened_by_sumo_once(manhattan_town: Town, monkeypatch: pytest.MonkeyPatch) -> None:
    validate_net(manhattan_town.net)
    monkeypatch.setattr("wcsim.towns.checks.validate.run_tool", lambda *words: pytest.fail("SUMO opened it once more"))
    validate_net(manhattan_town.net)


def test_tools_are_ended_at_their_limits(manhattan_town: Town, tmp_path: Path) -> None:
    arguments = ["-c", str(manhattan_town.sumocfg), "--end", "100000"]
    with pytest.raises(SumoError, match="took longer"):
        run_tool("sumo", arguments, tmp_path, Limits(wall_s=0.5))
    assert run_tool("sumo", arguments, tmp_path, Limits(cpu_s=1)).died
    assert run_tool("sumo", ["--no-such-option"], tmp_path).reason().startswith("sumo failed with code 1")


def test_a_net_that_names_outputs_writes_nothing(corner_town: Town, tmp_path: Path) -> None:
    escape = tmp_path / "escape"
    escape.mkdir()
    lane = hostile.lane_of(corner_town)
    writer = f'<inductionLoop id="i" lane="{lane}" pos="5" freq="1" file="{escape}/loop.xml"/>'
    text = gzip.decompress(corner_town.net.read_bytes()).decode().replace("</net>", f"{writer}</net>")
    (tmp_path / "a.net.xml").write_text(text, encoding="utf-8")
    validate_net(tmp_path / "a.net.xml")
    assert not list(escape.iterdir())


def test_a_net_whose_lanes_are_points_is_refused(corner_town: Town, tmp_path: Path) -> None:
    text = gzip.decompress(corner_town.net.read_bytes()).decode()
    net = tmp_path / "points.net.xml"
    net.write_text(re.sub(r' shape="(\S+)[^"]*"', r' shape="\1 \1"', text), encoding="utf-8")
    with pytest.raises(TownError, match=r"points\.net\.xml: no lane covers any ground"):
        build_street(replace(corner_town, net=net))
