from __future__ import annotations

import subprocess
import sys

CODE = """
import os
before = os.getsid(0)
from wcsim.drive.playing.sources.source_process import LAST, run_at_low_priority
run_at_low_priority()
run_at_low_priority()  # a second time changes nothing
print(os.getsid(0) == os.getpid() != before, os.nice(0) == LAST, os.sched_getscheduler(0) == os.SCHED_IDLE)
"""


def test_who_looks_on_comes_last_in_a_session_of_its_own():
    """In a process of its own, for it cannot be taken back."""
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "True", "True"]
