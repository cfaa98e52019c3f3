"""A client's ledger on a full disk: whole entries, and an error with a name."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from wcsim.errors import DiskFullError
from wcsim.server.ledger import LedgerEntry, LedgerWriter, read_ledger

FILL = """
import resource, sys
from pathlib import Path
from tests.server.test_ledger_writer import entry
from wcsim.errors import DiskFullError
from wcsim.server.ledger import LedgerWriter, read_ledger
path = Path(sys.argv[1])
soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
with LedgerWriter(path) as ledger:
    resource.setrlimit(resource.RLIMIT_FSIZE, (2 * 32 + 10, hard))
    ledger.add(entry(0))
    ledger.add(entry(1))
    try:
        ledger.add(entry(2))
    except DiskFullError as error:
        print(error)
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    ledger.add(entry(3))
assert [e.tick for e in read_ledger(path)] == [0, 1, 3], read_ledger(path)
"""


def entry(tick):
    return LedgerEntry(session=bytes(16), epoch=0, tick=tick, stepped=True)


def test_a_full_disk_has_a_name():
    with LedgerWriter(Path("/dev/full")) as ledger, pytest.raises(DiskFullError, match="No space left"):
        ledger.add(entry(0))


def test_half_an_entry_is_taken_back(tmp_path):
    path = tmp_path / "a.ledger"
    done = subprocess.run(
        [sys.executable, "-c", FILL, str(path)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "only a part was written" in done.stdout
    assert len(read_ledger(path)) == 3
