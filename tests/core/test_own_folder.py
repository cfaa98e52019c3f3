"""A folder that is gone with its owner, or with the next start of whoever has the same use for one."""

import os
import stat
import subprocess
import sys
from pathlib import Path

from wcsim.core.own_folder import LOCK, LockedTempFolder, _remove_stale

OWNER = """
import sys, time
from pathlib import Path
from wcsim.core.own_folder import LockedTempFolder
print(LockedTempFolder(Path(sys.argv[1])).path, flush=True)
time.sleep(60)
"""


def owned(home):
    """A folder of another process, and that process."""
    child = subprocess.Popen([sys.executable, "-c", OWNER, str(home)], stdout=subprocess.PIPE, text=True)
    return Path(child.stdout.readline().strip()), child


def test_folders_of_dead_owners_go_and_others_stay(tmp_path):
    mine, (theirs, child) = LockedTempFolder(tmp_path), owned(tmp_path)
    try:
        assert stat.S_IMODE(mine.path.stat().st_mode) == 0o700
        (theirs / "seat-0").write_bytes(b"picture")
        assert _remove_stale(tmp_path) == 0
        assert (theirs / "seat-0").exists()
    finally:
        child.kill()
        child.communicate()
    assert _remove_stale(tmp_path) == 1
    assert [path.name for path in tmp_path.iterdir()] == [mine.path.name]
    mine.close()
    mine.close()
    assert list(tmp_path.iterdir()) == []


def test_who_cannot_see_a_process_leaves_its_folder_alone(tmp_path, monkeypatch):
    """As in a container that shares the place: there, no number means the same process."""
    monkeypatch.setattr(os, "kill", lambda pid, number: (_ for _ in ()).throw(ProcessLookupError()))
    mine = LockedTempFolder(tmp_path)
    other = tmp_path / mine.path.name.replace(f"-{os.getpid()}-", "-4194305-")
    mine.path.rename(other)
    assert _remove_stale(tmp_path) == 0
    assert (other / LOCK).exists()


def test_a_folder_without_a_lock_goes_when_it_is_empty(tmp_path):
    for name in ("wcsim-ring-12-empty", "wcsim-ring-13-full", "wcsim-ring-mine"):
        (tmp_path / name).mkdir()
    (tmp_path / "wcsim-ring-13-full" / "seat-0").touch()
    (tmp_path / "wcsim-ring-14-link").symlink_to(tmp_path / "wcsim-ring-13-full")
    assert _remove_stale(tmp_path) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"wcsim-ring-13-full", "wcsim-ring-14-link", "wcsim-ring-mine"}
