"""The lowest scheduling priority for a process that only watches."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

LAST: Final = 19  # the lowest priority
_GROUP: Final = Path("/proc/self/autogroup")


def run_at_low_priority() -> None:
    """Give this process the lowest priority: every other one gets the processor first.

    Linux shares it among sessions before it looks at the priorities within one, so a terminal that only watches would
    get as much as that in which something is trained: this process leaves for a session of its own, which comes last.
    """
    with suppress(OSError):  # it leads a session already
        os.setsid()
        _GROUP.write_text(str(LAST), encoding="ascii")
    os.nice(LAST)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
