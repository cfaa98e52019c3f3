"""How a process comes into being: on this machine, or by whatever starts processes elsewhere (Ray, SLURM)."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

from wcsim.server.launch.states import WAIT_NO_MORE


class ProcessHandle(Protocol):
    """A process that a spawner has started; to terminate or kill one that has ended does nothing."""

    pid: int  # what people know it by
    end_fd: int | None  # readable as soon as it has ended, for its holder to close; None where it can only be polled

    def poll(self) -> int | None:
        """The exit code, or the negative number of the signal that ended it; None while it runs."""

    def terminate(self) -> None:
        """Ask it to end, as SIGTERM does."""

    def wait_no_more(self) -> None:
        """Ask it not to wait for others before it ends, as the signal `WAIT_NO_MORE` does."""

    def kill(self) -> None:
        """End it now."""

    def wait(self) -> int:
        """Wait for its end and return what `poll` does."""


class Spawner(Protocol):
    """Starts processes."""

    def start(self, argv: Sequence[str], env: Mapping[str, str] | None, log: Path, status_fd: int) -> ProcessHandle:
        """Start a process that nothing but its handle ends.

        Args:
            argv: Its command line, in which the number of `status_fd` stands.
            env: Its environment; None for the one here.
            log: Where its output is appended.
            status_fd: The end of a pipe for its status lines, closed here after the call. The process has it open under
                the same number; where that cannot be, the spawner writes there what the process says elsewhere.
        """


class SubprocessSpawner:
    """The usual one: a process in a session of its own, so that Ctrl-C at the terminal reaches its launcher alone."""

    def start(self, argv: Sequence[str], env: Mapping[str, str] | None, log: Path, status_fd: int) -> ProcessHandle:
        """See `Spawner`. Raises OSError when there is no such program."""
        return _LocalProcess(argv, env, log, status_fd)


class _LocalProcess(subprocess.Popen[bytes]):
    def __init__(self, argv: Sequence[str], env: Mapping[str, str] | None, log: Path, status_fd: int) -> None:
        with log.open("ab") as out:
            super().__init__(
                argv,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                pass_fds=(status_fd,),
                start_new_session=True,
            )
        self.end_fd: int | None = os.pidfd_open(self.pid)

    def wait_no_more(self) -> None:
        """See `ProcessHandle`."""
        self.send_signal(WAIT_NO_MORE)
