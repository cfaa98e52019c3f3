"""A trace as a film: everybody's places as they were written down; nothing is driven again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.bridge.replay.replayed import town_of_folder
from wcsim.config import ChairConfig
from wcsim.core.reading import escaped
from wcsim.drive.playing.film_states import FilmAbout, FilmChair, FilmFrame, FilmLine, Said, bodies_of
from wcsim.errors import ConfigError, TownError
from wcsim.log.reader import read_states
from wcsim.log.records import Header, WorldState
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import find_scene
from wcsim.types import Outline
from wcsim.view.filming import SIGHT_M

NOT_IN_TRACES: Final = (
    "Sensors: a trace holds positions only, so there is no picture of the chair's camera.",
    "The user's stick, so there is no KPI 1 and no intervention.",
    "Crashes, arrivals and routes. A chair that jumps has started another episode.",
    "Traffic signals, brake lights and vehicle models.",
)

_EAST: Final = [0.0, 0.0, 0.0, 1.0]  # for no turn at all, which somebody may have written into a file


def state_film(path: Path, epoch: int | None = None, town: str = "") -> Iterator[Said]:
    """A trace from its first tick to its last.

    Args:
        path: The file.
        epoch: Which one; all when None.
        town: Name or folder of its town; "" for the one that the trace names.

    Raises:
        JournalError: It is no trace.
        TownError: The town is not there, or another one.
        ConfigError: There is no chair in it.
    """
    header, records = read_states(path)
    chosen = [record for record in records if epoch in (None, record.epoch) and len(record.plants)]
    if not chosen:
        raise ConfigError(f"{escaped(path)}: has no wheelchair to follow; expected a run with --chairs")
    place = _town(header, town)
    yield FilmAbout(
        title=f"trace of {place.name}, seed {header.seed}",
        town=place.address,
        tick_s=header.tick_s,
        unknown=list(NOT_IN_TRACES),
        ticks=len(chosen),
    )
    outline = _outline(header)
    for record in chosen:
        yield _frame(record, outline)
    yield FilmLine(kind="end", told="The whole trace is loaded.")


def _town(header: Header, name: str) -> Town:
    """The town of a trace. Raises TownError when it is not there, or has its origin elsewhere."""
    try:
        town = _town_or_scene(name or header.town)
    except TownError as error:
        if name:
            raise
        raise TownError(f"the trace is of a town {escaped(header.town, 80)!r}: {error}; name it with --town") from None
    if tuple(town.file.origin_m) != tuple(header.origin_m):
        raise TownError(
            f"the trace has its origin at {header.origin_m}, {town.name} at {town.file.origin_m}; expected the town "
            "that it was recorded in: name it with --town"
        )
    return town


def _town_or_scene(name: str) -> Town:
    try:
        return find_town(name)
    except TownError as no_town:
        try:
            scene = find_scene(name)
        except TownError:
            raise no_town from None
    return town_of_folder(scene)  # what is wrong with a scene that is there is its own fault, and told


def _outline(header: Header) -> Outline:
    usual = plant_spec(ChairConfig()).outline
    length_m, middle_x_m = header.chair_box_m or (usual.length_m, usual.middle_x_m)
    return replace(usual, length_m=length_m, middle_x_m=middle_x_m)


def _frame(record: WorldState, outline: Outline) -> FilmFrame:
    """A state, with those that are in sight of a chair."""
    gaps_m = np.hypot(*np.moveaxis(record.actors[:, None, :2] - record.plants[None, :, :2], -1, 0)).min(axis=1)
    near = np.flatnonzero(gaps_m < SIGHT_M).tolist() if record.bodies else []
    bodies = [record.bodies[number] for number in near]
    rows = [(*record.actors[number], *record.bodies[number].size_lwh_m) for number in near]
    return FilmFrame(
        epoch=record.epoch,
        tick=record.tick,
        time_s=record.time_s,
        bodies=bodies_of(bodies),
        rows=np.array(rows, "<f4").tobytes(),
        chairs=[
            FilmChair(
                seat=seat,
                p_WB_m=plant[:3],
                q_WB=plant[3:7] if any(plant[3:7]) else _EAST,
                outline=outline,
                speed_mps=plant[7],
                commanded=(given[0], given[1]),
            )
            for seat, plant, given in zip(
                record.seats or range(len(record.plants)), record.plants.tolist(), record.commands.tolist(), strict=True
            )
        ],
    )
