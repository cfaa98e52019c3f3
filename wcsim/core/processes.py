"""Child processes: the four ways in which wcsim starts them, and the signals that end them.

1. `run_command` runs a command to its end.
2. A long-lived child is a `CommandProcess` (a command that writes status lines, which
   `server/launch` restarts) or comes from `start_piped_process` (a function that exchanges objects
   with its parent).
3. Workers come from `run_in_process_pool`, or one by one from `start_single_worker_pool`.
   `server/workers` gives those of this machine and of a Ray cluster one interface.
4. `os.fork` copies a warm world, in `bridge/world_copy.py` alone.

SIGINT and SIGTERM are counted, so that an owner of processes and files can end them in order. The
kernel signals the end of a parent to its child. This module loads nothing else of wcsim.
"""

from __future__ import annotations

import ctypes
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from types import FrameType
from typing import IO, TYPE_CHECKING, Any, Final, Self, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

_OUTPUT_TAIL_BYTES: Final = 1 << 20
_READ_BYTES: Final = 1 << 16
# A child whose line is longer than this is not read any more.
_LINE_BYTES: Final = 1 << 20
_MESSAGE_PREFIX: Final = "wcsim: "
_SHM: Final = Path("/dev/shm")  # noqa: S108 - multiprocessing has its semaphores there
_PR_SET_PDEATHSIG: Final = 1
_PARENT_CHECK_S: Final = 1.0
# A process ends in order within this time, as a rule.
_ORDERLY_END_S: Final = 5.0
_STDERR_FD: Final = 2

_Piece = TypeVar("_Piece")
_Result = TypeVar("_Result")


def run_command(
    command: Sequence[str],
    wall_s: float,
    *,
    folder: Path | None = None,
    env: Mapping[str, str] | None = None,
    together: bool = False,
    on_start: Callable[[subprocess.Popen[bytes]], object] = lambda child: None,
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, without input; returns the ends of its outputs.

    Args:
        command: Its words.
        wall_s: Seconds that it may take.
        folder: Where it runs.
        env: Its environment; None for that of this process.
        together: Whether its stderr goes into its output.
        on_start: Called with the process once it runs.

    Raises:
        ChildProcessError: It cannot be started.
        subprocess.TimeoutExpired: It took too long, and was killed.
    """
    # Files take any amount of output; a pipe that nothing reads would block the command.
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        try:
            child = subprocess.Popen(
                command,
                cwd=folder,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT if together else err,
            )
        except OSError as error:
            raise ChildProcessError(str(error)) from None
        try:
            on_start(child)
            code = child.wait(wall_s)
        except BaseException:
            # It may be stopped by a signal, and would be waited for without end.
            child.kill()
            child.wait()
            raise
        return subprocess.CompletedProcess(command, code, _tail(out), _tail(err))


class CommandProcess(subprocess.Popen[bytes]):
    """A long-lived command that writes status lines to a pipe.

    It has a session of its own, so that Ctrl-C at the terminal reaches its parent alone.
    """

    def __init__(
        self,
        argv_of: Callable[[int], Sequence[str]],
        selector: selectors.BaseSelector,
        log: Path | None = None,
    ) -> None:
        """Start it.

        Args:
            argv_of: The command line, given the number of the pipe's end for status lines.
            selector: Wakes when there is something to read, or the process has ended.
            log: Where its output is appended; None: it goes where that of this process goes.

        Raises OSError when there is no such program.
        """
        self._log = log
        self._selector = selector
        self._pipe, child_end = os.pipe()
        os.set_blocking(self._pipe, False)
        try:
            if log is not None:
                log.parent.mkdir(parents=True, exist_ok=True)
            with nullcontext() if log is None else log.open("ab") as out:
                self._log_start = 0 if out is None else out.tell()
                super().__init__(
                    argv_of(child_end),
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=out,
                    pass_fds=(child_end,),
                    start_new_session=True,
                )
            self._exit_fd = os.pidfd_open(self.pid)
        except BaseException:
            os.close(self._pipe)
            raise
        finally:
            os.close(child_end)
        self._unfinished_line = b""
        self._is_reading = True
        selector.register(self._pipe, selectors.EVENT_READ)
        selector.register(self._exit_fd, selectors.EVENT_READ)

    def read_lines(self) -> list[bytes]:
        """The whole status lines since the last call; does not wait."""
        while self._is_reading:
            try:
                data = os.read(self._pipe, _READ_BYTES)
            except BlockingIOError:
                break
            if not data or len(self._unfinished_line) > _LINE_BYTES:
                self._stop_reading()
            self._unfinished_line += data
        *whole, self._unfinished_line = self._unfinished_line.split(b"\n")
        return whole

    @property
    def stopped(self) -> bool:
        """Whether a signal has stopped it, as SIGSTOP does."""
        try:
            return os.waitid(os.P_PID, self.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:
            # It has ended meanwhile.
            return False

    def close(self, grace_s: float = 0.0) -> None:
        """Kill it if it still runs, and close its pipe; it first has `grace_s` to end by itself."""
        if grace_s > 0.0:
            self.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.wait(grace_s)
        self.kill()
        self._selector.unregister(self._exit_fd)
        os.close(self._exit_fd)
        self.wait()
        self._stop_reading()

    def last_message(self) -> str:
        """The last `wcsim: ...` line of its log, or the last line of all; "" without a log."""
        if self._log is None:
            return ""
        with self._log.open("rb") as file:
            file.seek(max(self._log_start, self._log.stat().st_size - _READ_BYTES))
            lines = file.read().decode(errors="replace").splitlines()
        messages = [line for line in lines if line.startswith(_MESSAGE_PREFIX)]
        messages = messages or [line for line in lines if line.strip()]
        return messages[-1].removeprefix(_MESSAGE_PREFIX) if messages else ""

    def _stop_reading(self) -> None:
        if self._is_reading:
            self._is_reading = False
            self._selector.unregister(self._pipe)
            os.close(self._pipe)


def start_piped_process(
    run: Callable[..., object], *args: object, name: str, daemon: bool = False
) -> tuple[Connection, BaseProcess]:
    """Start a process that runs `run(its end of a pipe, *args)`; Ctrl-C does not reach it.

    Returns:
        This process's end of the pipe, and the process.
    """
    from multiprocessing import get_context

    context = get_context("spawn")
    own_end, child_end = context.Pipe()
    process = context.Process(target=run, args=(child_end, *args), name=name, daemon=daemon)
    with _sigint_blocked():
        process.start()
    child_end.close()
    return own_end, process


def run_in_process_pool(
    call: Callable[[_Piece], _Result], pieces: Sequence[_Piece], jobs: int
) -> Iterator[tuple[int, _Result]]:
    """Call a function of a module with each piece, in `jobs` processes.

    Yields the index of a piece and its result, as each is done. When one fails, or the caller takes
    no more, the pieces that have not started are dropped.
    """
    from concurrent.futures import as_completed

    with _new_pool(jobs) as pool:
        indices = {pool.submit(call, piece): index for index, piece in enumerate(pieces)}
        _close_result_writer(pool)
        try:
            for future in as_completed(indices):
                yield indices[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def start_single_worker_pool() -> ProcessPoolExecutor:
    """A pool of one process, which is started at once; Ctrl-C does not reach it."""
    pool = _new_pool(1)
    with _sigint_blocked():
        pool.submit(os.getpid)
    _close_result_writer(pool)
    return pool


def kill_workers(pool: ProcessPoolExecutor) -> None:
    """Kill the processes of a pool; what they are at ends with a BrokenProcessPool."""
    for process in list((pool._processes or {}).values()):
        process.kill()


class SignalContextBase(ABC):
    """While open, signals go to `_on_signal`, and afterwards where they went; main thread only."""

    def __init__(self, *numbers: int) -> None:
        self._numbers = numbers
        self._handlers_before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in self._numbers:
                self._handlers_before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._handlers_before.items():
            signal.signal(number, handler)
        self._handlers_before.clear()

    @abstractmethod
    def _on_signal(self, number: int, frame: FrameType | None) -> None: ...


class StopSignalCounter(SignalContextBase):
    """While open, SIGINT and SIGTERM are counted and have no other effect; in the main thread only.

    Afterwards they are ignored if there was one: the process is ending with a code that reports it.
    """

    def __init__(self) -> None:
        super().__init__(signal.SIGINT, signal.SIGTERM)
        self.count = 0

    def __exit__(self, *error: object) -> None:
        if self.count:
            self._handlers_before = dict.fromkeys(self._handlers_before, signal.SIG_IGN)
        super().__exit__(*error)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.count += 1


def die_with_parent(number: int = signal.SIGTERM) -> None:
    """Have the kernel send this process a signal when the thread that started it ends.

    To be called first of all. Raises OSError when the kernel refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(number), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")


def limit_orphan_lifetime(grace_s: float, code: int, stop_signal: int) -> None:
    """Limit the life of this process after its parent.

    A moment after the parent's end it is sent `stop_signal`; `grace_s` later it ends with `code`.
    """

    def watch(parent: int) -> None:
        while os.getppid() == parent:
            time.sleep(_PARENT_CHECK_S)
        time.sleep(_ORDERLY_END_S)
        os.kill(os.getpid(), stop_signal)
        time.sleep(grace_s)
        os._exit(code)

    threading.Thread(target=watch, args=(os.getppid(),), name="parent watch", daemon=True).start()


@contextmanager
def drop_stderr_lines(beginning: bytes) -> Iterator[None]:
    """Within the block, lines of native code on stderr that begin like this are dropped.

    Native code writes past `sys.stderr`. So the file descriptor itself is redirected, and the rest
    is passed on at the end, also after an error. For short blocks: what another thread writes
    meanwhile appears a moment later.
    """
    try:
        terminal = os.dup(_STDERR_FD)
    except OSError:
        # Standard error is closed, so there is nothing to drop.
        yield
        return
    with tempfile.TemporaryFile() as held:
        if sys.stderr is not None:
            sys.stderr.flush()
        os.dup2(held.fileno(), _STDERR_FD)
        try:
            yield
        finally:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(terminal, _STDERR_FD)
            os.close(terminal)
            held.seek(0)
            for line in held:
                if not line.startswith(beginning):
                    os.write(_STDERR_FD, line)


def _tail(written: IO[bytes]) -> str:
    size = os.fstat(written.fileno()).st_size
    tail = os.pread(written.fileno(), _OUTPUT_TAIL_BYTES, max(0, size - _OUTPUT_TAIL_BYTES))
    return tail.decode("utf-8", "replace")


def _new_pool(jobs: int) -> ProcessPoolExecutor:
    """A pool of processes that end with this one, however it ends."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import current_process, get_context

    # 1. Remove the semaphores of processes that were killed. multiprocessing's tracker does so,
    # unless it was killed with them. A pid means nothing in another container that shares the
    # folder, so the number of this one stands before it.
    prefix = f"wcsim-{Path('/proc/self/ns/pid').stat().st_ino}-"
    for semaphore in _SHM.glob(f"sem.{prefix}*"):
        pid = semaphore.name.removeprefix(f"sem.{prefix}").partition("-")[0]
        if not Path("/proc", pid).exists():
            # It may be another user's.
            with suppress(OSError):
                semaphore.unlink()
    # 2. Name this process in its own.
    current_process()._config["semprefix"] = f"/{prefix}{os.getpid()}"  # type: ignore[attr-defined]
    # 3. A process that waits for work would not detect that its parent was killed.
    return ProcessPoolExecutor(jobs, get_context("spawn"), die_with_parent, (signal.SIGKILL,))


def _close_result_writer(pool: ProcessPoolExecutor) -> None:
    """Close this process's copy of the pipe's end for results, once all processes have started.

    Else a process that is killed in the middle of a result is waited for without end: its pipe
    stays open.
    """
    pool._result_queue._writer.close()  # type: ignore[attr-defined]


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """While open, a process that this thread starts blocks SIGINT, from its first line on.

    Ctrl-C goes to all processes of a terminal; these are ended by their parent.
    """
    from multiprocessing import resource_tracker

    # multiprocessing would start its tracker first, and unblock all signals after that.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
