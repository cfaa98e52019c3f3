"""A child process does not outlive its parent: the kernel tells it when that one ends, however it ends."""

from __future__ import annotations

import ctypes
import os
import signal
import threading
import time

_PR_SET_PDEATHSIG = 1
_LOOK_S = 1.0
_MOMENT_S = 5.0  # for what ends in good order


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
