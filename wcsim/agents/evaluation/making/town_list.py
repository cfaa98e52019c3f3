"""A list for `wcsim test --town`: episodes whose starts and goals the world draws, one world and one chair each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import product

from wcsim.agents.evaluation.making.make import listed_as
from wcsim.config.suite import BlockFile, EpisodeFile, SuiteFile, TownOfSuite
from wcsim.core import seeding
from wcsim.towns.scenario.town import Town, content_hash

_NAMED = 60  # characters of a user, in the name of a part


def town_list(
    towns: Sequence[Town],
    profiles: Sequence[str],
    episodes: int,
    max_steps: int,
    seed: int,
    settings: tuple[str, ...] = (),
) -> SuiteFile:
    """As many episodes for each town and user; a part of the list is one user in one town.

    An episode goes on from goal to goal until a crash or its last step. The first one's world has the seed itself.
    """
    listed = [listed_as(town, None) for town in towns]
    blocks = []
    for (town, name), (place, profile) in product(zip(towns, listed, strict=True), enumerate(profiles)):
        user = re.sub(r"[^A-Za-z0-9.-]+", " ", profile).strip()[-_NAMED:].strip()
        again = f" {place + 1}" if len(profiles) > 1 and user != profile else ""  # two files may be called alike
        for number in range(episodes):
            drawn = EpisodeFile(
                start_m=None,
                heading_rad=0.0,
                goal_m=None,
                profile=profile,
                max_steps=max_steps,
                route_m=0.0,  # what counts is to come through
                reference_s=float(max_steps),
            )
            blocks.append(
                BlockFile(
                    part=f"{_word(town.name)}, {user} user{again}",
                    town=name,
                    seed=seeding.derive(seed, "episode", number) if number else seed % (1 << 31),
                    episodes=(drawn,),
                )
            )
    named = tuple(TownOfSuite(name=name, sha256=content_hash(town)) for town, name in zip(towns, listed, strict=True))
    suite = "-".join(_word(town.name).lower() for town in towns)[:_NAMED].strip("-")
    return SuiteFile(suite=suite, set=f"seed-{seed}", settings=settings, towns=named, forks=0, blocks=tuple(blocks))


def _word(name: str) -> str:
    """A town's name as a list may have it."""
    return re.sub(r"[^A-Za-z0-9-]+", "-", name).strip("-") or "town"
