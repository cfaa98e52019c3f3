"""Collects segments of driving in a data folder; worlds in worker processes drive them.

Each segment is saved as soon as it arrives. One that is lost is driven again.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Self

import torch

from wcsim.agents.danger.policy import DangerPolicy, load_net
from wcsim.agents.rounds.drive_segment import (
    SegmentOrder,
    drive_segment,
    make_segment_orders,
    require_recordable,
)
from wcsim.agents.runs.data_folder import (
    MANIFEST,
    SEGMENTS,
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
from wcsim.agents.runs.transfer import (
    folder_to_input_files,
    require_sendable_run,
    town_to_input_files,
)
from wcsim.config import RunConfig, resolve
from wcsim.core import files, reading
from wcsim.core.reading import escape, is_file, read_json
from wcsim.errors import PolicyError
from wcsim.server.workers.machines import (
    HERE,
    LOGS,
    ToLocalPath,
    WorkerPoolSettings,
    WorkInputFiles,
    WorkPiece,
)
from wcsim.server.workers.scheduler import LEAST_LATE_S, WorkerStatus, WorkScheduler
from wcsim.towns.scenario.town import Town, content_hash, find_town, streets_hash

_ORDERS: Final = "orders.json"  # digest by seed: what its segments are driven with
_POLL_S = 1.0

_Progress = Callable[[int, tuple[WorkerStatus, ...]], object]
"""Gets the number of finished segments and the workers: once at first, then every second."""


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


def collect_data(
    order: DataOrder, on_progress: Callable[[int, int], object] = lambda done, total: None
) -> str:
    """Drive the segments that are missing, and list all segments in `data.json`.

    A folder that holds segments of the same settings is extended, by any seed.

    Args:
        order: What to drive.
        on_progress: Gets the numbers of finished and of ordered segments.

    Returns:
        The SHA-256 of all data in the folder.

    Raises:
        PolicyError: The folder holds other files, data of other settings, or data of this seed from
            other towns or another driver. Or another process collects into it. Or the network was
            trained with other senses or actions.
        ConfigError: The cluster cannot be used, or an input cannot be sent to it; see also
            `require_recordable`.
        WorkersError: Worlds died too often, or there is no machine left.
        TownError: A town is missing.
        DiskFullError: There is no room.
    """
    # 1. Refuse what cannot be driven, before anything is written.
    require_recordable(order.config)
    if order.policy:
        require_danger_policy_fits(Path(order.policy), escape(order.policy), order.config)
    towns = [find_town(name) for name in order.towns]
    order.folder.mkdir(parents=True, exist_ok=True)
    # The folder's own files are read, extended and written back: one process at a time.
    with files.lock_run_folder(order.folder):
        # 2. Read what the folder holds, and note this order in it.
        segments: Hashes = {}
        town_hashes: Hashes = {}
        if (order.folder / MANIFEST).is_file():
            manifest = read_data_manifest(order.folder)
            require_same_data_settings(order.folder, manifest, order.config)
            segments, town_hashes = dict(manifest.segments), dict(manifest.towns)
        elif any(
            path.name not in (SEGMENTS, LOGS, _ORDERS) and not files.is_unfinished_write(path)
            for path in order.folder.iterdir()
        ):
            raise PolicyError(
                f"{order.folder} does not hold recorded driving; choose another --out"
            )
        _note_order(order, towns)
        town_hashes |= {town.name: streets_hash(town) for town in towns}

        # 3. Drive, and list what there is.
        orders = make_segment_orders(
            order.config, order.towns, order.seed, 0, order.segments, order.policy
        )
        last = 0

        def report(done: int, _: object) -> None:
            nonlocal last
            if done > last:
                on_progress(done, len(orders))
            last = done

        with SegmentWorkers(order.config, order.folder, order.machines, order.folder) as workers:
            segments |= workers.wait(orders, report)
        return write_data_manifest(order.folder, order.config, town_hashes, segments)


class SegmentWorkers:
    """Worlds that drive segments into a data folder; a context manager.

    Args:
        config: Of the run.
        data: Folder of the data.
        machines: Where the worlds are.
        logs: Folder of the run, for the logs of a cluster.
    """

    def __init__(
        self, config: RunConfig, data: Path, machines: WorkerPoolSettings, logs: Path
    ) -> None:
        """Find the workers. Raises ConfigError if there are none, or they cannot get the input."""
        if machines.cluster:
            require_sendable_run(config)
        self._folder = data
        self._scheduler = WorkScheduler(machines.open(logs), self._save, least_late_s=LEAST_LATE_S)
        self._sha256: Hashes = {}  # of the segments that were received, by the name of the key

    def __enter__(self) -> Self:
        self._scheduler.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._scheduler.__exit__(*exception)

    def submit(self, orders: Sequence[SegmentOrder]) -> None:
        """Start to drive the segments that are not in the folder yet."""
        self._scheduler.submit(
            [
                _work_piece(order)
                for order in orders
                if not segment_path_from_name(self._folder, order.key.name).is_file()
            ]
        )

    def wait(self, orders: Sequence[SegmentOrder], on_progress: _Progress) -> Hashes:
        """Wait until these segments are in the folder; their SHA-256 by file name.

        Raises:
            WorkersError: The worlds died too often, or there is no machine left.
            PolicyError: The network cannot drive.
            TownError: A town is missing.
        """
        found: Hashes = {}
        missing = []
        for order in orders:
            name = order.key.name
            path = segment_path_from_name(self._folder, name)
            # A file of an earlier process may be damaged; one that arrives meanwhile is not.
            if name not in self._sha256 and path.is_file():
                try:
                    read_segment(path)
                    found[path.name] = files.sha256_from_file(path)
                    continue
                except PolicyError:
                    path.unlink(missing_ok=True)
            missing.append(_work_piece(order))
        self._scheduler.submit(missing)
        on_progress(len(found), self._scheduler.workers_now())
        left = {work.key for work in missing}
        while left:
            for name in sorted(self._scheduler.wait(left, _POLL_S)):
                left.remove(name)
                found[segment_path_from_name(self._folder, name).name] = self._sha256[name]
            on_progress(len(found), self._scheduler.workers_now())
        return found

    def _save(self, name: str, data: bytes) -> None:
        """Save a segment; the scheduler's thread calls this before the piece counts as done."""
        files.write_bytes(segment_path_from_name(self._folder, name), data)
        self._sha256[name] = hashlib.sha256(data).hexdigest()


def _work_piece(order: SegmentOrder) -> WorkPiece:
    return WorkPiece(key=order.key.name, call=_drive_order, piece=order, needs=_input_files)


def _input_files(order: SegmentOrder) -> tuple[WorkInputFiles, ...]:
    """The files that are sent with an order: towns, the network, the user's own wheelchair."""
    sent = [*map(town_to_input_files, order.towns)]
    if order.policy:
        sent.append(folder_to_input_files(Path(order.policy), order.policy))
    plant = order.config.chair.plant
    if plant.endswith(".toml"):
        path = Path(plant).absolute()
        sent.append(
            WorkInputFiles(address=plant, folder=path.parent, names=(path.name,), inner=path.name)
        )
    return tuple(sent)


def _drive_order(order: SegmentOrder, to_local: ToLocalPath) -> bytes:
    """Drive a segment in this process; the content of its file."""
    torch.set_num_threads(1)
    # 1. Paths of this machine.
    plant = order.config.chair.plant
    config = resolve(
        order.config,
        {"chair": {"plant": to_local(plant)}} if plant.endswith(".toml") else None,
    )
    towns = tuple(map(to_local, order.towns))
    order = replace(order, towns=towns, config=config)
    if not order.policy:
        return segment_to_bytes(drive_segment(order, None))

    # 2. The network. It chooses in every tick: it has to meet the states that it gets wrong.
    folder = Path(to_local(order.policy))
    net, rule = load_net(folder)
    rule = rule.model_copy(update={"at_once": 0.0})
    segment = drive_segment(
        order, lambda delay_ticks: DangerPolicy(folder.name, net, config, rule, delay_ticks)
    )
    return segment_to_bytes(segment)


def _note_order(order: DataOrder, towns: Sequence[Town]) -> None:
    """Save a digest of what the segments of a seed are driven with, before any is driven.

    A segment is known by its seed and number alone, so a seed belongs to one order.

    Raises:
        PolicyError: The seed was driven with other settings, in other towns or by another policy.
    """
    path, seed = order.folder / _ORDERS, str(order.seed)
    noted = read_json(path, reading.ORDERS) if is_file(path) else {}
    policy = []
    if order.policy:
        sent = folder_to_input_files(Path(order.policy))
        policy = [[name, files.sha256_from_file(sent.folder / name)] for name in sorted(sent.names)]
    parts = [config_to_plain_settings(order.config), [content_hash(town) for town in towns], policy]
    digest = files.sha256_from_text(json.dumps(parts, sort_keys=True))
    if noted.get(seed, digest) != digest:
        raise PolicyError(
            f"{escape(order.folder)} holds segments of seed {seed} that were driven with other "
            "settings, in other towns or by another policy; expected the same: choose another "
            "--seed, or another --out"
        )
    files.write_json(path, {**noted, seed: digest})
