"""Runs the fuzzer's mutants as a user would, many in one child process, and says what came of each.

`python -m tests.towns.fuzz.run FOLDER CASE,CASE,...`: a mutant that is a fault stays in FOLDER. A case is the number of
a mutant, or NUMBER:FAULT for it in a wcsim with a planted fault.
"""

import faulthandler
import hashlib
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

from tests.cli.towns import tiny_osm
from tests.support.tracked import ROOT
from tests.towns.fuzz.scenarios import Case, make_case
from wcsim.errors import TownError, WcsimError
from wcsim.towns.sumo.xml_io import read_bytes

LIMIT_S = 60.0
TICKS = 12
MEMORY_BYTES = 8 << 30
MOST_LINES, MOST_LETTERS = 2, 900
_CURE = re.compile(
    r"expected|correct|name it|remove|restore|build|export|choose|rename|join|give|clip|open it|download|larger|check"
    r"|: wcsim "
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of a mutant: "works", "refused" with the message, or "fault" with what was wrong."""

    number: int
    family: str
    changes: tuple[str, ...]
    result: str
    told: str = ""
    seconds: float = 0.0

    def __str__(self) -> str:
        return f"{self.number} ({self.family}: {', '.join(self.changes)}): {self.result}: {self.told}"


# --- the sound town that mutants are made of ---

_ADDITIONAL = """<additional>
    <vType id="bus" vClass="bus" length="12"/>
    <parkingArea id="park" lane="WC_1" startPos="5" endPos="25" roadsideCapacity="3"/>
    <busStop id="stop" lane="CE_1" startPos="10" endPos="25" lines="7"/>
    <e1Detector id="loop" lane="CE_1" pos="5" period="5" file="loops.xml"/>
    <rerouter id="detour" edges="WC"><interval begin="0" end="9"><destProbReroute id="CE"/></interval></rerouter>
    <poi id="bench" type="wcsim.bench" color="red" layer="0" x="20" y="-6"/>
    <poi id="sign" type="wcsim.sign" color="red" layer="0" x="-20" y="-6"/>
    <poly id="works" type="wcsim.roadworks" color="red" fill="1" layer="0" shape="30,5 34,5 34,6 30,6"/>
    <include href="more.xml"/>
</additional>
"""
_POLYGONS = """<additional>
    <poly id="house" type="building" color="red" fill="1" layer="0" shape="12,12 30,12 30,30 12,30">
        <param key="building" value="yes"/><param key="height" value="9"/>
    </poly>
    <poly id="wall" type="barrier.wall" color="red" fill="0" layer="0" shape="-12,-12 -30,-12"/>
    <poi id="tree" type="natural.tree" color="red" layer="0" x="-15" y="15"/>
    <poi id="kerb" type="kerb.lowered" color="red" layer="0" x="-8" y="3"><param key="kerb" value="lowered"/></poi>
</additional>
"""
_ROUTES = """
    <vTypeDistribution id="any" vTypes="bus car" probabilities="0.2 0.8"/>
    <route id="straight" edges="WC CE"/>
    <vehicle id="parked" type="car" depart="0" route="straight"><stop parkingArea="park" duration="90"/></vehicle>
    <person id="rider" depart="0"><walk edges="WC" arrivalPos="20"/><stop lane="WC_0" duration="2"/></person>
    <flow id="cars" type="any" begin="0" end="90" period="4" from="EC" to="CW"/>
    <personFlow id="crowd" begin="0" end="90" period="3"><walk from="NC" to="CE"/></personFlow>
    <vehicle id="line" type="bus" depart="1"><route edges="WC CE"/><stop busStop="stop" duration="3"/></vehicle>
</routes>"""
_OPTIONS = """<configuration>
    <input><net-file value="base.net.xml"/><route-files value="base.rou.xml"/>
        <additional-files value="base.add.xml,base.poly.xml"/></input>
    <output><tripinfo-output value="out/trips.xml"/><summary value="summary.xml"/></output>
    <time><begin value="0"/><end value="3600"/><step-length value="0.1"/></time>
    <processing><lateral-resolution value="0.8"/><collision.action value="warn"/></processing>
    <report><verbose value="true"/></report>
    <random_number><seed value="7"/></random_number>
</configuration>
"""


def write_base(folder: Path) -> None:
    """A sound scenario with a little of everything, and a sound extract of a map."""
    from wcsim.towns.scene_folders.build import build_scene, find_scene

    with tempfile.TemporaryDirectory() as work:
        town = build_scene(find_scene("pedestrian-crossing"), Path(work))[0]
        net, routes = read_bytes(town.net), town.routes[0].read_text(encoding="utf-8")
    folder.mkdir(parents=True)
    (folder / "base.net.xml").write_bytes(net)
    (folder / "base.rou.xml").write_text(routes.replace("</routes>", _ROUTES), encoding="utf-8")
    (folder / "base.add.xml").write_text(_ADDITIONAL, encoding="utf-8")
    (folder / "more.xml").write_text('<additional><edgeData id="d" file="d.xml"/></additional>', encoding="utf-8")
    (folder / "base.poly.xml").write_text(_POLYGONS, encoding="utf-8")
    (folder / "base.sumocfg").write_text(_OPTIONS, encoding="utf-8")
    (folder / "base.osm").write_text(tiny_osm(), encoding="utf-8")
    (folder / "link").symlink_to("../canary")


# --- one mutant ---


def run_case(case: Case, base: Path, work: Path) -> tuple[str, str]:
    """Result and message of a mutant of the town in `base`, tried in the new folder `work`."""
    theirs, canary = work / "theirs", work / "canary"
    shutil.copytree(base, theirs, symlinks=True)
    canary.mkdir()
    (canary / "precious.xml").write_text("irreplaceable", encoding="utf-8")
    os.environ["HOME"] = str(canary)
    os.chdir(canary)
    plain = case.family in ("osm", "sumocfg")
    file = theirs / (f"base.{case.family}" if plain else f"base.{case.family}.xml")
    case.spoil(file)
    before = _state(work)
    result, told = "works", ""
    try:
        (_import if case.family == "osm" else _drive)(theirs, work / "run", abs(case.number))
    except WcsimError as error:
        told = str(error)
        result, told = ("fault", blame) if (blame := _unclear(told, file)) else ("refused", told)
    except Exception:
        result, told = "fault", "".join(traceback.format_exc().splitlines(keepends=True)[-7:])
    changed = sorted(set(before.items()) ^ set(_state(work).items()))
    left = sorted(str(path.name) for path in Path(tempfile.gettempdir()).iterdir())
    if changed or left:
        result, told = "fault", f"changed {changed[:4]}, left {left[:4]} in the folder for temporary files; {told}"
    return result, told


def _drive(theirs: Path, run: Path, number: int) -> None:
    """What a user does with somebody's scenario: look at it, then drive in it."""
    from tests.support.worlds import follow, quick_config
    from wcsim.bridge.world import World
    from wcsim.towns.checks.check import check_town
    from wcsim.towns.importing.adopt import adopt_scenario
    from wcsim.towns.scenario.town import find_town
    from wcsim.types import SeatSpec
    from wcsim.types.episode import RunPlace

    town = find_town(str(theirs / "base.sumocfg" if number % 2 else theirs))
    if number % 4 == 0:
        check_town(town)
    if number % 4 == 1:
        adopt_scenario(town.sumocfg, "own", run / "own")
    seats = (SeatSpec(),) * (number % 3 > 0)
    with World(town, quick_config(), seats, number, RunPlace(folder=run)) as world:
        for _ in range(TICKS if seats else 5 * TICKS):
            follow(world)


def _import(theirs: Path, run: Path, number: int) -> None:
    from wcsim.towns.importing.importer import ImportOrder, import_town

    traffic = float(number % 4 == 0)
    order = ImportOrder(map_file=theirs / "base.osm", name="own", split="train", out=run / "own", traffic=traffic)
    try:
        import_town(order)
    except WcsimError:
        assert not any(run.iterdir() if run.is_dir() else ()), f"left {sorted(run.iterdir())}"
        raise
    assert [path.name for path in run.iterdir()] == ["own"], f"left {sorted(run.iterdir())}"


def _unclear(told: str, file: Path) -> str:
    """What is wrong with a message, or ""."""
    names = (file.name, "base.sumocfg", file.parent.name)
    if not any(name in told for name in names):
        return f"the message names no file: {told}"
    if told.count("\n") >= MOST_LINES or len(told) > MOST_LETTERS:
        return f"the message is too long: {told}"
    if any(ord(letter) < 32 and letter != "\n" for letter in told):
        return f"the message holds control characters: {told!r}"
    return "" if _CURE.search(told) else f"the message does not say what to do: {told}"


def _state(work: Path) -> dict[str, str]:
    """Everything below a folder but what a run may make: path, and digest of the content."""
    found = {}
    for path in sorted(work.rglob("*")):
        name = str(path.relative_to(work))
        if not name.startswith("run"):
            whole = path.is_file() and not path.is_symlink()
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest() if whole else "-"
    return found


# --- many of them ---


def run_batch(cases: Sequence[int | str], folder: Path, limit_s: float = LIMIT_S) -> list[Outcome]:
    """Run mutants in a child; where it dies or hangs, that is the mutant's outcome, and a new child goes on."""
    left, outcomes = [str(case) for case in cases], []
    while left:
        (folder / "report.jsonl").write_text("", encoding="utf-8")
        done, end = _child(left, folder, limit_s)
        outcomes += done
        left = left[len(done) :]
        if left and end:
            case = make_case(int(left.pop(0).partition(":")[0]))
            outcomes.append(
                Outcome(number=case.number, family=case.family, changes=case.changes, result="fault", told=end)
            )
    return outcomes


def _child(cases: Sequence[str], folder: Path, limit_s: float) -> tuple[list[Outcome], str]:
    """Outcomes of the mutants that were finished, and how the child ended, "" for well."""
    words = [sys.executable, "-m", "tests.towns.fuzz.run", str(folder), ",".join(cases)]
    with (folder / "output.txt").open("wb") as output:
        child = subprocess.Popen(words, cwd=ROOT, stdout=output, stderr=subprocess.STDOUT)
        done, since, end = 0, time.monotonic(), ""
        while child.poll() is None:
            if (now := len(_reported(folder))) != done:
                done, since = now, time.monotonic()
            if time.monotonic() - since > limit_s:
                child.kill()
                end = f"hung for {limit_s:.0f} s"
            time.sleep(0.02)
    if child.returncode and not end:
        output_text = (folder / "output.txt").read_text(encoding="utf-8", errors="replace")
        end = f"the process died with {child.returncode}: {output_text.partition('Extension modules')[0][-900:]}"
    return _reported(folder), end


def _reported(folder: Path) -> list[Outcome]:
    lines = (folder / "report.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)
    found = [json.loads(line) for line in lines if line.endswith("\n")]
    return [Outcome(**{**item, "changes": tuple(item["changes"])}) for item in found]


def main() -> int:
    """Run mutants and append their outcomes to report.jsonl in the folder."""
    faulthandler.enable()
    folder, cases = Path(sys.argv[1]).resolve(), [word.partition(":") for word in sys.argv[2].split(",")]
    if not (folder / "base").is_dir():
        write_base(folder / "base")
    tmp = folder / "tmp"
    shutil.rmtree(tmp, ignore_errors=True)
    tmp.mkdir()
    os.environ |= {"XDG_CACHE_HOME": str(folder / "cache"), "TMPDIR": str(tmp)}
    tempfile.tempdir = str(tmp)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    for number, _, fault in cases:
        case, started_s = make_case(int(number)), time.monotonic()
        work = folder / f"case-{number}"
        shutil.rmtree(work, ignore_errors=True)
        with warnings.catch_warnings(), pytest.MonkeyPatch.context() as plant:
            warnings.simplefilter("error")
            _plant(fault, plant)
            result, told = run_case(case, folder / "base", work)
        os.chdir(folder)
        outcome = Outcome(
            number=case.number,
            family=case.family,
            changes=case.changes,
            result=result,
            told=told,
            seconds=round(time.monotonic() - started_s, 3),
        )
        if result != "fault":
            shutil.rmtree(work)
        with (folder / "report.jsonl").open("a", encoding="utf-8") as report:
            report.write(json.dumps(asdict(outcome)) + "\n")
        sys.stdout.write(f"{outcome}\n")
    return 0


def _nameless(net: Path, *, border: Path | None = None) -> None:
    raise TownError("something is wrong")


def _plant(fault: str, plant: pytest.MonkeyPatch) -> None:
    """Break wcsim on purpose, to see that the fuzzer tells."""
    from wcsim.bridge import world
    from wcsim.bridge.sumo import open_scenario

    if fault == "unchecked":  # SUMO meets in this process what was not tried in a child
        plant.setattr(world, "validate_net", lambda net, *, border=None: None)
        plant.setattr(open_scenario, "_try_scenario", lambda town, settings, digest: None)
    elif fault == "leaky":
        real = open_scenario.stage_scenario

        def leaky(*words: object) -> object:
            Path("leak.xml").write_text("x", encoding="utf-8")
            return real(*words)  # type: ignore[arg-type]

        plant.setattr(open_scenario, "stage_scenario", leaky)
    elif fault == "stuck":
        plant.setattr(world, "validate_net", lambda net, *, border=None: time.sleep(60.0))
    elif fault == "blunt":
        plant.setattr(world, "validate_net", lambda net, *, border=None: {}["a"])
    elif fault == "nameless":
        plant.setattr(world, "validate_net", _nameless)
    elif fault:
        raise ValueError(f"no fault {fault!r}")


if __name__ == "__main__":
    raise SystemExit(main())
