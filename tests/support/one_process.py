"""Pictures of failures in the process of the test: one of their own costs two seconds before it drives."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import pytest

from wcsim.view.report import failures


class OneProcess:
    """A pool that works at once, on what comes through the pickle and with what goes back through it."""

    def __init__(self, jobs: int, mp_context: object) -> None:
        assert jobs == 1

    def __enter__(self) -> OneProcess:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing is open."""

    def submit(self, work: Callable[..., Any], *words: Any) -> Future[Any]:
        sent, mine = pickle.loads(pickle.dumps((work, words))), Future[Any]()  # noqa: S301
        try:
            mine.set_result(pickle.loads(pickle.dumps(sent[0](*sent[1]))))  # noqa: S301
        except BaseException as error:
            mine.set_exception(error)
        return mine

    def shutdown(self, wait: bool = True, cancel_futures: bool = False) -> None:
        """Nothing is running."""


@contextmanager
def in_this_process() -> Iterator[None]:
    """Failures are illustrated without further processes; those have a test of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(failures, "ProcessPoolExecutor", OneProcess)
        yield
