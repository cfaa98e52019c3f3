"""Signals that end processes: SIGINT and SIGTERM as a wish, and the end of a parent, which the kernel tells its child.

A wish is counted, so that whoever has processes and files to bring to an end can do it. Nothing else of wcsim is
loaded.
"""

from __future__ import annotations

import ctypes
import os
import signal
import threading
import time
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


_PR_SET_PDEATHSIG = 1
_LOOK_S = 1.0
_MOMENT_S = 5.0  # for what ends in good order


def die_with_parent(number: int = signal.SIGTERM) -> None:
    """Have the kernel send this process a signal when the thread that started it ends; to be called first of all.

    Raises OSError when the kernel refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(number), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")


def outlive_parent_by(grace_s: float, code: int, asking: int) -> None:
    """End this process hard, with `code`, when its parent has been gone for so long and it is still there.

    Before that it is sent the signal `asking`, a moment after its parent has gone.
    """

    def watch(parent: int) -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_S)
        time.sleep(_MOMENT_S)
        os.kill(os.getpid(), asking)
        time.sleep(grace_s)
        os._exit(code)

    threading.Thread(target=watch, args=(os.getppid(),), name="parent watch", daemon=True).start()
