import os
import threading
from pathlib import Path

import pytest

from wcsim.drive.recording.study_plan import append_row, read_rows
from wcsim.errors import ConfigError, DiskFullError

COLUMNS = ("participant", "block", "answer")


def test_rows_are_appended_and_read_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "a.csv"
    assert read_rows(path, COLUMNS) == ()
    rows = [{"participant": "1", "block": 'a "b", c', "answer": "ü"}, {"participant": "2", "block": "", "answer": "x"}]
    for row in rows:
        append_row(path, COLUMNS, row)
    append_row(path, COLUMNS, {"participant": "3"})
    assert list(read_rows(path, COLUMNS)) == [*rows, {"participant": "3", "block": "", "answer": ""}]
    assert path.read_text().count("participant,block,answer") == 1


@pytest.mark.parametrize("end", [b"\r\n1,a,7\r\n\r\n", b"\n1,a,7"], ids=["spreadsheet", "no end of the last line"])
def test_a_spreadsheet_or_an_editor_may_have_saved_it(tmp_path: Path, end: bytes) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"participant,block,answer" + end)
    append_row(path, COLUMNS, {"participant": "2"})
    assert [(row["participant"], row["answer"]) for row in read_rows(path, COLUMNS)] == [("1", "7"), ("2", "")]


def test_two_participants_who_end_at_the_same_time_lose_no_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, real = tmp_path / "a.csv", os.pwrite
    append_row(path, COLUMNS, {"participant": "1"})
    other = threading.Thread(target=append_row, args=(path, COLUMNS, {"participant": "3"}))

    def meanwhile(handle: int, data: bytes, at: int) -> int:
        if not other.ident:
            other.start()
            other.join(0.3)  # who has to wait is still there afterwards
        return real(handle, data, at)

    monkeypatch.setattr(os, "pwrite", meanwhile)
    append_row(path, COLUMNS, {"participant": "2"})
    other.join()
    assert [row["participant"] for row in read_rows(path, COLUMNS)] == ["1", "2", "3"]


@pytest.mark.parametrize(
    "data, told",
    [
        (b"", "its columns are not"),
        (b"participant;block;answer\n", "its columns are not"),
        (b"participant,block,answer\n1,a\n", "is not a table with 3 columns"),
        (b"participant,block,answer\n1,a,7", "its last line is incomplete"),
        (b"\xff\xfe", "not in UTF-8"),
    ],
)
def test_what_is_no_such_table_is_refused(tmp_path: Path, data: bytes, told: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(data)
    with pytest.raises(ConfigError, match=told):
        read_rows(path, COLUMNS)


def test_a_full_disk_leaves_the_table_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    append_row(path, COLUMNS, {"participant": "1"})
    before, write = path.read_bytes(), os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda handle, data, end: write(handle, data[:2], end))
    with pytest.raises(DiskFullError, match="free some disk space"):
        append_row(path, COLUMNS, {"participant": "2"})
    assert path.read_bytes() == before
    with pytest.raises(ConfigError, match="cannot be written"):
        append_row(tmp_path, COLUMNS, {})
