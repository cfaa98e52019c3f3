"""What pools of processes do, and one that dies, in the process of the test: another one costs seconds."""

from __future__ import annotations

import pickle
import resource
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import pytest

from wcsim.core import files
from wcsim.server.workers import machines
from wcsim.server.workers.scheduler import WorkScheduler
from wcsim.view.report import failures


class InlinePool:
    """A pool that works at once, on what comes through the pickle and with what goes back through it."""

    _processes = None  # none to kill

    def submit(self, work: Callable[..., Any], *words: Any) -> Future[Any]:
        sent, mine = pickle.loads(pickle.dumps((work, words))), Future[Any]()  # noqa: S301
        try:
            mine.set_result(pickle.loads(pickle.dumps(sent[0](*sent[1]))))  # noqa: S301
        except BaseException as error:
            mine.set_exception(error)
        return mine

    def shutdown(self, wait: bool = True, cancel_futures: bool = False) -> None:
        """Nothing is running."""


class OneScheduler(WorkScheduler):
    """A scheduler whose pieces are done by whoever waits for them, in the thread of the test."""

    def __enter__(self) -> OneScheduler:
        return self

    def __exit__(self, *error: object) -> None:
        self._workers.close()

    def wait(self, keys: Collection[str], timeout_s: float) -> frozenset[str]:
        self._assign()
        for result in self._workers.collect(0.0):
            self._settle(result)
        return super().wait(keys, 0.0)


def _run_here(call: Callable[[Any], Any], pieces: Sequence[Any], jobs: int) -> Iterator[tuple[int, Any]]:
    assert jobs == 1
    pool = InlinePool()
    return enumerate(pool.submit(call, piece).result() for piece in pieces)


@contextmanager
def in_this_process() -> Iterator[None]:
    """Pieces are driven and failures illustrated without further processes; those have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(failures, "run_in_process_pool", _run_here)
        patch.setattr(machines, "start_single_worker_pool", InlinePool)
        for asking in ("wcsim.agents.evaluation.suite.run", "wcsim.agents.rounds.collect_data"):
            patch.setattr(f"{asking}.WorkScheduler", OneScheduler)
        yield


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """No file of this process grows beyond so many bytes, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def die_after(dying: pytest.MonkeyPatch, written: int) -> None:
    """Let so many files be written whole, and then end the process as Ctrl-C does."""
    left, write = [written], files.write_bytes

    def last_words(path, data):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        write(path, data)

    dying.setattr(files, "write_bytes", last_words)
