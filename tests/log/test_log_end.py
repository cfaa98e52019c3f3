"""The end of a journal: what is torn there is cut off and kept, what is damaged is refused."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.log.test_log import tick, write
from tests.support.framing import chained, pieces, read_whole, record_ends
from wcsim.errors import JournalError
from wcsim.log.drive import read_drive
from wcsim.log.reader import hash_log, is_log_file, iter_journal_inputs, read_header, read_trace_states
from wcsim.log.writer import LogWriter


def refuse(path: Path, *uses: Callable[[Path], object], told: str = "damaged") -> None:
    for use in uses:
        with pytest.raises(JournalError, match=told):
            use(path)


def test_what_is_cut_off_is_said_and_kept(tmp_path, path):
    write(path)
    whole = path.read_bytes()
    for number in (1, 2):
        path.write_bytes(whole[:-7])
        with LogWriter.append_to(path) as writer:
            assert writer.cut_bytes == len(whole[:-7]) - len(path.read_bytes()) > 0
        kept = tmp_path / ("j.torn" if number == 1 else "j.torn-2")
        assert path.read_bytes() + kept.read_bytes() == whole[:-7]
    with LogWriter.append_to(path) as writer:
        assert writer.cut_bytes == 0
    assert not (tmp_path / "j.torn-3").exists()


def test_what_is_damaged_before_its_end_is_not_cut_off(path):
    write(path)
    data = bytearray(path.read_bytes())
    data[record_ends(path)[3] + 12] ^= 1
    path.write_bytes(data)
    seen = []
    with pytest.raises(JournalError, match=r"is damaged at byte"):
        seen.extend(iter_journal_inputs(path))
    refuse(path, read_whole, hash_log, LogWriter.append_to, told="is damaged at byte")
    assert path.read_bytes() == data


def test_a_damaged_length_cuts_nothing_off(path):
    """A length that reaches beyond the end looks like a record that was torn."""
    records = [tick(number) for number in range(1, 260)]
    write(path, records)
    whole, ends = path.read_bytes(), record_ends(path)
    assert read_whole(path).records == tuple(records)
    for back in (1, 2, 5, 50, 200):
        for bit in (3, 12, 20, 27):
            data = bytearray(whole)
            data[ends[-back - 1] + bit // 8] ^= 1 << bit % 8
            path.write_bytes(data)
            refuse(path, LogWriter.append_to)
            assert path.read_bytes() == data


def test_records_cannot_be_doubled_moved_or_left_out(path):
    write(path)
    head, *rest = pieces(path)
    swapped = [*rest[:3], rest[4], rest[3], *rest[5:]]
    for other in ([*rest, rest[-1]], swapped, [*rest[:3], *rest[4:]], [rest[1], *rest]):
        path.write_bytes(b"".join([head, *other]))
        refuse(path, read_whole, LogWriter.append_to)


@pytest.mark.parametrize(
    "first",
    [
        b'{"magic":"wcsim-journal","version":2,"name":"run"}',
        b'{"magic": "wcsim-trace-1", "name": "t"}',
        b'{"magic": "wcsim-drive-1", "wcsim": "0.1.0"}',
    ],
)
def test_a_file_of_an_older_format_gets_one_refusal(path, first):
    path.write_bytes(chained([first, b"more"]))
    uses = (read_whole, read_header, hash_log, LogWriter.append_to, read_trace_states, read_drive)
    refuse(path, *uses, told=r"j: is of format 'wcsim-\w+(-1)?'; expected 'wcsim-log-1': use the")
    assert is_log_file(path)


def test_a_long_run_of_zeros_is_no_place_to_cut_at(tmp_path, path):
    write(path)
    whole = path.read_bytes()
    path.write_bytes(whole + bytes(1 << 17) + b"more")
    refuse(path, LogWriter.append_to)
    path.write_bytes(whole + bytes(1 << 17))
    with LogWriter.append_to(path) as writer:
        assert writer.cut_bytes == 1 << 17
    assert [p.name for p in tmp_path.iterdir()] == ["j"], "zeros are not worth a file"


def test_what_is_no_regular_file_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "j")
    for path in (tmp_path / "j", tmp_path, Path("/dev/zero")):
        refuse(path, read_whole, told="not a regular file|cannot be read")
