"""A child process as its launcher holds it: output in a log file, status lines in a pipe, its end from its handle."""

from __future__ import annotations

import os
import selectors
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

from wcsim.server.launch.spawner import Spawner

_READ_BYTES = 1 << 16
_MOST_BYTES = 1 << 20  # of a line that does not end


class Child:
    """A running process, whoever has started it."""

    def __init__(
        self, argv_of: Callable[[int], Sequence[str]], log: Path, selector: selectors.BaseSelector, spawner: Spawner
    ) -> None:
        """Start it.

        Args:
            argv_of: The command line, given the number of the pipe's end that status lines go to.
            log: Where its output is appended.
            selector: Wakes when there is something to read, or the process has ended.
            spawner: Starts it.
        """
        log.parent.mkdir(parents=True, exist_ok=True)
        self.log = log
        self._selector = selector
        self._pipe, theirs = os.pipe()
        os.set_blocking(self._pipe, False)
        try:
            log.touch()
            self.log_begin = log.stat().st_size
            self._process = spawner.start(argv_of(theirs), None, log, theirs)
        except BaseException:
            os.close(self._pipe)
            raise
        finally:
            os.close(theirs)
        self.pid = self._process.pid
        self._end_fd = self._process.end_fd
        self._rest = b""
        self._reads = True
        selector.register(self._pipe, selectors.EVENT_READ)
        if self._end_fd is not None:
            selector.register(self._end_fd, selectors.EVENT_READ)

    def lines(self) -> list[bytes]:
        """The whole status lines that have come since the last call; does not wait."""
        while self._reads:
            try:
                data = os.read(self._pipe, _READ_BYTES)
            except BlockingIOError:
                break
            if not data or len(self._rest) > _MOST_BYTES:
                self._stop_reading()
            self._rest += data
        *whole, self._rest = self._rest.split(b"\n")
        return whole

    def ended(self) -> int | None:
        """The exit code, or the negative number of the signal that ended it; None while it runs."""
        return self._process.poll()

    def terminate(self) -> None:
        """Ask it to end; nothing happens when it has ended."""
        self._process.terminate()

    def wait_no_more(self) -> None:
        """Ask it not to wait for others before it ends; nothing happens when it has ended."""
        self._process.wait_no_more()

    def kill(self) -> None:
        """End it now; nothing happens when it has ended."""
        self._process.kill()

    def close(self) -> None:
        """Kill it if it still runs, and let go of its pipe."""
        if self._process.poll() is None:
            self._process.kill()
        if self._end_fd is not None:
            self._selector.unregister(self._end_fd)
            os.close(self._end_fd)
            self._end_fd = None
        self._process.wait()
        self._stop_reading()

    def last_words(self) -> str:
        """What it said of itself in the end: the last `wcsim: ...` line that it wrote, or the last line of all."""
        with self.log.open("rb") as file:
            file.seek(max(self.log_begin, self.log.stat().st_size - _READ_BYTES))
            lines = file.read().decode(errors="replace").splitlines()
        told = [line for line in lines if line.startswith("wcsim: ")] or [line for line in lines if line.strip()]
        return told[-1].removeprefix("wcsim: ") if told else ""

    def _stop_reading(self) -> None:
        if self._reads:
            self._reads = False
            self._selector.unregister(self._pipe)
            os.close(self._pipe)


def how_it_ended(code: int) -> str:
    """An exit code in words.

    >>> how_it_ended(-9), how_it_ended(3)
    ('was killed by SIGKILL', 'ended with code 3')
    """
    if code >= 0:
        return f"ended with code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"
