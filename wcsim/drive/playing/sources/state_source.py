"""A trace as a film: everybody's places as they were written down; nothing is driven again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.reading import escaped
from wcsim.drive.playing.film_states import FilmAbout, FilmChair, FilmLine, Said
from wcsim.drive.playing.sources.frame_maker import FrameMaker, quaternion
from wcsim.errors import ConfigError, TownError
from wcsim.log.reader import read_states
from wcsim.log.records import Header, WorldState
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.towns.scenario.town import Town, find_town
from wcsim.types import F64, ActorState
from wcsim.view.filming import SIGHT_M

NOT_IN_TRACES: Final = (
    "Sensors: a trace holds positions only, so there is no picture of the chair's camera.",
    "The user's stick, so there is no KPI 1 and no intervention.",
    "Crashes, arrivals and routes. A chair that jumps has started another episode.",
    "Traffic signals, brake lights and vehicle models.",
)


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
    maker, outline = FrameMaker(), _outline(header)
    for record in chosen:
        chairs = _chairs(record, outline)
        places_W_m = record.plants[:, :2]
        yield maker.step(record.epoch, record.tick, record.time_s, _near(record, places_W_m), chairs)
    yield FilmLine(kind="end", told="The whole trace is loaded.")


def _town(header: Header, name: str) -> Town:
    """The town of a trace. Raises TownError when it is not there, or has its origin elsewhere."""
    try:
        town = find_town(name or header.town)
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


def _outline(header: Header) -> tuple[float, float, float, float]:
    usual = plant_spec(ChairConfig()).outline
    length_m, middle_x_m = header.chair_box_m or (usual.length_m, usual.middle_x_m)
    return length_m, usual.width_m, usual.height_m, middle_x_m


def _chairs(record: WorldState, outline: tuple[float, float, float, float]) -> list[FilmChair]:
    seats = record.seats or tuple(range(len(record.plants)))
    found = []
    for seat, plant, given in zip(seats, record.plants.tolist(), record.commands.tolist(), strict=True):
        x_m, y_m, z_m = plant[:3]
        found.append(
            FilmChair(
                seat=seat,
                p_WB_m=(x_m, y_m, z_m),
                q_WB=_turn(plant[3:7]),
                outline=outline,
                speed_mps=plant[7],
                commanded=(given[0], given[1]),
            )
        )
    return found


def _turn(values: Sequence[float]) -> tuple[float, float, float, float]:
    """A turn; none at all, which somebody may have written into a file, is taken for straight east."""
    return quaternion(values) if any(values) else (0.0, 0.0, 0.0, 1.0)


def _near(record: WorldState, places_W_m: F64) -> list[ActorState]:
    """Who is in sight of a chair."""
    if not record.bodies:
        return []
    gaps_m = np.hypot(*np.moveaxis(record.actors[:, None, :2] - places_W_m[None], -1, 0)).min(axis=1)
    return [
        ActorState(
            id=body.id,
            kind=body.kind,
            p_W_m=row[:3],
            yaw_rad=float(row[3]),
            pitch_rad=float(row[4]),
            v_W_mps=row[5:8],
            size_lwh_m=body.size_lwh_m,
            piece=body.piece,
        )
        for body, row, gap_m in zip(record.bodies, record.actors, gaps_m, strict=True)
        if gap_m < SIGHT_M
    ]
