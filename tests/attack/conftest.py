"""Where attacks write."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

SHARED = Path("/dev/shm")  # noqa: S108 - the folder made in it is new


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory where there is such a place: thousands of files are brought to the disk one by one else."""
    if not os.access(SHARED, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(prefix="wcsim-attack-", dir=SHARED) as folder:
        yield Path(folder)
