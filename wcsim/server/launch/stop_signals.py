"""SIGINT and SIGTERM as a wish: counted, so that whoever has processes and files to bring to an end can do it."""

from __future__ import annotations

import signal
import threading
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
