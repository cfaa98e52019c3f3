"""Commands typed as they are printed: to the end of their line, in a shell of their own."""

import os
import subprocess
import sys
from pathlib import Path

from tests.support.tracked import ROOT


def python_says(code: str) -> str:
    """What Python code prints in a process of its own, which must end well."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def printed(text: str, told: str) -> str:
    """The command at the end of the first line that says something."""
    line = next((line for line in text.splitlines() if told in line), "")
    command = line.rpartition(": ")[2]
    assert command, f"{told!r} is not in:\n{text}"
    return command


def typed(command: str, folder: Path) -> tuple[int, str]:
    """Its exit status and all that it says, run where only `wcsim` is on the PATH."""
    script = f'#!/bin/sh\nexec {sys.executable} -m wcsim "$@"\n'
    (folder / "bin").mkdir(exist_ok=True)
    (folder / "bin" / "wcsim").write_text(script)
    (folder / "bin" / "wcsim").chmod(0o755)
    kept = {key: value for key, value in os.environ.items() if key in ("HOME", "XDG_CACHE_HOME", "OMP_NUM_THREADS")}
    environment = {**kept, "PATH": f"{folder / 'bin'}:/usr/bin:/bin", "PYTHONPATH": str(ROOT), "COLUMNS": "80"}
    done = subprocess.run(
        ["/bin/sh", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout + done.stderr
