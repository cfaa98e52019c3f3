"""Scenarios of strangers: checked, the printed cure typed as it stands, run; and SUMO's traffic stays its own."""

import json
import math
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import pytest
import sumolib

from tests.bridge.neutrality.neutral import same
from tests.support.typed import printed, typed
from tests.towns.made.strangers import GENERATED, bologna_cars, copied, game
from wcsim.towns.scenario.options import read_configuration
from wcsim.towns.scenario.town import find_town
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import read_bytes

SMALL = "--set cameras.0.width_px=32 --set cameras.0.height_px=24 --set world.warmup_s=0"
POSITIONS = ("pos", "startPos", "endPos")
NEAR_M = 0.05
GAVE_WAY_M = 1.01  # from the end of a lane: so near to it lies what a grown junction has pushed away
GAMES = ("cross", "square", "grid6", "corridor", "fkk_in", "fokr_bs_demo")
BOLOGNA: dict[str, Callable[[Path, Path], Path]] = {"peds": copied, "cars": bologna_cars}


def cured(theirs: Path, folder: Path) -> Path:
    """The scenario after all that a check prints was typed."""
    ours, (code, said) = theirs, typed(f"wcsim town check {theirs}", folder)
    assert code in (0, 1), said
    if "wcsim town pave" in said:
        code, said = typed(printed(said, "wcsim town pave"), folder)
        assert code == ("\nfault: " in said), said
        ours = folder / re.findall(r"wrote (\S+);", said)[0]
        assert_in_place(theirs, ours, int((re.findall(r"(\d+) positions? moved off", said) or ["0"])[0]))
    if "join the parts" in said:
        code, opened = typed(printed(said, "join the parts") + " --version", folder)  # there is no screen
        assert code == 0 and "netedit" in opened
    if "the demand has no pedestrians" in said:
        code, said = typed(printed(said, "the demand has no pedestrians"), folder)
        assert code == 0, said
        add_routes(ours, ours.with_name("walkers.rou.xml"))
    return ours


def add_routes(sumocfg: Path, routes: Path) -> None:
    tree = ElementTree.parse(sumocfg)  # noqa: S314 - a copy of our own
    found = tree.find(".//route-files")
    if found is None:
        found = ElementTree.SubElement(tree.find(".//input"), "route-files")  # type: ignore[arg-type]
    found.set("value", ",".join(filter(None, (found.get("value"), routes.name))))
    tree.write(sumocfg)


def assert_in_place(theirs: Path, ours: Path, gave_way: int) -> None:
    """Whatever lies on a lane lies on a lane of vehicles, at the same place in metres."""
    towns = [find_town(str(path)) for path in (theirs, ours)]
    nets = [sumolib.net.readNet(str(town.net), withInternal=True) for town in towns]
    moved = set()
    for paths in zip(*((*town.additional, *town.routes) for town in towns), strict=True):
        for old, new in zip(*(ElementTree.fromstring(read_bytes(path)).iter() for path in paths), strict=True):  # noqa: S314
            if "lane" not in old.attrib or old.attrib["lane"].startswith(":"):
                continue
            assert nets[1].getLane(new.attrib["lane"]).getPermissions() != {"pedestrian"}
            for key in (key for key in POSITIONS if key in old.attrib):
                far_m = math.dist(place_of(nets[0], old, key), place_of(nets[1], new, key))
                end_m = float(new.attrib[key])
                length_m = nets[1].getLane(new.attrib["lane"]).getLength()
                if far_m > NEAR_M:
                    assert min(end_m % length_m, -end_m % length_m) <= GAVE_WAY_M, (old.attrib, new.attrib)
                    moved.add((old.tag, old.get("id") or old.attrib["lane"]))
    assert len(moved) <= gave_way


def place_of(net: sumolib.net.Net, element: Element, key: str) -> tuple[float, float]:
    """Where a position lies, by SUMO's own library: positions of lanes that are drawn longer are stretched."""
    lane, pos_m = net.getLane(element.attrib["lane"]), float(element.attrib[key])
    shape, length_m = lane.getShape(), lane.getLength()
    pos_m = min(pos_m if pos_m >= 0.0 else pos_m + length_m, length_m)
    drawn_m = sumolib.geomhelper.polyLength(shape)
    found: tuple[float, float] = sumolib.geomhelper.positionAtShapeOffset(shape, pos_m / length_m * drawn_m)
    return found


def assert_runs(sumocfg: Path, folder: Path, seconds: float, chairs: int = 2) -> None:
    """Wheelchairs drive in it, and without any SUMO writes what it writes by itself."""
    run = f"wcsim town run {shlex.quote(str(sumocfg))} --seconds {seconds:g}"
    if chairs:
        code, said = typed(f"{run} --chairs {chairs} --out chairs {SMALL}", folder)
        assert code == 0, said
        facts = json.loads((folder / "chairs" / "manifest.json").read_text())["facts"]
        assert facts["episodes"] >= chairs and facts["ticks"] == round(seconds * 10)
    code, said = typed(f"{run} --chairs 0 --outputs fcd,tripinfo --out none-{chairs}", folder)
    assert code == 0, said
    manifest = json.loads((folder / f"none-{chairs}" / "manifest.json").read_text())
    plain = folder / f"plain-{chairs}"
    plain.mkdir()
    begin_s = float(manifest["facts"]["end_s"]) - seconds
    options = ["-c", str(sumocfg), "--step-length", "0.1", "--seed", str(manifest["sumo_seed"]), "--no-step-log"]
    options += ["--end", f"{begin_s + seconds:.1f}", "--no-warnings", "--xml-validation", "never"]
    options += ["--xml-validation.net", "never", "--xml-validation.routes", "never", "--log", str(plain / "log")]
    for name in ("fcd", "tripinfo"):
        options += [f"--{name}-output", str(plain / f"{name}.xml")]
    run_of_sumo = run_tool("sumo", options, plain, Limits(wall_s=900.0, cpu_s=880, file_bytes=4 << 30))
    assert run_of_sumo.returncode == 0 and "Error" not in run_of_sumo.output, run_of_sumo.output
    config = read_configuration(sumocfg)
    for name in ("fcd", "tripinfo"):
        ours = Path(config.value(f"{name}-output") or f"{name}.xml").name
        assert same(folder / f"none-{chairs}" / "sumo" / ours, plain / f"{name}.xml"), name
    assert (plain / "fcd.xml").stat().st_size > 10_000


@pytest.mark.proof
def test_a_scenario_is_checked_cured_as_printed_and_run(tmp_path: Path) -> None:
    ours = cured(GENERATED["programs-left"](tmp_path / "theirs"), tmp_path)
    assert_runs(ours, tmp_path, 5.0)


def assert_both_run(theirs: Path, tmp_path: Path) -> None:
    """As it is without chairs, and cured with them."""
    assert_runs(theirs, tmp_path, 60.0, chairs=0)
    assert_runs(cured(theirs, tmp_path), tmp_path, 60.0)


@pytest.mark.proof
@pytest.mark.parametrize("name", GENERATED)
def test_generated_scenarios_are_checked_cured_and_run(name: str, tmp_path: Path) -> None:
    theirs = GENERATED[name](tmp_path / "theirs")
    assert_both_run(theirs, tmp_path)


@pytest.mark.proof
@pytest.mark.parametrize("name", GAMES)
def test_scenarios_of_sumos_own_wheel_are_checked_cured_and_run(name: str, tmp_path: Path) -> None:
    theirs = game(name, tmp_path / "theirs")
    assert_both_run(theirs, tmp_path)


@pytest.mark.proof
@pytest.mark.shared
@pytest.mark.parametrize("name", BOLOGNA)
def test_scenarios_of_bologna_are_checked_cured_and_run(name: str, shared: Path, tmp_path: Path) -> None:
    given = shared / "towns" / "nets" / "bologna_acosta" / "run.sumocfg"
    theirs = BOLOGNA[name](given, tmp_path / "theirs")
    assert_both_run(theirs, tmp_path)
