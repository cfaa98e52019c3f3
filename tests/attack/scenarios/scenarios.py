"""Attack by scenarios: what they name to be written or read, with and without starting SUMO."""

import faulthandler
import os
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from tests.attack.outcomes import Case, Outcome
from tests.attack.scenarios.oracle import escapes
from tests.attack.scenarios.parts import Theirs, furnish, write_scenario
from tests.attack.scenarios.twists import cleared
from tests.towns.made import hostile
from wcsim.core.seeding import make_rng
from wcsim.errors import SumoError, WcsimError
from wcsim.towns.importing.adopt import _files_of
from wcsim.towns.scenario.options import read_configuration
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scenario.stage import stage_scenario
from wcsim.towns.scenario.town import open_town
from wcsim.towns.scene_folders.build import build_scene, find_scene
from wcsim.towns.sumo.xml_io import read_bytes

SETTINGS = Settings(seed=5)
SOUND_EVERY = 40  # one of so many is a sound scenario, which must be taken
STEPS = 25
LIMIT_S = 60.0
TINY_NET = b"""<net><location netOffset="0,0" convBoundary="0,0,9,9" origBoundary="0,0,9,9" projParameter="!"/>
<edge id="e" from="a" to="b"><lane id="e_0" index="0" speed="9" length="9" shape="0,0 9,0"/></edge>
<junction id="a" x="0" y="0" type="dead_end"/><junction id="b" x="9" y="0" type="dead_end"/></net>"""


class NotTakenError(Exception):
    """A sound scenario was refused, or something was found that says no outcome."""


def cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """Scenarios on their way through wcsim's filter; SUMO is not started."""
    for number in range(count):
        yield Case(area="scenarios", name=f"scenario {number} of {seed}", feed=partial(_filter, number, seed, work))


def started(count: int, seed: int, work: Path) -> Iterator[Case]:
    """Scenarios on a net that SUMO can open, which it runs if the filter lets them pass, each in a child."""
    town = build_scene(find_scene("pedestrian-crossing"), work / "town")[0]
    net, lane = read_bytes(town.net), hostile.lane_of(town)
    cleared(work / "town")
    for number in range(count):
        name = f"started scenario {number} of {seed}"
        feed = partial(_start, number, seed, work, net, lane)
        yield Case(area="scenarios, SUMO started", name=name, feed=feed, limit_s=LIMIT_S)


def _filter(number: int, seed: int, work: Path) -> bool:
    with _place(work / f"filtered-{number}") as place:
        theirs = _made(number, seed, place, TINY_NET, "e_0")
        before = _state(place)
        try:
            staged = stage_scenario(open_town(theirs.folder / "a.sumocfg"), SETTINGS, place / "run")
        except WcsimError as error:
            if number % SOUND_EVERY == 0:
                raise NotTakenError(str(error)) from error
            if _state(place) != before:
                raise NotTakenError(f"refused, and left {sorted(set(_state(place)) ^ set(before))}") from error
            raise
        found = [*escapes(staged.sumocfg, place / "run", theirs.folder), *_taken_along(theirs)]
        if _state(place) != before:
            found.append(f"changed {sorted(set(_state(place).items()) ^ set(before.items()))}")
        if found:
            raise NotTakenError(f"{theirs.done}: {found}")
        return True


def _taken_along(theirs: Theirs) -> list[str]:
    """What a copy of the scenario would take along that is not its author's."""
    try:
        files = _files_of(read_configuration(theirs.folder / "a.sumocfg"), theirs.folder)
    except WcsimError:
        return []
    inside = theirs.folder.resolve()
    return [f"{path} is taken along" for path in files if not path.resolve().is_relative_to(inside)]


def _start(number: int, seed: int, work: Path, net: bytes, lane: str) -> Outcome | bool:
    with _place(work / f"started-{number}") as place:
        theirs = _made(number, seed, place, net, lane)
        (place / "empty").mkdir()
        before = _state(place)
        code, told = _in_child(place, theirs.folder / "a.sumocfg")
        after = _state(place)
        if after != before:
            changed = sorted(set(after.items()) ^ set(before.items()))
            sys.stderr.write(f"{number}: {theirs.done}: {changed}\n")
            return Outcome.OUTSIDE
        if code == 2:
            raise WcsimError(told)
        if code == 3 or (code and number % SOUND_EVERY == 0):
            raise NotTakenError(f"{code}: {told}")
        return Outcome.HUNG if code == -signal.SIGKILL else True  # other signals end the child in which wcsim tries it


def _made(number: int, seed: int, place: Path, net: bytes, lane: str) -> Theirs:
    folder, canary = place / "theirs", place / "canary"
    furnish(folder, canary)
    theirs = Theirs(folder=folder, canary=canary, rng=make_rng(seed, "scenarios", number), lane=lane)
    write_scenario(theirs, net, hostile=number % SOUND_EVERY != 0, devices=True)
    return theirs


@contextmanager
def _place(folder: Path) -> Iterator[Path]:
    """A folder for one case, which is what ${HOME} of a scenario leads to; gone afterwards."""
    home = os.environ.get("HOME", "")
    folder = folder.resolve()
    folder.mkdir(parents=True)
    os.environ["HOME"] = str(folder / "canary")
    try:
        yield folder
    finally:
        os.environ["HOME"] = home
        shutil.rmtree(folder)


def _state(place: Path) -> dict[str, tuple[int, int]]:
    """Size and time of change of everything in a case's folder that is not the run's."""
    found = {}
    for folder, folders, files in os.walk(place):
        if folder == str(place) and "run" in folders:
            folders.remove("run")
        for name in (*folders, *files):
            path = os.path.join(folder, name)  # noqa: PTH118 - thousands of times a minute
            told = os.lstat(path)
            found[path] = (told.st_size, told.st_mtime_ns) if name in files else (0, 0)
    return found


def _in_child(place: Path, sumocfg: Path) -> tuple[int, str]:
    """Exit code, or the negative signal, of a child that runs the scenario, and its words; 2: refused, 3: traceback."""
    log = place.with_name(f"{place.name}.log")
    child = os.fork()
    if not child:
        code = 3
        try:
            code = _run(place, sumocfg, log)
        except BaseException:
            log.write_text(traceback.format_exc(), encoding="utf-8")
        finally:
            os._exit(code)
    try:
        return _ended(child), log.read_text(encoding="utf-8") if log.exists() else ""
    finally:
        log.unlink(missing_ok=True)


def _run(place: Path, sumocfg: Path, log: Path) -> int:
    from wcsim.bridge.sumo.session import SumoOptions, SumoSession

    os.chdir(place / "empty")
    faulthandler.disable()  # SUMO dies of some, and the child in which wcsim tries it first is there for that
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sink = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(sink, descriptor)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 26, 1 << 26))
    resource.setrlimit(resource.RLIMIT_CPU, (30, 30))
    try:
        staged = stage_scenario(open_town(sumocfg), SETTINGS, place / "run")
        options = SumoOptions(sumocfg=staged.sumocfg, origin_m=(0.0, 0.0), settings=SETTINGS)
        with SumoSession(options) as session:
            for _ in range(STEPS):
                session.step()
            session.rebuild(seed=2)
            session.step()
    except SumoError as error:  # it was let in, and SUMO itself refuses it
        log.write_text(str(error), encoding="utf-8")
        return 4
    except WcsimError as error:
        log.write_text(str(error), encoding="utf-8")
        return 2
    return 0


def _ended(child: int) -> int:
    until_s = time.monotonic() + LIMIT_S
    while time.monotonic() < until_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
