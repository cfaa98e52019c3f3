"""What a folder holds, also while others write in it and remove what they wrote."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from wcsim.core.files import count_folder_bytes


def test_of_regular_files_alone(tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "c").write_bytes(b"12345")
    (tmp_path / "d").write_bytes(b"123")
    (tmp_path / "link").symlink_to(tmp_path / "d")
    os.mkfifo(tmp_path / "pipe")
    assert count_folder_bytes(tmp_path) == 8
    assert count_folder_bytes(tmp_path / "none") == 0


def test_what_is_removed_meanwhile_is_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in "abc":
        (tmp_path / name / "deep").mkdir(parents=True)
        (tmp_path / name / "deep" / "file").write_bytes(b"1234")
    (tmp_path / "d").write_bytes(b"12")
    listed = os.scandir

    def remove_then_list(path: str) -> object:
        """Folders go once their parent was read."""
        found = listed(path)
        if str(path) == str(tmp_path):
            entries = list(found)
            shutil.rmtree(tmp_path / "b")
            return _Entries(entries)
        return found

    monkeypatch.setattr(os, "scandir", remove_then_list)
    assert count_folder_bytes(tmp_path) == 10


class _Entries:
    """What `os.scandir` gives."""

    def __init__(self, entries: list[os.DirEntry[str]]) -> None:
        self._entries = iter(entries)

    def __enter__(self) -> _Entries:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __next__(self) -> os.DirEntry[str]:
        return next(self._entries)

    def __iter__(self) -> _Entries:
        return self

    def close(self) -> None:
        pass
