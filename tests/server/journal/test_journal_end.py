"""The end of a journal: what is torn there is cut off and kept, what is damaged is refused."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.server.journal.test_journal import FIRST, HEADER, RECORDS, tick, write
from tests.support.framing import pieces, record_ends
from wcsim.errors import JournalError
from wcsim.server.journal.journal import JournalWriter, _read_journal, iter_journal, journal_digest, read_header
from wcsim.server.journal.records import record_bytes
from wcsim.users.recording.framing import framed


def test_what_is_cut_off_is_said_and_kept(tmp_path):
    path = tmp_path / "j"
    write(path)
    whole = path.read_bytes()
    for number in (1, 2):
        path.write_bytes(whole[:-7])
        with JournalWriter.append_to(path) as writer:
            assert writer.cut_bytes == len(whole[:-7]) - len(path.read_bytes()) > 0
        kept = tmp_path / ("j.torn" if number == 1 else "j.torn-2")
        assert path.read_bytes() + kept.read_bytes() == whole[:-7]
    with JournalWriter.append_to(path) as writer:
        assert writer.cut_bytes == 0
    assert not (tmp_path / "j.torn-3").exists()


def test_what_is_damaged_before_its_end_is_not_cut_off(tmp_path):
    path = tmp_path / "j"
    write(path)
    data = bytearray(path.read_bytes())
    data[record_ends(path)[3] + 12] ^= 1
    path.write_bytes(data)
    seen = []
    with pytest.raises(JournalError, match=r"is damaged at byte"):
        seen.extend(iter_journal(path))
    for use in (_read_journal, journal_digest, JournalWriter.append_to):
        with pytest.raises(JournalError, match=r"is damaged at byte"):
            use(path)
    assert path.read_bytes() == data


@pytest.mark.parametrize("version", [1, 2])
def test_a_damaged_length_cuts_nothing_off(tmp_path, version):
    """A length that reaches beyond the end looks like a record that was torn."""
    path = tmp_path / "j"
    records = [tick(number) for number in range(1, 260)]
    write(path, records)
    if version == 1:
        path.write_bytes(b"".join(map(framed, [FIRST, *map(record_bytes, records)])))
    whole, ends = path.read_bytes(), record_ends(path, 0 if version == 2 else None)
    assert _read_journal(path).records == tuple(records)
    for back in (1, 2, 5, 50, 200):
        for bit in (3, 12, 20, 27):
            data = bytearray(whole)
            data[ends[-back - 1] + bit // 8] ^= 1 << bit % 8
            path.write_bytes(data)
            with pytest.raises(JournalError, match="damaged"):
                JournalWriter.append_to(path)
            assert path.read_bytes() == data


def test_records_cannot_be_doubled_moved_or_left_out(tmp_path):
    path = tmp_path / "j"
    write(path)
    head, *rest = pieces(path)
    swapped = [*rest[:3], rest[4], rest[3], *rest[5:]]
    for other in ([*rest, rest[-1]], swapped, [*rest[:3], *rest[4:]], [rest[1], *rest]):
        path.write_bytes(b"".join([head, *other]))
        for use in (_read_journal, JournalWriter.append_to):
            with pytest.raises(JournalError, match="damaged"):
                use(path)


def test_a_journal_of_the_version_before_is_gone_on_with(tmp_path):
    new, old = tmp_path / "new", tmp_path / "old"
    digest = write(new)
    old.write_bytes(b"".join(map(framed, [FIRST, *map(record_bytes, RECORDS[:-2])])) + b"torn")
    assert read_header(old) == HEADER
    with JournalWriter.append_to(old) as writer:
        assert writer.cut_bytes == 4
        for record in RECORDS[-2:]:
            writer.append(record)
    assert (_read_journal(old).records, journal_digest(old)) == (RECORDS, digest)
    assert len(record_ends(old, None)) == len(RECORDS) + 1, "it stays one of its version"


def test_a_long_run_of_zeros_is_no_place_to_cut_at(tmp_path):
    path = tmp_path / "j"
    write(path)
    whole = path.read_bytes()
    path.write_bytes(whole + bytes(1 << 17) + b"more")
    with pytest.raises(JournalError, match="damaged"):
        JournalWriter.append_to(path)
    path.write_bytes(whole + bytes(1 << 17))
    with JournalWriter.append_to(path) as writer:
        assert writer.cut_bytes == 1 << 17
    assert [p.name for p in tmp_path.iterdir()] == ["j"], "zeros are not worth a file"


def test_what_is_no_regular_file_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "j")
    for path in (tmp_path / "j", tmp_path, Path("/dev/zero")):
        with pytest.raises(JournalError, match=r"not a regular file|cannot be read"):
            _read_journal(path)
