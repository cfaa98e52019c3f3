"""What becomes of a process whose parent has gone."""

from __future__ import annotations

import subprocess
import sys

CHILD = """
import signal, sys, time
from pathlib import Path
from wcsim.server.launch import stop_signals
def asked(number, frame):
    Path(sys.argv[1], "asked").touch()
signal.signal(signal.SIGUSR1, asked)
stop_signals._LOOK_S = stop_signals._MOMENT_S = 0.05
stop_signals.outlive_parent_by(1.0, 9, signal.SIGUSR1)
Path(sys.argv[1], "began").touch()
time.sleep(120.0)
Path(sys.argv[1], "outlived").touch()
"""
PARENT = """
import subprocess, sys, time
from pathlib import Path
subprocess.Popen([sys.executable, "-c", sys.argv[2], sys.argv[1]])
for _ in range(3000):
    if Path(sys.argv[1], "began").exists():
        break
    time.sleep(0.02)
"""


def test_a_process_is_asked_not_to_wait_and_ended_later(tmp_path):
    """Its output is closed when it has ended."""
    words = [sys.executable, "-c", PARENT, str(tmp_path), CHILD]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as parent:
        parent.wait(60.0)
        assert parent.stdout.read() == b""
    assert (tmp_path / "asked").exists() and not (tmp_path / "outlived").exists()
