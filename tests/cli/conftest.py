"""The command line in this process, in an empty folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.one_process import in_this_process
from wcsim.cli.main import main
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


def files_in(folder: Path) -> set[str]:
    """Everything below a folder, hidden files among it."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}
