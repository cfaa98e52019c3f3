"""A trial run of a new town's demand, to find walking ways on which people get stuck.

Where SUMO's pavements are pinched, people block each other for minutes, and with them the cars that wait for them.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from wcsim.errors import SumoError
from wcsim.towns.importing.demand import Way
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import write_gzip

TRIAL_S = 600
ROUNDS = 2
_JAMMED = re.compile(r"Person 'walkers\.\d+\.(\d+)\.\d+' is jammed")


def write_tried(sumocfg: Path, ways: tuple[Way, ...], text_of: Callable[[tuple[Way, ...]], str]) -> None:
    """Write the route file of a town's folder, without the walking ways on which people get stuck.

    Args:
        sumocfg: The town's, which names <its stem>.rou.xml.gz.
        ways: All ways.
        text_of: The route file's text for some of them.
    """
    for trials_left in reversed(range(ROUNDS + 1)):
        write_gzip(sumocfg.with_suffix(".rou.xml.gz"), text_of(ways).encode())
        stuck = _stuck_ways(sumocfg, ways) if trials_left and ways else ()
        if not stuck:
            return
        ways = tuple(way for way in ways if way not in stuck)


def _stuck_ways(sumocfg: Path, ways: tuple[Way, ...]) -> tuple[Way, ...]:
    """The walking ways on which somebody got stuck within a trial of TRIAL_S; none when the trial fails.

    A trial that fails says nothing about ways; the town is then opened as it is, and `check_town` says what is wrong.
    """
    options = ["-c", sumocfg.name, "--end", str(TRIAL_S), "--no-step-log"]
    try:
        run = run_tool("sumo", options, sumocfg.parent, Limits(wall_s=300.0))
    except SumoError:
        return ()
    if run.died:  # at a limit, so what it printed depends on the machine's speed
        return ()
    walking = [way for way in ways if way.traffic.walks]
    numbers = sorted({int(text) for text in _JAMMED.findall(run.output)})
    return tuple(walking[number] for number in numbers if number < len(walking))
