"""Whether the processes of local clients live: the kernel says so at once, whatever they were doing."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Collection

from wcsim.core.closing import Closing


class Lifelines(Closing):
    """Watches processes, and the pipe to whoever started this one; a context manager."""

    def __init__(self, pipe: int = -1) -> None:
        """Watch the writing end of a pipe for the end of its reader; -1 for none."""
        self._epoll = select.epoll()
        self._pipe = pipe
        self._pidfds: dict[int, int] = {}  # by process
        self._sessions: dict[int, set[bytes]] = {}  # by process
        if pipe >= 0:
            self._epoll.register(pipe, 0)  # its error is always told

    def fileno(self) -> int:
        """A descriptor that can be read when there is news."""
        return self._epoll.fileno()

    def watch(self, pid: int, session: bytes) -> bool:
        """Watch the process of a session; False when it is not there any more."""
        if pid not in self._pidfds:
            try:
                number = os.pidfd_open(pid)
            except (OSError, OverflowError):
                return False
            self._pidfds[pid], self._sessions[pid] = number, set()
            self._epoll.register(number, select.EPOLLIN)
        self._sessions[pid].add(session)
        return True

    def news(self) -> tuple[list[bytes], bool]:
        """Sessions whose processes have ended since the last call, and whether the reader of the pipe is gone."""
        lost: list[bytes] = []
        alone = False
        for number, _ in self._epoll.poll(0):
            if number == self._pipe:
                alone = True
                continue
            pid = next(pid for pid, mine in self._pidfds.items() if mine == number)
            lost.extend(sorted(self._sessions[pid]))
            self._forget(pid)
        return lost, alone

    def keep(self, sessions: Collection[bytes]) -> None:
        """Forget all sessions but these."""
        for pid, mine in list(self._sessions.items()):
            mine.intersection_update(sessions)
            if not mine:
                self._forget(pid)

    def close(self) -> None:
        """Watch nothing any more."""
        for pid in list(self._pidfds):
            self._forget(pid)
        self._epoll.close()

    def _forget(self, pid: int) -> None:
        number = self._pidfds.pop(pid)
        del self._sessions[pid]
        with contextlib.suppress(OSError):
            self._epoll.unregister(number)
        os.close(number)
