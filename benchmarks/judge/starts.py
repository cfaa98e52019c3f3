"""The list of starts before kerbs, and starts anywhere, driven by one policy with the stick held."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.judge.held_stick import Driven, HeldStreet
from benchmarks.judge.kerb_places import KerbCase, anywhere, kerb_starts
from benchmarks.judge.why import Chain, chain
from wcsim.towns.scenario.town import Town, find_town
from wcsim.types import F64, Joystick

PLANTS: Final = ("rwd", "mwd", "whill")
TICKS: Final = 80
"""Written down before anything was driven: 13 starts for each town and chair, 117 for each policy."""
USUAL: Final = (
    *(KerbCase(angle_deg=angle_deg) for angle_deg in (0.0, 0.0, 20.0, 40.0, 60.0)),
    KerbCase(backwards=True),
    KerbCase(below=False),
    KerbCase(below=False, backwards=True),
)
OTHER_HEIGHT: Final = tuple(USUAL[number] for number in (0, 1, 3, 4, 5))
HEIGHTS_M: Final = {"helsinki": 0.09, "monaco": 0.15, "manhattan": 0.06}
"""Of the kerbs of a town's copy, beside the usual 0.12."""
STICKS: Final = tuple(Joystick(*xy) for xy in ((0.0, 1.0), (0.5, 0.8), (-0.5, 0.8), (0.9, 0.3), (0.0, -1.0)))


@dataclass(frozen=True, slots=True)
class Start:
    """One start and what came of it."""

    policy: str
    town: str
    plant: str
    kerb_m: float
    case: KerbCase | None  # None for one anywhere
    stick: Joystick
    driven: Driven
    chain: Chain | None = None


def with_kerbs(town: Town, height_m: float, work: Path) -> Town:
    """A copy of a town whose kerbs are so high."""
    folder = work / town.name
    shutil.copytree(town.folder, folder, dirs_exist_ok=True)
    toml = folder / "town.toml"
    text = toml.read_text(encoding="utf-8").replace("kerb_height_m = 0.12", f"kerb_height_m = {height_m}")
    toml.write_text(text, encoding="utf-8")
    return find_town(str(folder))


def drive_list(
    policy: str, towns: tuple[str, ...], seed: int, work: Path, scattered: int, why: bool
) -> Iterator[Start]:
    """Drive the list of kerbs, or so many starts anywhere for each town and chair; `why` finds the link that broke."""
    for name in towns:
        lists = {0.12: USUAL, HEIGHTS_M.get(name, 0.15): OTHER_HEIGHT}
        for kerb_m, cases in ({0.12: (None,) * scattered} if scattered else lists).items():
            town = find_town(name) if kerb_m == 0.12 else with_kerbs(find_town(name), kerb_m, work)
            for plant in PLANTS:
                with HeldStreet(town, policy, plant, seed) as street:
                    here, place_W_m = street.world.street, place_of(street, seed)
                    for number, case in enumerate(cases):
                        rng, stick = np.random.default_rng([seed, number]), STICKS[number % len(STICKS)]
                        if case is None:
                            starts = anywhere(here, rng, place_W_m)
                        else:
                            starts, stick = kerb_starts(here, case, place_W_m, rng), case.stick
                        if any(street.begin(start, stick) for start in starts):
                            found = chain(street, TICKS) if why else None
                            driven = street.drive(TICKS) if found is None else found.driven
                            yield Start(policy, name, plant, kerb_m, case, stick, driven, found)


def place_of(street: HeldStreet, seed: int) -> F64:
    """A place of the town, the same for every policy and chair."""
    nodes_W_m = street.world.street.walk.nodes_W_m
    return np.asarray(nodes_W_m[np.random.default_rng(seed).integers(len(nodes_W_m))])
