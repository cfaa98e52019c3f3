"""A few threads that draw pictures side by side: compiled code lets the others run meanwhile."""

import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait

Work = Callable[[], object]


class DrawingThreads:
    """Does independent pieces of work; the calling thread does some of them itself."""

    def __init__(self, threads: int) -> None:
        """Start none before there is work for two; `threads`, at least 1, has the calling one."""
        self._threads = threads
        self._pool: ThreadPoolExecutor | None = None

    def run(self, work: Iterable[Work], meanwhile: Work | None = None) -> None:
        """Do all of it, and `meanwhile` in the calling thread; returns when all is done.

        Raises what a piece raised, once no other piece is at work.
        """
        waiting = deque(work)
        # One fewer: the calling thread draws too, where it would only wait.
        helpers = min(self._threads, len(waiting)) - 1
        if helpers < 1:
            if meanwhile is not None:
                meanwhile()
            return _work_off(waiting)
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads - 1, thread_name_prefix="wcsim-draw")
        helping = [self._pool.submit(_work_off, waiting) for _ in range(helpers)]
        try:
            if meanwhile is not None:
                meanwhile()
            _work_off(waiting)
        finally:
            # After an error nothing more starts. What has started still writes into buffers: wait.
            waiting.clear()
            started = [helper for helper in helping if not helper.cancel()]
            wait(started)
        for helper in started:
            helper.result()

    def close(self) -> None:
        """End the threads; a second call does nothing."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


def cores() -> int:
    """How many cores this process may use."""
    # A container or `taskset` may allow fewer cores than there are.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _work_off(waiting: deque[Work]) -> None:
    while True:
        try:
            piece = waiting.popleft()
        except IndexError:
            return
        piece()
