"""Drives so many segments into a data folder, for others to learn from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from wcsim.agents.collecting.data_folder import (
    MANIFEST,
    SEGMENTS,
    read_manifest,
    require_same_settings,
    write_manifest,
)
from wcsim.agents.collecting.segment import SegmentKey
from wcsim.agents.collecting.segment_places import orders_of
from wcsim.agents.rounds.workers import SegmentDrivers
from wcsim.config import RunConfig
from wcsim.errors import PolicyError
from wcsim.server.workers.machines import HERE, LOGS, Machines
from wcsim.towns.scenario.town import find_town, streets_hash


@dataclass(frozen=True, slots=True, kw_only=True)
class DataOrder:
    """What to drive."""

    folder: Path
    config: RunConfig
    towns: tuple[str, ...]  # folders or names
    seed: int
    segments: int
    policy: str = ""  # folder of a danger network that drives a share of the episodes
    machines: Machines = HERE


def collect_data(order: DataOrder, told: Callable[[int, int], object] = lambda done, of: None) -> str:
    """Drive what is not there yet, and say in `data.json` what is; the SHA-256 of all.

    A folder that holds segments of the same settings is added to.

    Args:
        order: What to drive.
        told: Called with the number of segments that are there, of how many.

    Raises:
        PolicyError: The folder holds data of other settings.
        ConfigError: The cluster cannot be used, or what the order needs does not travel to it.
        WorkersError: Worlds died too often, or there is no machine left.
        TownError: A town is missing.
        DiskFullError: There is no room.
    """
    kept: dict[str, str] = {}
    towns: dict[str, str] = {}
    if (order.folder / MANIFEST).is_file():
        file = read_manifest(order.folder)
        require_same_settings(order.folder, file, order.config)
        kept, towns = dict(file.segments), dict(file.towns)
    elif order.folder.is_dir() and any(path.name not in (SEGMENTS, LOGS) for path in order.folder.iterdir()):
        raise PolicyError(f"{order.folder} holds something else than recorded driving; choose another --out")
    for name in order.towns:
        town = find_town(name)
        towns[town.name] = streets_hash(town)
    first = SegmentKey(run=order.seed, round=0, index=0)
    orders = orders_of(order.config, order.towns, first, order.segments, order.policy)
    done = 0

    def back(_: SegmentKey) -> None:
        nonlocal done
        done += 1
        told(done, len(orders))

    drivers = SegmentDrivers(machines=order.machines, data=order.folder, logs=order.folder, config=order.config)
    with drivers.open() as workers:
        kept |= workers.take(orders, back)
    return write_manifest(order.folder, order.config, towns, kept)
