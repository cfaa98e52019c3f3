"""How a process comes into being: on this machine, or by whatever starts processes elsewhere (Ray, SLURM)."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol


class ProcessHandle(Protocol):
    """A process that a spawner has started."""

    @property
    def pid(self) -> int:
        """What people know it by."""

    @property
    def end_fd(self) -> int | None:
        """Readable as soon as it has ended, until `wait` closes it; None where it can only be polled."""

    def poll(self) -> int | None:
        """The exit code, or the negative number of the signal that ended it; None while it runs."""

    def terminate(self) -> None:
        """Ask it to end, as SIGTERM does; nothing happens when it has ended."""

    def kill(self) -> None:
        """End it now; nothing happens when it has ended."""

    def wait(self) -> int:
        """Wait for its end, let go of everything, and return what `poll` does."""


class Spawner(Protocol):
    """Starts processes."""

    def start(
        self, argv: Sequence[str], env: Mapping[str, str] | None, log: Path, status_fd: int
    ) -> ProcessHandle:  # fmt: skip
        """Start a process that nothing but its handle ends.

        Args:
            argv: Its command line, in which the number of `status_fd` stands.
            env: Its environment; None for the one here.
            log: Where its output is appended.
            status_fd: The end of a pipe for its status lines, closed here after the call. The process has it open under
                the same number; where that cannot be, the spawner writes there what the process says elsewhere.
        """


class LocalProcess:
    """A process of this machine, in a session of its own: Ctrl-C at the terminal reaches its launcher alone."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self.pid = process.pid
        self.end_fd: int | None = os.pidfd_open(process.pid)

    def poll(self) -> int | None:
        """See `ProcessHandle`."""
        return self._process.poll()

    def terminate(self) -> None:
        """See `ProcessHandle`."""
        self._process.terminate()

    def kill(self) -> None:
        """See `ProcessHandle`."""
        self._process.kill()

    def wait(self) -> int:
        """See `ProcessHandle`."""
        code = self._process.wait()
        if self.end_fd is not None:
            os.close(self.end_fd)
            self.end_fd = None
        return code


class SubprocessSpawner:
    """The usual one."""

    def start(
        self, argv: Sequence[str], env: Mapping[str, str] | None, log: Path, status_fd: int
    ) -> LocalProcess:  # fmt: skip
        """See `Spawner`. Raises OSError when there is no such program."""
        with log.open("ab") as out:
            return LocalProcess(
                subprocess.Popen(
                    argv,
                    env=env,
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=out,
                    pass_fds=(status_fd,),
                    start_new_session=True,
                )
            )
