"""Commands that cure what is wrong with a town, as they can be typed: with the tools' and the files' own places."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from wcsim.towns.scenario import seconds_of
from wcsim.towns.scenario_options import read_configuration
from wcsim.towns.tools import sumo_home
from wcsim.towns.town import Town
from wcsim.towns.xmlio import read_root

HOUR_S = 3600.0


def pave_cure(town: Town) -> str:
    """The command that adds pavements and crossings to a scenario."""
    outside = " --allow-outside" if town.border is None else ""
    return f"wcsim town pave {_path(town.sumocfg)} --out {shlex.quote(town.name + '-paved')}{outside}"


def netedit_cure(town: Town) -> str:
    """The command that opens a town's net to be changed by hand."""
    return f"netedit -s {_path(town.net)}"


def walkers_cure(town: Town) -> str:
    """The command that makes walkers for the scenario's own time, an hour where it names no end.

    Raises:
        TownError: the scenario's begin or end is no time.
    """
    config = read_configuration(town.sumocfg)
    begin_s = seconds_of(config.value("begin") or "0", town.sumocfg)
    end_s = seconds_of(config.value("end") or "-1", town.sumocfg)
    end_s = end_s if end_s > begin_s else begin_s + HOUR_S
    tool = shlex.join([sys.executable, str(sumo_home() / "tools" / "randomTrips.py")])
    return (
        f"{tool} -n {_path(town.net)} --pedestrians --prefix walker -b {begin_s:g} -e {end_s:g} "
        f"-r {_beside(town, 'walkers.rou.xml')} -o {_beside(town, 'walkers.trips.xml')}, "
        f"and add walkers.rou.xml to <route-files> in {_path(town.sumocfg)}"
    )


def grade_cure(town: Town) -> str:
    """The command that flattens a town's steepest streets."""
    return (
        f"netconvert -s {_path(town.net)} --geometry.max-grade 12 --geometry.max-grade.fix "
        f"-o {_beside(town, 'better.net.xml')}, and name better.net.xml in {_path(town.sumocfg)}"
    )


def routes_cure(town: Town, name: str = "better.rou.xml") -> str:
    """The command that routes a town's demand again and drops what finds no way."""
    routes = ",".join(str(path.absolute()) for path in town.routes) or "DEMAND"
    types = ",".join(str(path.absolute()) for path in town.additional if has_types(path))
    more = f" -a {shlex.quote(types)}" if types else ""
    return (
        f"duarouter -n {_path(town.net)} -r {shlex.quote(routes)}{more} --ignore-errors -o {_beside(town, name)}, "
        f"and name {name} in {_path(town.sumocfg)}"
    )


def has_types(path: Path) -> bool:
    """Whether an additional file holds types of vehicles, which a demand needs to be routed."""
    return any(element.tag in ("vType", "vTypeDistribution") for element in read_root(path))


def _beside(town: Town, name: str) -> str:
    return _path(town.sumocfg.with_name(name))


def _path(path: Path) -> str:
    return shlex.quote(str(path.resolve()))
