"""A drive in the little town of `corner`, without any page, and a run in it."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drive.lookers import Noted
from tests.drive.serving.served import served
from tests.support.journals import eventful_run
from wcsim.drive.session import DriveSession
from wcsim.drive.starting import DriveStart


@pytest.fixture(scope="session")
def run(corner: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run with everything that a server does, which tests only read."""
    folder = tmp_path_factory.mktemp("filmed")
    eventful_run(corner, folder)
    return folder


@pytest.fixture(scope="module")
def running(corner: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    with served(corner) as drive:
        yield drive


@pytest.fixture
def noted() -> Noted:
    return Noted()


@pytest.fixture
def session(corner: Path, noted: Noted) -> Iterator[DriveSession]:
    """A drive with `dwa` beside the person."""
    with DriveSession(DriveStart(town=str(corner), policy="dwa", seed=4), (noted,)) as drive:
        yield drive
