"""Processes of one's own: a command run to its end, a function behind a pipe, a pool; and signals that end them.

SIGINT and SIGTERM are a wish, which is counted, so that whoever has processes and files to bring to an end can do it.
The kernel tells a child of the end of its parent. Nothing else of wcsim is loaded.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import IO, TYPE_CHECKING, Any, Self, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

_TAIL_BYTES = 1 << 20  # of an output that are kept
_PR_SET_PDEATHSIG = 1
_LOOK_S = 1.0
_STDERR_FD = 2
_MOMENT_S = 5.0  # for what ends in good order
_Piece = TypeVar("_Piece")
_Done = TypeVar("_Done")


def run_command(
    command: Sequence[str],
    wall_s: float,
    *,
    folder: Path | None = None,
    env: Mapping[str, str] | None = None,
    together: bool = False,
    beside: Callable[[subprocess.Popen[bytes]], object] = lambda child: None,
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, without input; the ends of what it said are kept.

    Args:
        command: Its words.
        wall_s: Seconds that it may take.
        folder: Where it runs.
        env: Its environment; None for that of this process.
        together: Whether its stderr goes into its output.
        beside: Told of the process once it runs.

    Raises:
        ChildProcessError: It cannot be started.
        subprocess.TimeoutExpired: It took too long, and was killed.
    """
    # Files take whatever it says: nobody reads a pipe meanwhile.
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as said:
        try:
            child = subprocess.Popen(
                command,
                cwd=folder,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT if together else said,
            )
        except OSError as error:
            raise ChildProcessError(str(error)) from None
        try:
            beside(child)
            code = child.wait(wall_s)
        except BaseException:  # it may stand still, and would be waited for
            child.kill()
            child.wait()
            raise
        return subprocess.CompletedProcess(command, code, _tail(out), _tail(said))


def _tail(written: IO[bytes]) -> str:
    size = os.fstat(written.fileno()).st_size
    return os.pread(written.fileno(), _TAIL_BYTES, max(0, size - _TAIL_BYTES)).decode(
        "utf-8", "replace"
    )


def start_child(
    run: Callable[..., object], *args: object, name: str, daemon: bool = False
) -> tuple[Connection, BaseProcess]:
    """Our end of a pipe and the process at the other, which runs `run(its end, *args)` and hears no Ctrl-C."""
    from multiprocessing import get_context

    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=run, args=(theirs, *args), name=name, daemon=daemon)
    with unheard_by_children():  # Ctrl-C is for who started it, and ends it
        process.start()
    theirs.close()
    return ours, process


def pooled(
    call: Callable[[_Piece], _Done], pieces: Sequence[_Piece], jobs: int
) -> Iterator[tuple[int, _Done]]:
    """What a function of a module makes of pieces, in processes: each as it is done, with its piece's place.

    What has not begun when one fails, or when nobody wants the rest, is not done.
    """
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    # A process that waits for work would not notice that nobody is left to give it any.
    name_semaphores()
    with ProcessPoolExecutor(
        jobs, get_context("spawn"), die_with_parent, (signal.SIGKILL,)
    ) as pool:
        waiting = {pool.submit(call, piece): place for place, piece in enumerate(pieces)}
        hear_of_deaths(pool)
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def hear_of_deaths(pool: ProcessPoolExecutor) -> None:
    """Close our copy of the end that results are written to; to be called when all processes of the pool have started.

    Else a process that is killed in the middle of a result is waited for without end: its pipe stays open.
    """
    pool._result_queue._writer.close()  # type: ignore[attr-defined]


def name_semaphores() -> None:
    """Name this process in its semaphores, before it makes a pool; remove those of processes that were killed.

    multiprocessing's tracker does so, unless it was killed with all others. Process numbers mean nothing in another
    container that shares the place, so the number of this one stands before them.
    """
    from multiprocessing import current_process

    container = f"wcsim-{Path('/proc/self/ns/pid').stat().st_ino}-"
    for left in Path("/dev/shm").glob(f"sem.{container}*"):  # noqa: S108 - nothing is made there
        if not Path("/proc", left.name.removeprefix(f"sem.{container}").partition("-")[0]).exists():
            with suppress(OSError):  # another user's
                left.unlink()
    current_process()._config["semprefix"] = f"/{container}{os.getpid()}"  # type: ignore[attr-defined]


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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
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
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # which multiprocessing starts first, and lets all signals through after it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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


@contextmanager
def without_line(beginning: bytes) -> Iterator[None]:
    """Within the block, lines of native code on standard error that begin like this are dropped.

    Native code writes past `sys.stderr`, so the file descriptor itself is held back and passed on at the end, also
    after an error. For short blocks: what another thread writes meanwhile appears a moment later.
    """
    try:
        terminal = os.dup(_STDERR_FD)
    except OSError:  # standard error is closed: there is nobody to be spared
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
