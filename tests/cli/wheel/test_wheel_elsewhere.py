"""The built wheel as another user has it: installed by root, no home, no name, no compiler, a read-only folder."""

import os
import pwd
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import pytest

from tests.cli.wheel.test_wheel import unpacked_in
from tests.view.films import frames_of

pytestmark = [
    pytest.mark.proof,
    pytest.mark.timeout(1500),
    pytest.mark.skipif(os.geteuid() != 0, reason="only root can run something as another user"),
]
LIBRARIES = Path(cv2.__file__).parents[1]
UID = next(number for number in range(61234, 65000) if number not in {user.pw_uid for user in pwd.getpwall()})


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where that user may be."""

    python: str  # that this user may run
    site: Path  # root's, with wcsim
    own: Path  # the user's, which can be written
    temporary: Path  # the user's

    def run(self, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
        """`wcsim WORDS` in a folder."""
        return as_user(
            [self.python, "-m", "wcsim", *words],
            cwd=folder,
            env={
                "PATH": "/nonexistent",
                "PYTHONPATH": f"{self.site}:{LIBRARIES}",
                "TMPDIR": str(self.temporary),
                "LANG": "C.UTF-8",
                "COLUMNS": "200",
            },
        )


def as_user(command: list[str], cwd: Path, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=cwd, env=env, user=UID, group=UID, extra_groups=[], capture_output=True, text=True, check=False
    )


def interpreter() -> str:
    """A Python of this version that the user may run with these libraries, as root's home may be closed to them."""
    name = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    for found in (os.path.realpath(sys.executable), shutil.which(name, path="/usr/local/bin:/usr/bin")):
        if found is None:
            continue
        try:
            done = as_user([found, "-c", "import numba, libsumo"], Path("/"), {"PYTHONPATH": str(LIBRARIES)})
        except OSError:
            continue
        if done.returncode == 0:
            return found
    return ""


@pytest.fixture(scope="module")
def place() -> Iterator[Place]:
    """The wheel laid out by root, and two folders of the user."""
    python = interpreter()
    if not python:
        pytest.skip("no interpreter here that another user may run with these libraries")
    with tempfile.TemporaryDirectory(prefix="wcsim-elsewhere-", dir="/tmp") as top:
        folder = Path(top)
        folder.chmod(0o755)
        site = unpacked_in(folder)
        for path in (site, *site.rglob("*")):
            path.chmod(0o755 if path.is_dir() else 0o644)
        own, temporary = folder / "own", folder / "tmp"
        for mine in (own, temporary):
            mine.mkdir(mode=0o700)
            os.chown(mine, UID, UID)
        yield Place(python=python, site=site, own=own, temporary=temporary)


def kept(place: Place) -> set[Path]:
    return {path for path in place.temporary.rglob("*") if path.suffix in (".npz", ".nbc")}


def test_a_look_leaves_a_picture_and_a_film(place):
    done = place.run(place.own, "look", "manhattan", "--seconds", "1")
    assert done.returncode == 0, done.stderr
    assert cv2.imread(str(place.own / "look" / "manhattan.png")).std() > 5.0
    assert len(frames_of(place.own / "look" / "manhattan.webm")) == 10
    assert {path.name for path in place.own.iterdir()} == {"look"}, "no folder that is called ~"


def test_a_scene_runs_in_a_folder_that_cannot_be_written(place):
    before = sorted(place.site.rglob("*"))
    first = place.run(place.site, "scene", "run", "car-at-zebra")
    assert (first.returncode, "ok" in first.stdout) == (0, True), first.stderr
    assert sorted(place.site.rglob("*")) == before, "root's folder is as it was"
    cache = place.temporary / f"wcsim-cache-{UID}"
    assert cache.stat().st_mode & 0o777 == 0o700
    assert list(cache.glob("street-*.npz")) and len(list(cache.rglob("*.nbc"))) > 20
    code = kept(place)
    again = place.run(place.site, "scene", "run", "car-at-zebra")
    assert (again.returncode, "building" in again.stderr) == (0, False)
    assert kept(place) == code, "nothing was built or compiled a second time"


@pytest.mark.parametrize("words", [("look",), ("demo",), ("train",), ("snapshot",), ("video",)])
def test_where_nothing_can_be_written_a_line_says_so_at_once(place, words):
    done = place.run(place.site, *words)
    assert (done.returncode, done.stdout) == (2, "")
    told = f"{place.site} is not a folder that can be written to; choose another with --out"
    assert done.stderr == f"wcsim: --out: {told}\n"
