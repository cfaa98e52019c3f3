"""Segments by their keys: driven by whoever has time, kept as soon as they are there, driven again if they are lost."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from wcsim.agents.collecting.data_folder import packed_segment, read_segment, segment_path
from wcsim.agents.collecting.drive_segment import MakeLearned, collect
from wcsim.agents.collecting.segment import SegmentKey
from wcsim.agents.collecting.segment_places import SegmentOrder
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.danger.rule import exploring
from wcsim.agents.danger.saved import load_net
from wcsim.agents.runs.parcels import folder_parcel, plant_at, plant_parcels, require_travels, town_parcel
from wcsim.config import RunConfig, resolve
from wcsim.core import files
from wcsim.errors import PolicyError
from wcsim.server.workers.crew import LEAST_LATE_S, Crew, WorkerNow
from wcsim.server.workers.machines import Machines
from wcsim.server.workers.worker_api import At, Parcel, Work

_LOOK_S = 1.0

Done = Callable[[SegmentKey], object]
"""Told of each segment that has come back."""
Watch = Callable[[tuple[WorkerNow, ...]], object]
"""Told who drives what: once when all that was there before has been told of, and every second from then on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentDrivers:
    """What a crew that drives segments is made of."""

    machines: Machines
    data: Path  # folder of the data
    logs: Path  # folder of the run, for the logs of a cluster
    config: RunConfig

    def open(self) -> _SegmentCrew:
        """Find the workers. Raises ConfigError when there are none, or they could not be sent what they need."""
        if self.machines.cluster:
            require_travels(self.config, own_code=(self.config.learn.network,))
        return _SegmentCrew(self)


class _SegmentCrew:
    """Worlds that drive segments into a data folder; a context manager."""

    def __init__(self, drivers: SegmentDrivers) -> None:
        self._folder = drivers.data
        self._crew = Crew(drivers.machines.open(drivers.logs), self._keep, least_late_s=LEAST_LATE_S)
        self._sha256: dict[str, str] = {}  # of what has come, by key

    def __enter__(self) -> _SegmentCrew:
        self._crew.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._crew.__exit__(*exception)

    def ask(self, orders: Sequence[SegmentOrder]) -> None:
        """Begin to drive what is not there yet."""
        self._crew.ask([_work(order) for order in orders if not self._path(order.key).is_file()])

    def take(
        self, orders: Sequence[SegmentOrder], done: Done = lambda key: None, watch: Watch = lambda now: None
    ) -> dict[str, str]:
        """Wait for these segments; their SHA-256 by file name.

        Raises:
            WorkersError: The worlds died too often, or there is no machine left.
            PolicyError: The network cannot drive.
            TownError: A town is missing.
        """
        found: dict[str, str] = {}
        left = {_work_key(order.key): order.key for order in orders}
        asked = []
        for order in orders:
            word = _work_key(order.key)
            kept = self._kept(order.key) if word not in self._sha256 and self._path(order.key).is_file() else ""
            if kept:
                found[self._path(left.pop(word)).name] = kept
                done(order.key)
            else:
                asked.append(_work(order))
        self._crew.ask(asked)
        watch(self._crew.now())
        while left:
            for word in sorted(self._crew.come(left, _LOOK_S)):
                key = left.pop(word)
                found[self._path(key).name] = self._sha256[word]
                done(key)
            watch(self._crew.now())
        return found

    def _path(self, key: SegmentKey) -> Path:
        return segment_path(self._folder, key)

    def _keep(self, word: str, data: bytes) -> None:
        """In the crew's thread: what has come is on the disk before anybody hears of it."""
        files.write_bytes(self._path(_key_of(word)), data)
        self._sha256[word] = hashlib.sha256(data).hexdigest()

    def _kept(self, key: SegmentKey) -> str:
        """The SHA-256 of a segment from before, "" where there is none that is whole."""
        path = self._path(key)
        with contextlib.suppress(PolicyError):
            read_segment(path)
            return files.sha256(path)
        path.unlink(missing_ok=True)
        return ""


def _work_key(key: SegmentKey) -> str:
    """What a segment is called wherever something is said of it.

    >>> _work_key(SegmentKey(run=3, round=0, index=12))
    '3-000-0012'
    """
    return f"{key.run}-{key.round:03d}-{key.index:04d}"


def _key_of(word: str) -> SegmentKey:
    run, number, index = word.split("-")
    return SegmentKey(run=int(run), round=int(number), index=int(index))


def _work(order: SegmentOrder) -> Work:
    return Work(key=_work_key(order.key), call=_drive_order, piece=order, needs=_needs_of)


def _needs_of(order: SegmentOrder) -> tuple[Parcel, ...]:
    """What travels with an order: its towns, the network that drives, the user's own wheelchair."""
    policy = (folder_parcel(Path(order.policy), order.policy),) if order.policy else ()
    return (*map(town_parcel, order.towns), *policy, *plant_parcels(order.config))


def _drive_order(order: SegmentOrder, at: At) -> bytes:
    """Drive one piece of work in this process; its segment as a file holds it."""
    torch.set_num_threads(1)
    config = resolve(order.config, plant_at(order.config, at))
    here = replace(order, towns=tuple(map(at, order.towns)), policy=order.policy and at(order.policy), config=config)
    make = _learned_of(Path(here.policy), config) if here.policy else None
    return packed_segment(collect(here, make))


def _learned_of(folder: Path, config: RunConfig) -> MakeLearned:
    """The network of a policy folder as a driver of data; one for each chair, by the delay of its commands."""
    net, rule = load_net(folder, config.learn.network)

    def make(delay_ticks: int) -> DangerPolicy:
        return DangerPolicy(folder.name, net, config, exploring(rule), delay_ticks)

    return make
