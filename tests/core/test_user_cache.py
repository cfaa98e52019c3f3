"""Where a user's cache lies, and where it lies when there is no home for it: `wcsim.core.files.find_cache_folder`."""

import os
import tempfile
from pathlib import Path

import pytest

from wcsim.core.files import find_cache_folder, find_home_folder

OTHERS = os.getuid() + 1


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's own folder among the temporary ones; nothing is in it, and no other cache is named."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    return tmp_path / f"wcsim-cache-{os.getuid()}"


@pytest.fixture
def homeless(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user whom the machine has no name for."""

    def unknown() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", unknown)


def test_it_lies_where_the_desktop_says_or_in_the_home(temporary, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find_cache_folder() == tmp_path / ".cache" / "wcsim"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "deep" / "cache"))
    assert find_cache_folder() == tmp_path / "deep" / "cache" / "wcsim"
    assert not list(tmp_path.iterdir()), "who only asks makes nothing"


def test_without_a_home_it_is_temporary_and_the_users_alone(temporary, homeless):
    assert find_home_folder() is None
    assert find_cache_folder() == temporary == find_cache_folder()
    assert temporary.stat().st_mode & 0o777 == 0o700


def test_a_home_that_is_a_file_is_none(temporary, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    assert find_cache_folder() == temporary


def test_a_home_that_cannot_be_written_is_none(temporary, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "there"))
    monkeypatch.setattr(os, "access", lambda place, mode: False)  # whoever runs this may be allowed everything
    assert find_cache_folder() == temporary


def test_what_somebody_else_put_there_is_not_read(temporary, homeless, tmp_path, monkeypatch):
    temporary.mkdir(mode=0o755)
    temporary.chmod(0o755)
    assert find_cache_folder() != temporary, "others may look in, so they may have come first"
    temporary.rmdir()
    (tmp_path / "theirs").mkdir(mode=0o700)
    temporary.symlink_to(tmp_path / "theirs")
    assert find_cache_folder() != temporary, "a link leads where somebody else wants"
    temporary.unlink()
    (tmp_path / f"wcsim-cache-{OTHERS}").mkdir(mode=0o700)
    monkeypatch.setattr(os, "getuid", lambda: OTHERS)
    assert find_cache_folder().parent == Path(os.devnull), "it belongs to another user"
    with pytest.raises(OSError, match="Not a directory"):
        find_cache_folder().mkdir(parents=True)
