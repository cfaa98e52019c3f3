"""A file whose place is the reader's own: also after the process was copied."""

import os
import zipfile

import numpy as np
import pytest

from wcsim.towns.cache.street_cache import _PreadFile


@pytest.fixture
def packed(tmp_path):
    path = tmp_path / "a.npz"
    with path.open("wb") as file:
        np.savez(file, **{f"part{k}": np.arange(20_000) * k for k in range(8)})
    return path


def test_it_reads_as_a_file_does(packed):
    with _PreadFile(packed) as mine, packed.open("rb") as theirs:
        for place, whence in ((0, 0), (100, 0), (-50, 2), (-10, 1), (10**9, 0)):
            assert mine.seek(place, whence) == theirs.seek(place, whence)
            assert mine.read(70) == theirs.read(70) and mine.tell() == theirs.tell()
        with pytest.raises(ValueError, match="0 or more"):
            mine.seek(-1)
    mine.close()
    with pytest.raises((ValueError, OSError)):
        mine.read(1)


def reads_on_after_a_copy_has_read(opened) -> bool:
    data = np.load(opened, allow_pickle=False)
    assert data["part1"][3] == 3
    pid = os.fork()
    if pid == 0:
        try:
            for k in (7, 2, 5):
                assert data[f"part{k}"][9] == 9 * k
        finally:
            os._exit(0)
    os.waitpid(pid, 0)
    try:
        return all(int(data[f"part{k}"][11]) == 11 * k for k in range(8))
    except zipfile.BadZipFile:
        return False


def test_a_copy_of_the_process_does_not_move_its_place(packed):
    assert reads_on_after_a_copy_has_read(_PreadFile(packed))
