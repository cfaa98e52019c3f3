"""Worlds in processes of their own: segments are driven in any order, come back by key, and again if they are lost."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Final

import torch

from wcsim.agents.collecting.data_folder import read_segment, segment_path, write_segment
from wcsim.agents.collecting.drive_segment import MakeLearned
from wcsim.agents.collecting.segment import SegmentKey
from wcsim.agents.collecting.segment_places import SegmentOrder
from wcsim.agents.collecting.work import collect
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.danger.saved import load_net
from wcsim.config import RunConfig
from wcsim.core import files
from wcsim.errors import PolicyError

_MOST_DEATHS: Final = 5  # of worlds before the run gives up
_LATE: Final = 5.0  # times the longest segment so far: then it is driven again by another process
_LEAST_LATE_S: Final = 180.0

Done = Callable[[SegmentKey], object]
"""Told of each segment that has come back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentPiece:
    """What is sent to a process."""

    order: SegmentOrder
    folder: Path  # of the data


class Workers:
    """So many processes, a world each; a context manager.

    Args:
        worlds: How many.
        folder: Of the data.
    """

    def __init__(self, worlds: int, folder: Path) -> None:
        self._worlds, self._folder = worlds, folder
        self._pool: ProcessPoolExecutor | None = None
        self._longest_s = _LEAST_LATE_S / _LATE
        self._under_way: dict[SegmentKey, Future[str]] = {}
        self._began_s: dict[SegmentKey, float] = {}

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def ask(self, orders: Sequence[SegmentOrder]) -> None:
        """Begin to drive what is not there yet."""
        for order in orders:
            if not segment_path(self._folder, order.key).is_file():
                self._send(order)

    def take(self, orders: Sequence[SegmentOrder], done: Done = lambda key: None) -> dict[str, str]:
        """Wait for these segments; their SHA-256 by file name.

        Raises:
            PolicyError: The worlds died too often, or the network cannot drive.
            TownError: A town is missing.
        """
        found: dict[str, str] = {}
        left = {order.key: order for order in orders}
        deaths = 0
        while left:
            try:
                for key, sha256 in self._come_back(left):
                    found[segment_path(self._folder, key).name] = sha256
                    del left[key]
                    done(key)
            except BrokenProcessPool:
                deaths += 1
                self.close()
                if deaths >= _MOST_DEATHS:
                    raise PolicyError(
                        f"the processes of the worlds died {deaths} times in a round; expected them to live: is there "
                        "memory left? Go on with --resume"
                    ) from None
        return found

    def close(self) -> None:
        """End the processes at once; what they were at is driven again when it is asked for."""
        if self._pool is not None:
            mine = set(self._pool._processes or ())
            self._pool.shutdown(wait=False, cancel_futures=True)
            for process in active_children():
                if process.pid in mine:
                    process.kill()
            self._pool = None
        self._under_way.clear()
        self._began_s.clear()

    def _send(self, order: SegmentOrder) -> None:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self._worlds, mp_context=get_context("spawn"))
        self._under_way[order.key] = self._pool.submit(drive_piece, SegmentPiece(order=order, folder=self._folder))

    def _come_back(self, left: dict[SegmentKey, SegmentOrder]) -> Iterator[tuple[SegmentKey, str]]:
        """Those of `left` that are there now; asks for the others, and waits a while for one of them."""
        for key, order in list(left.items()):
            future = self._under_way.get(key)
            if future is None and (sha256 := self._kept(key)):
                yield key, sha256
            elif future is None:
                self._send(order)
            elif future.done():
                del self._under_way[key]
                self._longest_s = max(self._longest_s, time.monotonic() - self._began_s.pop(key, time.monotonic()))
                yield key, future.result()
            elif future.running():
                self._began_s.setdefault(key, time.monotonic())
        if self._under_way:
            wait(self._under_way.values(), timeout=0.5, return_when=FIRST_COMPLETED)
        now_s = time.monotonic()
        if any(now_s - began_s > _LATE * self._longest_s for began_s in self._began_s.values()):
            self.close()  # a process that hangs, or was stopped, holds its segment: all that was under way begins anew

    def _kept(self, key: SegmentKey) -> str:
        """The SHA-256 of a segment from before, "" where there is none that is whole."""
        path = segment_path(self._folder, key)
        with contextlib.suppress(PolicyError):
            if path.is_file():
                read_segment(path)
                return files.sha256(path)
        path.unlink(missing_ok=True)
        return ""


def drive_piece(piece: SegmentPiece) -> str:
    """Drive one piece of work in this process and keep its segment; returns the SHA-256."""
    torch.set_num_threads(1)
    order = piece.order
    make = learned_of(Path(order.policy), order.config) if order.policy else None
    return write_segment(segment_path(piece.folder, order.key), collect(order, make))


def learned_of(folder: Path, config: RunConfig) -> MakeLearned:
    """The network of a policy folder as a driver of data; one for each chair, by the delay of its commands."""
    net, rule = load_net(folder, config.learn.network)

    def make(delay_ticks: int) -> DangerPolicy:
        return DangerPolicy(folder.name, net, config, rule, delay_ticks)

    return make
