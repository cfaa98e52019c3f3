"""Where a world runs its scenario: filtered copies, tried out in a child before SUMO opens them.

A world and those who order one both know `RunPlace`, so nothing here loads a simulator.
"""

import logging
import os
import sys
from contextlib import ExitStack, suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

from wcsim.bridge.sumo.warm_state import state_file
from wcsim.config.world import JUPEDSIM
from wcsim.core.files import sha256_from_text
from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import SumoError, TownError
from wcsim.towns.cache.folder import cache_folder, write_verdict
from wcsim.towns.scenario.options import read_configuration
from wcsim.towns.scenario.overrides import PEOPLE, Settings
from wcsim.towns.scenario.stage import Scenario, stage_scenario
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.tools import Limits, ToolRun, run_child, run_tool
from wcsim.types.episode import RunPlace

log = logging.getLogger("wcsim.bridge.sumo.open_scenario")

_SUMO_FOLDER = "sumo"
_TRIAL_STEPS = 50
# It dies when somebody departs to a place off its one connected area, however late.
_JUPEDSIM_TRIAL_S = 300.0
_STARTED_ANEW = "begun anew"  # the child's message when its first run is over
_LIMITS = Limits(wall_s=50.0, cpu_s=50, memory_bytes=16 << 30, file_bytes=1 << 30)
# Of people by JuPedSim, half a minute goes into the area of a whole town; of a warm-up, all of it.
_LONG_LIMITS = replace(_LIMITS, wall_s=600.0, cpu_s=300)
_SEARCH_LIMITS = Limits(wall_s=10.0, cpu_s=10, memory_bytes=16 << 30, file_bytes=1 << 30)
_LOADS, _FAILS = b"loads\n", b"fails\n"  # verdicts on states
_LISTS = ("additional-files", "route-files")  # in the order in which SUMO reads them


def open_scenario(town: Town, settings: Settings, place: RunPlace, held: ExitStack) -> Scenario:
    """The scenario ready for SUMO, in `place` or in a temporary folder that `held` removes.

    Raises:
        TownError: a file is missing or broken, or SUMO refuses the scenario or dies of it.
    """
    if place.folder is None:
        folder = held.enter_context(create_temporary_folder())
    else:
        # What an earlier sitting of the run left there stays.
        folder, number = place.folder / _SUMO_FOLDER, 1
        while folder.is_dir() and any(folder.iterdir()):
            number += 1
            folder = place.folder / f"{_SUMO_FOLDER}-{number}"
    scenario = stage_scenario(town, settings, folder, place.outputs)
    for note in scenario.notes:
        log.info("%s: %s", town.name, note)
    for row in scenario.overrides:
        author = row.author or "the default"
        log.info("%s: %s is %s, not %s: %s", town.name, row.option, row.wcsim, author, row.why)
    # The tests drive what wcsim writes itself; a trial takes longer than all else of a scene.
    if not town.drafted:
        _try_scenario(town, settings, scenario.digest)
    return scenario


def _try_scenario(town: Town, settings: Settings, digest: str) -> None:
    """Run the scenario's first steps in a child, once for each state of its files.

    Raises:
        TownError: SUMO refuses the scenario, dies of it or takes too long.
    """
    # With SUMO's version: another one may die of what this one runs.
    state = f"{digest} {version('libsumo')} {_TRIAL_STEPS} {_JUPEDSIM_TRIAL_S} {_STARTED_ANEW}"
    key = sha256_from_text(state)[:32]
    verdict = cache_folder() / f"scenario-{key}.ok"
    if verdict.is_file():
        return
    with create_temporary_folder() as work:
        # One seed for all, as the verdict is on the files and holds for every seed.
        staged = stage_scenario(town, replace(settings, seed=1), work)
        by_jupedsim = read_configuration(staged.sumocfg).value(PEOPLE) == JUPEDSIM
        steps = _TRIAL_STEPS
        if by_jupedsim:
            steps = max(steps, round(_JUPEDSIM_TRIAL_S / settings.world.tick_s))
        limits = _LONG_LIMITS if by_jupedsim else _LIMITS
        try:
            run = _run_steps(staged, settings, steps, limits)
        except SumoError as error:
            raise TownError(
                f"{town.sumocfg}: SUMO could not run its first {steps} steps ({error}); "
                "reduce the load: a smaller scale, fewer vehicles and persons, "
                "wider stripes of pedestrians"
            ) from None
        if run.died and by_jupedsim:
            raise TownError(
                f"{town.sumocfg}: SUMO crashes here when people walk by JuPedSim ({run.reason()}); "
                "known cause: a walk that leaves the one connected area of pavements; "
                "expected pedestrian.model striping, "
                "which is world.street=usual where the scenario says nothing"
            )
        culprit = _culprit(town, staged, settings) if run.returncode else town.sumocfg
    if run.died and _STARTED_ANEW in run.output:
        raise TownError(
            f"{town.sumocfg}: SUMO crashes when this scenario starts again in one process "
            f"({run.reason()}); a known cause is devices that send (btsender): "
            "remove them here and from the routes"
        )
    if run.returncode:
        raise TownError(
            f"{culprit}: SUMO cannot run this scenario ({run.reason()}); correct the file; "
            f"SUMO alone: sumo -c {town.sumocfg}"
        )
    write_verdict(verdict)


def try_state(town: Town, settings: Settings, scenario: Scenario, warmup_s: float) -> bool:
    """Whether a world can load this scenario's warmed traffic from a state; tried in a child.

    JuPedSim's people are in no state, and SUMO may die of a device that it cannot save.

    Raises:
        TownError: the warm-up takes too long.
    """
    if read_configuration(scenario.sumocfg).value(PEOPLE) == JUPEDSIM:
        return False
    state = f"{state_file(scenario.digest, 1, warmup_s).name} {_TRIAL_STEPS}"
    verdict = cache_folder() / f"state-{sha256_from_text(state)[:32]}.ok"
    with suppress(OSError):
        return verdict.read_bytes() == _LOADS
    with create_temporary_folder() as work:
        staged = stage_scenario(town, replace(settings, seed=1), work)
        scale = staged.author_scale * settings.world.demand_scale
        more = repr(warmup_s), staged.digest, repr(scale)
        try:
            run = _run_steps(staged, settings, _TRIAL_STEPS, _LONG_LIMITS, *more)
        except SumoError as error:
            raise TownError(
                f"{town.sumocfg}: SUMO could not warm its traffic up for {warmup_s:g} s ({error}); "
                "reduce world.warmup_s, or the load: a smaller scale, fewer vehicles and persons"
            ) from None
    if run.returncode:
        message = "%s: SUMO cannot load this scenario's state (%s); each world warms it up by ticks"
        log.info(message, town.name, run.reason())
    write_verdict(verdict, _FAILS if run.returncode else _LOADS)
    return run.returncode == 0


def _run_steps(
    staged: Scenario, settings: Settings, steps: int, limits: Limits, *more: str
) -> ToolRun:
    """Run `first_steps` in a child. Raises SumoError: it takes too long."""
    command = [sys.executable, "-m", "wcsim.bridge.sumo.first_steps", str(staged.sumocfg)]
    command += [repr(settings.world.tick_s), str(steps), _STARTED_ANEW, *more]
    # The child has to find the packages that this process found, however it was started.
    env = os.environ | {"PYTHONPATH": os.pathsep.join(item for item in sys.path if item)}
    return run_child("sumo", command, staged.sumocfg.parent, env, limits)


def _culprit(town: Town, staged: Scenario, settings: Settings) -> Path:
    """The first file, in SUMO's order, with which the scenario fails; or the .sumocfg."""
    files = (*town.additional, *town.routes)
    end_s = staged.begin_s + _TRIAL_STEPS * settings.world.tick_s

    def fails(count: int) -> bool:
        words = ["-c", str(_with_fewer(staged.sumocfg, count)), "--end", repr(end_s)]
        try:
            return run_tool("sumo", words, staged.sumocfg.parent, _SEARCH_LIMITS).returncode != 0
        # It takes long.
        except SumoError:
            return True

    if not fails(len(files)):
        return town.sumocfg
    low, high = -1, len(files)  # with `high` files it fails; with `low` it runs
    # More files never mend it: once it fails, it fails with every larger count.
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if fails(middle) else (middle, high)
    return files[high - 1] if high else town.sumocfg


def _with_fewer(staged: Path, count: int) -> Path:
    """A copy beside a staged configuration that names only its first `count` files."""
    tree = ElementTree.parse(staged)  # noqa: S314 - written by this process
    for name in _LISTS:
        for element in tree.iter(name):
            files = element.get("value", "").split(",")
            element.set("value", ",".join(files[:count]))
            count = max(0, count - len(files))
    for topic in tree.getroot():
        for element in [item for item in topic if item.tag in _LISTS and not item.get("value")]:
            topic.remove(element)
    path = staged.with_name(f"fewer-{staged.name}")
    tree.write(path, encoding="utf-8")
    return path
