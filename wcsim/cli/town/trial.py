"""The check of a town with its last question: whether SUMO opens and runs the whole scenario."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

from wcsim.config import load_run_config
from wcsim.errors import TownError
from wcsim.towns.scenario.town import Town

if TYPE_CHECKING:
    from wcsim.towns.checks.check import TownReport


def checked(town: Town, share: float | None = None, told: Callable[[str], None] = lambda stage: None) -> TownReport:
    """`check_town`, and SUMO's own refusal among the faults; `told` hears the stage. Raises TownError as that does."""
    from wcsim.towns.checks.check import check_town  # loads what builds streets, which --help must not

    told("checking the town")
    report = check_town(town, share)
    told("letting SUMO run its first steps")
    try:
        try_town(town)
    except TownError as refused:
        return replace(report, faults=(*report.faults, str(refused)))
    return report


def try_town(town: Town) -> None:
    """Let SUMO run the first steps of what a world would run, in a folder that goes; once for each state of its files.

    Raises TownError with SUMO's own words when it cannot.
    """
    from wcsim.bridge.sumo.open_scenario import open_scenario  # loads libsumo, which --help must not
    from wcsim.bridge.sumo.run_place import RunPlace
    from wcsim.towns.scenario.overrides import settings_of

    with ExitStack() as held:
        open_scenario(town, settings_of(load_run_config("quick"), 1), RunPlace(), held)
