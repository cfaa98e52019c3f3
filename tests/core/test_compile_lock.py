"""Processes that want the same machine code at the same time make it once."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import wcsim
from wcsim.core.compile_lock import CompileLock

ROOT = Path(wcsim.__file__).parent
CODE = """
import json, sys
import numpy as np
from wcsim.core.compile_lock import CompileLock
from wcsim.physics.wheelchair.drive_controller import target
sys.stdin.readline()
target(1.0, 0.0, 1.0, np.linspace(0.5, 2.0, 40))
print(json.dumps([sum(target.stats.cache_hits.values()), sum(target.stats.cache_misses.values())]))
"""


def test_one_has_it_and_the_next_one_gets_it(tmp_path: Path) -> None:
    mine, other = CompileLock(tmp_path / "a" / "k.lock"), CompileLock(tmp_path / "a" / "k.lock")
    assert mine.take() and not other.take(longest_s=0.1)
    threading.Timer(0.2, mine.give).start()
    assert other.take(longest_s=30.0)
    other.give()
    other.give()
    assert mine.take(longest_s=0.0)
    mine.give()


def test_without_a_place_for_it_nobody_waits(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    assert not CompileLock(tmp_path / "file" / "k.lock").take()


def test_processes_that_begin_together_compile_a_kernel_once(tmp_path: Path) -> None:
    shutil.copytree(ROOT, tmp_path / "wcsim", ignore=shutil.ignore_patterns("__pycache__"))
    words = [sys.executable, "-c", CODE]
    runs = [
        subprocess.Popen(words, cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    for run in runs:  # they have loaded what they need, and are let go together
        assert run.stdin is not None
        run.stdin.write("\n")
        run.stdin.flush()
    stats = [json.loads(run.communicate(timeout=120)[0]) for run in runs]
    assert sorted(stats) == [[0, 1], [1, 0], [1, 0]]
