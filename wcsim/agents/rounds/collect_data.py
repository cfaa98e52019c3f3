"""Drives so many segments into a data folder, for others to learn from."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.agents.collecting.data_folder import (
    MANIFEST,
    SEGMENTS,
    read_manifest,
    require_same_settings,
    told_settings,
    write_manifest,
)
from wcsim.agents.collecting.segment import SegmentKey
from wcsim.agents.collecting.segment_places import orders_of, require_recordable
from wcsim.agents.danger.saved import require_same_senses
from wcsim.agents.rounds.workers import SegmentDrivers
from wcsim.agents.runs.parcels import folder_parcel
from wcsim.config import RunConfig
from wcsim.core.files import is_begun, locked, sha256, sha256_text, write_json
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import PolicyError
from wcsim.server.workers.machines import HERE, LOGS, Machines
from wcsim.towns.scenario.town import Town, content_hash, find_town, streets_hash

ORDERS: Final = "orders.json"  # by seed, what its segments are driven with
_ORDERS: Final = FileKind(what="the orders.json of a data folder", limit_bytes=64 << 20, error=PolicyError)


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

    A folder that holds segments of the same settings is added to: more of the same seed, or those of another one.

    Args:
        order: What to drive.
        told: Called with the number of segments that are there, of how many.

    Raises:
        PolicyError: The folder holds data of other settings, or of this seed from other towns or another driver, or
            another process collects into it; or the network was trained with other senses or actions.
        ConfigError: The cluster cannot be used, or what the order needs does not travel to it; or see
            `require_recordable`.
        WorkersError: Worlds died too often, or there is no machine left.
        TownError: A town is missing.
        DiskFullError: There is no room.
    """
    require_recordable(order.config)
    if order.policy:
        require_same_senses(Path(order.policy), escaped(order.policy), order.config)
    found = [find_town(name) for name in order.towns]
    order.folder.mkdir(parents=True, exist_ok=True)
    with locked(order.folder):  # what it says of itself is read, added to and written back
        return _collected(order, found, told)


def _collected(order: DataOrder, found: Sequence[Town], told: Callable[[int, int], object]) -> str:
    kept: dict[str, str] = {}
    towns: dict[str, str] = {}
    if (order.folder / MANIFEST).is_file():
        file = read_manifest(order.folder)
        require_same_settings(order.folder, file, order.config)
        kept, towns = dict(file.segments), dict(file.towns)
    elif any(path.name not in (SEGMENTS, LOGS, ORDERS) for path in order.folder.iterdir() if not is_begun(path)):
        raise PolicyError(f"{order.folder} does not hold recorded driving; choose another --out")
    _require_same_order(order, found)
    towns |= {town.name: streets_hash(town) for town in found}
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


def _require_same_order(order: DataOrder, towns: Sequence[Town]) -> None:
    """Note of a seed what its segments are driven with, before any is; raises PolicyError where that was otherwise.

    A segment is known by its seed and number alone: one that is there would be taken for one of another order.
    """
    path, seed = order.folder / ORDERS, str(order.seed)
    begun = read_json(path, _ORDERS) if is_file(path) else {}
    driver = folder_parcel(Path(order.policy)) if order.policy else None
    policy = [] if driver is None else [[name, sha256(driver.folder / name)] for name in sorted(driver.names)]
    said = [told_settings(order.config), [content_hash(town) for town in towns], policy]
    digest = sha256_text(json.dumps(said, sort_keys=True))
    if begun.get(seed, digest) != digest:
        raise PolicyError(
            f"{escaped(order.folder)} holds segments of seed {seed} that were driven with other settings, in other "
            "towns or by another policy; expected the same: choose another --seed, or another --out"
        )
    write_json(path, {**begun, seed: digest})
