"""A thread that listens while its caller works; the two never use the same thing at the same time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self


class Listener:
    """A context manager: what is to be heard is heard by another thread from its begin to its end.

    The thread ends by itself once it has heard what it listens for, and the context waits for that; a failure of the
    work, or an interrupt, recalls it. What it raised is raised here.
    """

    def __init__(self, listen: Callable[[Callable[[], bool]], None]) -> None:
        """`listen` gets a function that says whether it was recalled, and looks at it now and then."""
        self._listen = listen
        self._recalled = False
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="wcsim-listener", daemon=True)
        self.ended_s = 0.0  # of `time.perf_counter`, when it had heard all

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._recalled = error is not None
        try:
            self._thread.join()
        except BaseException:  # an interrupt
            self._recalled = True
            self._thread.join()
            raise
        if error is None and self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            self._listen(lambda: self._recalled)
        except BaseException as error:
            self._error = error
        finally:
            self.ended_s = time.perf_counter()
