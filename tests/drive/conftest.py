"""A drive in the little town of `corner`, without any page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drive.lookers import Noted
from wcsim.drive.session import DriveSession
from wcsim.drive.starting import DriveStart


@pytest.fixture
def noted() -> Noted:
    return Noted()


@pytest.fixture
def session(corner: Path, noted: Noted) -> Iterator[DriveSession]:
    """A drive with `dwa` beside the person."""
    with DriveSession(DriveStart(town=str(corner), policy="dwa", seed=4), (noted,)) as drive:
        yield drive
