"""A client's ledger on a full disk: whole entries, and an error with a name."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from wcsim.errors import DiskFullError, JournalError
from wcsim.server.ledger import LedgerEntry, LedgerWriter, _read_ledger

FILL = """
import resource, sys
from pathlib import Path
from tests.server.test_ledger_writer import entry
from wcsim.errors import DiskFullError
from wcsim.server.ledger import LedgerWriter, _read_ledger
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
assert [e.tick for e in _read_ledger(path)] == [0, 1, 3], _read_ledger(path)
"""


def entry(tick):
    return LedgerEntry(session=b"s" * 16, epoch=0, tick=tick, stepped=True)


def test_a_full_disk_has_a_name(tmp_path):
    with LedgerWriter(tmp_path / "a") as ledger, pytest.raises(DiskFullError, match="No space left"):
        full = os.open("/dev/full", os.O_WRONLY)
        os.dup2(full, ledger._file.fileno())
        os.close(full)
        ledger.add(entry(0))


def filled(path, count=9):
    with LedgerWriter(path) as ledger:
        for tick in range(count):
            ledger.add(entry(tick))
    return path.read_bytes()


def test_a_torn_end_is_cut_off_and_kept(tmp_path):
    path = tmp_path / "a"
    whole = filled(path)
    for cut in (1, 20, 31):
        path.write_bytes(whole[:-cut])
        with LedgerWriter(path) as ledger:
            assert ledger.cut_bytes == 32 - cut
            ledger.add(entry(8))
        assert path.read_bytes() == whole
    assert [len(kept.read_bytes()) for kept in sorted(tmp_path.glob("a.torn*"))] == [31, 12, 1]
    path.write_bytes(whole + bytes(4096))
    LedgerWriter(path).close()
    assert path.read_bytes() == whole


def test_no_flipped_bit_is_taken_for_an_entry(tmp_path):
    path = tmp_path / "a"
    whole, entries = filled(path), _read_ledger(path)
    for bit in range(0, 8 * len(whole), 7):
        data = bytearray(whole)
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        if bit >= 8 * (len(whole) - 32):  # the last one: nobody can say whether it was ever whole
            assert _read_ledger(path) == entries[:-1]
            continue
        for use in (_read_ledger, LedgerWriter):
            with pytest.raises(JournalError, match="damaged"):
                use(path)
        assert path.read_bytes() == data


def test_entries_cannot_be_doubled_moved_or_left_out(tmp_path):
    path = tmp_path / "a"
    rows = [filled(path)[at : at + 32] for at in range(0, 9 * 32, 32)]
    for other in ([*rows[:4], rows[5], rows[4], *rows[6:]], [*rows[:3], *rows[4:]], [*rows[:5], *rows[4:]], rows[1:]):
        path.write_bytes(b"".join(other))
        with pytest.raises(JournalError, match="damaged"):
            _read_ledger(path)


def test_a_ledger_without_seals_goes_on_without_them(tmp_path):
    path = tmp_path / "a"
    old = b"".join(struct.pack("<16siqi", b"s" * 16, 0, tick, True) for tick in range(3))
    path.write_bytes(old + b"torn")
    with LedgerWriter(path) as ledger:
        assert ledger.cut_bytes == 4
        ledger.add(entry(3))
    assert [e.tick for e in _read_ledger(path)] == [0, 1, 2, 3]
    assert path.read_bytes()[: len(old)] == old


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "a")
    for use in (_read_ledger, LedgerWriter):
        with pytest.raises(JournalError, match="not a regular file"):
            use(tmp_path / "a")


def test_half_an_entry_is_taken_back(tmp_path):
    path = tmp_path / "a.ledger"
    done = subprocess.run(
        [sys.executable, "-c", FILL, str(path)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[3],
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "only a part was written" in done.stdout
    assert len(_read_ledger(path)) == 3
