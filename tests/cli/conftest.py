"""The command line in this process, in an empty folder."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.support.one_process import in_this_process
from wcsim.cli.main import main
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.town import town_check
from wcsim.towns.importing import demand

QUICK = ("--set", "world.warmup_s=0", "--set", "cameras.0.width_px=32", "--set", "cameras.0.height_px=24")


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """How a command ended."""

    code: int
    out: str
    err: str


Run = Callable[..., Result]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, which the commands run in."""
    place = tmp_path / "here"
    place.mkdir()
    monkeypatch.chdir(place)
    monkeypatch.setenv("COLUMNS", "80")
    return place


@pytest.fixture
def wcsim(folder: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Iterator[Run]:
    """Run `wcsim WORDS` in this process, workers and all; capfd sees what native code writes too.

    The traffic of a town that is checked or made is tried for some seconds alone, not for minutes.
    """
    monkeypatch.setattr(town_check, "COLLIDING_S", 30.0)
    monkeypatch.setattr(demand, "TRIAL_S", 20)
    with in_this_process():
        yield runner(main, capfd)


def runner(command: Callable[[list[str]], int], capfd: pytest.CaptureFixture[str]) -> Run:
    """How `wcsim` and the benchmarks are run."""

    def run(*words: object) -> Result:
        capfd.readouterr()
        code = command([str(word) for word in words])
        out, err = capfd.readouterr()
        return Result(code=code, out=out, err=err)

    return run


def start(folder: Path, *words: object, program: str = "wcsim", columns: int = 100) -> subprocess.Popen[str]:
    """A command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", program, *(str(word) for word in words)],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": str(columns)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finished(child: subprocess.Popen[str], within_s: float = 280.0, code: int = ExitCode.DONE) -> tuple[str, str]:
    """What a command wrote, once it has ended as it should."""
    out, err = child.communicate(timeout=within_s)
    assert child.returncode == code, err
    return out, err


def files_in(folder: Path) -> set[str]:
    """Everything below a folder, hidden files among it."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def parsed(path: Path | str) -> Any:
    """What a JSON file says."""
    return json.loads(Path(path).read_text())
