"""Scenarios that nobody of this project wrote, or that are generated as engineers would, each built into a folder."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import sumolib

from tests.towns.conftest import tool_output
from tests.towns.made.unpaved import BEGIN_S, write_unpaved
from wcsim.towns.sumo.tools import Limits, run_child, sumo_home

PAVED = ("--sidewalks.guess", "--crossings.guess", "--walkingareas")
_CONFIG = """<configuration>
    <input><net-file value="{net}"/><route-files value="{routes}"/><additional-files value="{more}"/></input>
    <time><begin value="{begin:g}"/><end value="{end:g}"/></time>
</configuration>"""


def game(name: str, folder: Path) -> Path:
    """One of the games that come with SUMO's own wheel."""
    tools = sumo_home() / "tools" / "game"
    folder.mkdir(parents=True)
    for part in (f"{name}.sumocfg", "input_additional.add.xml"):
        shutil.copy(tools / part, folder / part)
    shutil.copytree(tools / name, folder / name)
    return folder / f"{name}.sumocfg"


def copied(sumocfg: Path, folder: Path) -> Path:
    """A scenario whose files all lie beside it."""
    shutil.copytree(sumocfg.parent, folder, copy_function=shutil.copyfile)
    folder.chmod(0o755)
    return folder / sumocfg.name


def bologna_cars(theirs: Path, folder: Path) -> Path:
    """The net of Bologna before it had pavements, with its loops and its signals' programs."""
    copied(theirs, folder)
    routes, more = "acosta.rou.xml", "acosta_vtypes.add.xml,acosta_detectors.add.xml,acosta_tls.add.xml"
    config = _CONFIG.format(net="acosta_buslanes.net.xml", routes=routes, more=more, begin=0.0, end=600.0)
    (folder / "cars.sumocfg").write_text(config)
    return folder / "cars.sumocfg"


def made(
    folder: Path, options: tuple[str, ...], *, persons: bool = True, begin_s: float = 0.0, speed_mps: float = 13.8
) -> Path:
    """A net of netgenerate with the trips of randomTrips, and a stop, a loop and an area on every fifth street."""
    folder.mkdir(parents=True)
    tool_output("netgenerate", [*options, "--default.speed", str(speed_mps), "-L", "2", "-o", "t.net.xml"], folder)
    times = ["-b", str(begin_s), "-e", str(begin_s + 300.0), "--seed", "3", "--validate"]
    _trips(folder, "t.rou.xml", [*times, "-p", "2"])
    routes = ["t.rou.xml"]
    if persons:
        _trips(folder, "w.rou.xml", [*times, "-p", "8", "--pedestrians", "--prefix", "w"])
        routes.append("w.rou.xml")
    (folder / "t.add.xml").write_text(_things(folder / "t.net.xml"))
    config = _CONFIG.format(
        net="t.net.xml", routes=",".join(routes), more="t.add.xml", begin=begin_s, end=begin_s + 600.0
    )
    (folder / "t.sumocfg").write_text(config)
    return folder / "t.sumocfg"


def _trips(folder: Path, name: str, options: list[str]) -> None:
    home = sumo_home()
    tool = [sys.executable, str(home / "tools" / "randomTrips.py"), "-n", "t.net.xml"]
    options = [*options, "-r", name, "-o", f"{name}.trips"]
    run = run_child("randomTrips", [*tool, *options], folder, {"SUMO_HOME": str(home)}, Limits())
    assert run.returncode == 0, run.output


def _things(net: Path) -> str:
    edges = [edge for edge in sumolib.net.readNet(str(net)).getEdges() if edge.allows("passenger")][::5]
    lines = []
    for number, edge in enumerate(edges):
        lane = next(lane for lane in edge.getLanes() if lane.allows("passenger"))
        head, end_m = f'lane="{lane.getID()}"', lane.getLength()
        area = f'pos="{0.2 * end_m:.2f}" length="20"'
        lines += [
            f'<busStop id="stop{number}" {head} startPos="{0.4 * end_m:.2f}" endPos="{0.4 * end_m + 12:.2f}"/>',
            f'<inductionLoop id="loop{number}" {head} pos="-6" period="60" file="loops.xml"/>',
            f'<laneAreaDetector id="area{number}" {head} {area} period="60" file="e2.xml"/>',
        ]
    return "<additional>\n" + "\n".join(lines) + "\n</additional>\n"


GENERATED: dict[str, Callable[[Path], Path]] = {
    "programs": write_unpaved,
    "programs-left": lambda folder: write_unpaved(folder, lefthand=True),
    "spider": lambda folder: made(folder, ("--spider", "--spider.arm-number", "5", "--tls.guess"), persons=False),
    "random-left": lambda folder: made(
        folder, ("--rand", "--rand.iterations", "40", "--seed", "5", "--lefthand"), persons=False, begin_s=BEGIN_S
    ),
    "late-paved": lambda folder: made(folder, ("--grid", "--grid.number", "3", "--tls.guess", *PAVED), begin_s=BEGIN_S),
    "paved-left": lambda folder: made(folder, ("--grid", "--grid.number", "3", "--lefthand", *PAVED)),
}
