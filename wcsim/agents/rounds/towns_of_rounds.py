"""The towns that data is driven in: the run's own, those of the configuration, and some that are drawn for the run."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.errors import TownError
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.making.maker import make_town
from wcsim.towns.making.wishes import Wishes
from wcsim.towns.scenario.town import Town, find_town, open_town

TOWNS: Final = "towns"


def towns_of(
    own: Town,
    more: Collection[str],
    config: RunConfig,
    folder: Path,
    seed: int,
    stage: Callable[[str], object] = lambda told: None,
) -> tuple[str, ...]:
    """Folders or names of all towns, the run's own first.

    Args:
        own: The run's.
        more: Words for those that take turns with it.
        config: Of the run.
        folder: Of the run; towns that are drawn lie in it, and are made once, where anybody is going to drive in them.
        seed: Of the run.
        stage: Told what is made.

    Raises:
        TownError: A town is missing, is meant for tests, or cannot be made.
        SumoError: One of SUMO's tools failed.
    """
    listed = [find_town(name) for name in config.collect.towns]
    for town in listed:
        if town.split == "test":
            raise TownError(f"collect.towns: {town.name} is a test town; expected training towns")
    others = [*map(asked_town, more), *listed]
    made = config.collect.made_towns if config.collect.segments else 0
    for number in range(made):
        drawn = seeding.derive(seed, "collect", "town", number)
        out = folder / TOWNS / f"made-{drawn}"
        if not out.is_dir():
            stage(f"generating town {number + 1} of {made}")
            make_town(out, drawn, Wishes())
        others.append(open_town(out))
    return tuple(str(town.address) for town in (own, *others))
