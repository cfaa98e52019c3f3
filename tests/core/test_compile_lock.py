"""Processes that want the same machine code at the same time make it once."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock

import wcsim
from wcsim.core import jit
from wcsim.core.jit import compile_exact_kernel

COLD = """
from wcsim.core.jit import compile_exact_kernel


@compile_exact_kernel
def plus(x):
    return x + 1.0
"""
CODE = """
import json, sys
from cold import plus
sys.stdin.readline()
plus(1.0)
print(json.dumps([sum(plus.stats.cache_hits.values()), sum(plus.stats.cache_misses.values())]))
"""


def root(x: float) -> float:
    return math.sqrt(x)


def test_processes_that_begin_together_compile_a_kernel_once(tmp_path: Path) -> None:
    (tmp_path / "cold.py").write_text(COLD)
    words = [sys.executable, "-c", CODE]
    places = {"PYTHONPATH": str(Path(wcsim.__file__).parents[1]), "XDG_CACHE_HOME": str(tmp_path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    runs = [subprocess.Popen(words, cwd=tmp_path, text=True, env=places, **pipes) for _ in range(2)]
    for run in runs:  # they have loaded what they need, and are let go together
        assert run.stdin is not None
        run.stdin.write("\n")
        run.stdin.flush()
    stats = [json.loads(run.communicate(timeout=240)[0]) for run in runs]
    assert sorted(stats) == [[0, 1], [1, 0]]


def test_a_process_that_was_stopped_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "LONGEST_WAIT_S", 0.05)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    copy = compile_exact_kernel(root)
    copy._cache._lock = FileLock(tmp_path / "k.lock")  # type: ignore[attr-defined]
    copy._cache._cache_path = str(tmp_path)  # type: ignore[attr-defined]
    with FileLock(tmp_path / "k.lock"):
        assert copy(4.0) == 2.0


def test_without_a_place_for_a_lock_it_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "file").write_text("no folder")
    copy = compile_exact_kernel(root)
    copy._cache._lock = FileLock(tmp_path / "file" / "k.lock")  # type: ignore[attr-defined]
    copy._cache._cache_path = str(tmp_path)  # type: ignore[attr-defined]
    assert copy(9.0) == 3.0
