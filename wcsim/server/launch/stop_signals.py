"""SIGINT and SIGTERM as a wish: counted, so that whoever has processes and files to bring to an end can do it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType, TracebackType
from typing import Any, Self


class StopSignals:
    """While open, SIGINT and SIGTERM are counted and do nothing else. Only in the main thread.

    Afterwards they are ignored if one has come: whoever was asked to end is ending, with a code that says so.
    """

    def __init__(self) -> None:
        self.count = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._hear)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_IGN if self.count else handler)
        self._before.clear()

    def _hear(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.count += 1


@contextmanager
def unheard_by_children() -> Iterator[None]:
    """While open, a process that this thread starts is one that SIGINT does not reach, from its first line on.

    Ctrl-C goes to all processes of a terminal; these are ended by whoever started them.
    """
    resource_tracker.ensure_running()  # which multiprocessing starts first, and lets all signals through after it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
