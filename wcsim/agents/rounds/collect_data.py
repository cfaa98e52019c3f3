"""Drives segments into a data folder, by whoever has time: what comes back is kept, what is lost driven again."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import torch

from wcsim.agents.danger.policy import DangerPolicy, load_net
from wcsim.agents.rounds.drive_segment import MakeLearned, SegmentOrder, collect, orders_of, require_recordable
from wcsim.agents.runs.data_folder import (
    MANIFEST,
    SEGMENTS,
    DrivingSegmentKey,
    Hashes,
    config_to_plain_settings,
    read_data_manifest,
    read_segment,
    require_same_data_settings,
    segment_path_from_name,
    segment_to_bytes,
    write_data_manifest,
)
from wcsim.agents.runs.policy_file import require_danger_policy_fits
from wcsim.agents.runs.transfer import folder_to_input_files, require_sendable_run, town_to_input_files
from wcsim.config import RunConfig, resolve
from wcsim.core import reading
from wcsim.core.files import (
    is_unfinished_write,
    lock_run_folder,
    sha256_from_file,
    sha256_from_text,
    write_bytes,
    write_json,
)
from wcsim.core.reading import escape, is_file, read_json
from wcsim.errors import PolicyError
from wcsim.server.workers.machines import HERE, LOGS, ToLocalPath, WorkerPoolSettings, WorkInputFiles, WorkPiece
from wcsim.server.workers.scheduler import LEAST_LATE_S, WorkerStatus, WorkScheduler
from wcsim.towns.scenario.town import Town, content_hash, find_town, streets_hash

_LOOK_S = 1.0

Told = Callable[[int, tuple[WorkerStatus, ...]], object]
"""Told how many segments are there and who drives what: once with those from before, and every second from then on."""
ORDERS: Final = "orders.json"  # by seed, what its segments are driven with


class SegmentCrew:
    """Worlds that drive segments into a data folder; a context manager.

    Args:
        config: Of the run.
        data: Folder of the data.
        machines: Where they are.
        logs: Folder of the run, for the logs of a cluster.
    """

    def __init__(self, config: RunConfig, data: Path, machines: WorkerPoolSettings, logs: Path) -> None:
        """Find the workers. Raises ConfigError when there are none, or they could not be sent what they need."""
        if machines.cluster:
            require_sendable_run(config)
        self._folder = data
        self._scheduler = WorkScheduler(machines.open(logs), self._keep, least_late_s=LEAST_LATE_S)
        self._sha256: Hashes = {}  # of what has come, by name

    def __enter__(self) -> SegmentCrew:
        self._scheduler.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._scheduler.__exit__(*exception)

    def ask(self, orders: Sequence[SegmentOrder]) -> None:
        """Begin to drive what is not there yet."""
        self._scheduler.submit(
            [_work(order) for order in orders if not segment_path_from_name(self._folder, order.key.name).is_file()]
        )

    def take(self, orders: Sequence[SegmentOrder], told: Told) -> Hashes:
        """Wait for these segments; their SHA-256 by file name.

        Raises:
            WorkersError: The worlds died too often, or there is no machine left.
            PolicyError: The network cannot drive.
            TownError: A town is missing.
        """
        found: Hashes = {}
        asked = []
        for order in orders:
            name = order.key.name
            kept = "" if name in self._sha256 else self._kept(name)
            if kept:
                found[segment_path_from_name(self._folder, name).name] = kept
            else:
                asked.append(_work(order))
        self._scheduler.submit(asked)
        told(len(found), self._scheduler.workers_now())
        left = {work.key for work in asked}
        while left:
            for name in sorted(self._scheduler.wait(left, _LOOK_S)):
                left.remove(name)
                found[segment_path_from_name(self._folder, name).name] = self._sha256[name]
            told(len(found), self._scheduler.workers_now())
        return found

    def _keep(self, name: str, data: bytes) -> None:
        """In the scheduler's thread: what has come is on the disk before anybody hears of it."""
        write_bytes(segment_path_from_name(self._folder, name), data)
        self._sha256[name] = hashlib.sha256(data).hexdigest()

    def _kept(self, name: str) -> str:
        """The SHA-256 of a segment from before, "" where there is none that is whole."""
        path = segment_path_from_name(self._folder, name)
        if path.is_file():  # one that comes meanwhile is not to be removed
            with contextlib.suppress(PolicyError):
                read_segment(path)
                return sha256_from_file(path)
            path.unlink(missing_ok=True)
        return ""


def _work(order: SegmentOrder) -> WorkPiece:
    return WorkPiece(key=order.key.name, call=_drive_order, piece=order, needs=_needs_of)


def _needs_of(order: SegmentOrder) -> tuple[WorkInputFiles, ...]:
    """What travels with an order: its towns, the network that drives, the user's own wheelchair."""
    policy = (folder_to_input_files(Path(order.policy), order.policy),) if order.policy else ()
    return (*map(town_to_input_files, order.towns), *policy, *_plant_parcels(order.config))


def _plant_parcels(config: RunConfig) -> tuple[WorkInputFiles, ...]:
    """The user's own wheelchair, where the configuration names one."""
    plant = config.chair.plant
    if not plant.endswith(".toml"):
        return ()
    path = Path(plant).absolute()
    return (WorkInputFiles(address=plant, folder=path.parent, names=(path.name,), inner=path.name),)


def _drive_order(order: SegmentOrder, at: ToLocalPath) -> bytes:
    """Drive one piece of work in this process; its segment as a file holds it."""
    torch.set_num_threads(1)
    plant = order.config.chair.plant
    config = resolve(order.config, {"chair": {"plant": at(plant)}} if plant.endswith(".toml") else None)
    here = replace(order, towns=tuple(map(at, order.towns)), policy=order.policy and at(order.policy), config=config)
    make = _learned_of(Path(here.policy), config) if here.policy else None
    return segment_to_bytes(collect(here, make))


def _learned_of(folder: Path, config: RunConfig) -> MakeLearned:
    """The network of a policy folder as a driver of data; one for each chair, by the delay of its commands."""
    net, rule = load_net(folder)
    exploring = rule.model_copy(update={"at_once": 0.0})  # it answers at every tick: it has to meet what it gets wrong

    def make(delay_ticks: int) -> DangerPolicy:
        return DangerPolicy(folder.name, net, config, exploring, delay_ticks)

    return make


@dataclass(frozen=True, slots=True, kw_only=True)
class DataOrder:
    """What to drive."""

    folder: Path
    config: RunConfig
    towns: tuple[str, ...]  # folders or names
    seed: int
    segments: int
    policy: str = ""  # folder of a danger network that drives a share of the episodes
    machines: WorkerPoolSettings = HERE


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
        require_danger_policy_fits(Path(order.policy), escape(order.policy), order.config)
    found = [find_town(name) for name in order.towns]
    order.folder.mkdir(parents=True, exist_ok=True)
    with lock_run_folder(order.folder):  # what it says of itself is read, added to and written back
        return _collected(order, found, told)


def _collected(order: DataOrder, found: Sequence[Town], told: Callable[[int, int], object]) -> str:
    kept: Hashes = {}
    towns: Hashes = {}
    if (order.folder / MANIFEST).is_file():
        file = read_data_manifest(order.folder)
        require_same_data_settings(order.folder, file, order.config)
        kept, towns = dict(file.segments), dict(file.towns)
    elif any(
        path.name not in (SEGMENTS, LOGS, ORDERS) for path in order.folder.iterdir() if not is_unfinished_write(path)
    ):
        raise PolicyError(f"{order.folder} does not hold recorded driving; choose another --out")
    _require_same_order(order, found)
    towns |= {town.name: streets_hash(town) for town in found}
    first = DrivingSegmentKey(run=order.seed, round=0, index=0)
    orders = orders_of(order.config, order.towns, first, order.segments, order.policy)
    last = 0

    def back(done: int, _: object) -> None:
        nonlocal last
        if done > last:
            told(done, len(orders))
        last = done

    with SegmentCrew(order.config, order.folder, order.machines, order.folder) as workers:
        kept |= workers.take(orders, back)
    return write_data_manifest(order.folder, order.config, towns, kept)


def _require_same_order(order: DataOrder, towns: Sequence[Town]) -> None:
    """Note of a seed what its segments are driven with, before any is; raises PolicyError where that was otherwise.

    A segment is known by its seed and number alone: one that is there would be taken for one of another order.
    """
    path, seed = order.folder / ORDERS, str(order.seed)
    begun = read_json(path, reading.ORDERS) if is_file(path) else {}
    driver = folder_to_input_files(Path(order.policy)) if order.policy else None
    policy = [] if driver is None else [[name, sha256_from_file(driver.folder / name)] for name in sorted(driver.names)]
    said = [config_to_plain_settings(order.config), [content_hash(town) for town in towns], policy]
    digest = sha256_from_text(json.dumps(said, sort_keys=True))
    if begun.get(seed, digest) != digest:
        raise PolicyError(
            f"{escape(order.folder)} holds segments of seed {seed} that were driven with other settings, in other "
            "towns or by another policy; expected the same: choose another --seed, or another --out"
        )
    write_json(path, {**begun, seed: digest})
