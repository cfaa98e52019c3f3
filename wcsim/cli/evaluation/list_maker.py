"""`wcsim test --make-suite`: a list of episodes for any town."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.cli.shared.common import Bounds, Jobs, OptionNote, Writes, parse
from wcsim.cli.shared.consoles import say, stdout_console
from wcsim.cli.shared.stage_bar import told_left
from wcsim.config.suite import MOST_NAME, MOST_SET, name_pattern
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError


@dataclass(frozen=True, slots=True)
class _Named(OptionNote):
    """A name that a list can have, of so many characters at most."""

    most: int

    def check(self, option: str, value: str) -> None:
        """See `OptionNote`."""
        if re.fullmatch(name_pattern(self.most), value):
            return
        proposed = re.sub(r"[^a-z0-9]+", "-", value.lower()).strip("-")[: self.most]
        raise ConfigError(
            f"{option}: got the name {escaped(value, 80)!r}; expected at most {self.most} lower-case letters, digits "
            "and -" + f", such as {proposed}" * bool(proposed)
        )


@dataclass
class _SuiteMakeOptions:
    """Make a list of test episodes for your own towns."""

    make_suite: str
    """A town's name, its folder, or a .sumocfg file; several are separated by commas.
    made:SEED is a generated town (`wcsim town make`)."""
    suite_file: Annotated[Path, tyro.conf.arg(metavar="FILE"), Writes()] = Path("suite.json")
    """The list to write. Its set is named after the file: lower-case letters, digits and - only."""
    name: Annotated[str, _Named(MOST_NAME)] = "own-suite-v1"
    """Name of the list, with its version."""
    free: Annotated[int, Bounds(1, 10_000)] = 8
    """Blocks of free routes for each town, six routes each."""
    attempts: Annotated[int, Bounds(1, 10_000)] = 40
    """Attempts at crossings for each town."""
    hazards: Annotated[int, Bounds(0, 10_000)] = 30
    """Largest number of starts, for each town, from which the user alone crashes."""
    more_ways: Annotated[int, Bounds(0, 10_000)] = 0
    """Further blocks of free routes for each town, only searched for such starts."""
    tight: Annotated[int, Bounds(0, 10_000)] = 5
    """Generated scenes of each family of tight places."""
    tight_from: Annotated[int, Bounds(0, 1_000_000)] = 0
    """Their first seed."""
    forks: Annotated[int, Bounds(0, 1_000_000)] = 1_000_000
    """Episodes of the list whose interventions are judged, evenly spread."""
    jobs: Jobs = 1
    """Parallel processes."""
    seed: int = 0
    """Seed of the list."""


def make_list(words: list[str]) -> int:
    """Make a list and write it."""
    options = parse(_SuiteMakeOptions, words, "test")
    _Named(MOST_SET).check("--suite-file", options.suite_file.stem)
    import tempfile

    from wcsim.agents.evaluation.suite.list_file import asked_towns, suite_of, write_list
    from wcsim.agents.evaluation.suite.make import MakeOrder, make_suite
    from wcsim.agents.evaluation.suite.result_files import TOWNS

    with tempfile.TemporaryDirectory(prefix="wcsim-suite-") as work:
        order = MakeOrder(
            suite=options.name,
            set=options.suite_file.stem,
            seed=options.seed,
            free_blocks=options.free,
            attempts=options.attempts,
            hazards=options.hazards,
            more_ways=options.more_ways,
            tight=range(options.tight_from, options.tight_from + options.tight),
            forks=options.forks,
            jobs=options.jobs,
            work=Path(work),
        )
        towns = asked_towns(options.make_suite, order.work / TOWNS)
        file = make_suite(order, towns, PartTimes(say).say)
    write_list(file, options.suite_file)
    suite, many = suite_of(file), len(file.blocks)
    counted = f"{suite.episodes} episode{'s' * (suite.episodes != 1)} in {many} block{'s' * (many != 1)}"
    stdout_console().print(f"{options.suite_file}: {counted}, {suite.sha256[:12]}", markup=False)
    return 0


class PartTimes:
    """Lines on a work of several parts; those on a part that goes on say how long that part still takes.

    Args:
        put: Prints a line.
        clock: Seconds.
    """

    def __init__(self, put: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._put, self._clock = put, clock
        self._share, self._began_s, self._said_s = 0.0, clock(), clock()

    def say(self, text: str, share: float) -> None:
        """A line, and the share of its part that is done; a part begins where the line before was said."""
        now_s = self._clock()
        if share <= self._share or self._share == 0.0:
            self._began_s = self._said_s
        self._share, self._said_s = share, now_s
        left = told_left(now_s - self._began_s, share)
        self._put(f"{text}, {left}" if left else text)
