"""The checkout in other places and surroundings: a sample of its tests passes in each."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.cli.wheel.test_wheel_elsewhere import LIBRARIES, UID, interpreter
from tests.support.tracked import ROOT, tracked

pytestmark = [pytest.mark.proof, pytest.mark.timeout(1500)]
SAMPLE = (
    "tests/api/test_package.py",
    "tests/benchmarks/tick/test_tick_profile.py",
    "tests/cli/shared/test_told_cause.py",
    "tests/cli/test_commands.py",
    "tests/server/host/test_server_parts.py",
    "tests/towns/checks/test_faults.py",
    "tests/towns/furniture/test_buildings.py",
)
MEMORY = Path("/dev/shm")  # noqa: S108
NO_NETWORK = ("unshare", "--net", "bash", "-c", 'ip link set lo up && exec "$0" "$@"')
AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can do so")


@pytest.fixture
def work() -> Iterator[Path]:
    """A folder that any user can enter."""
    with tempfile.TemporaryDirectory(prefix="wcsim-elsewhere-", dir="/tmp") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.mark.parametrize(
    ("place", "before", "env", "more"),
    [
        pytest.param("wcsim/wcsim", (), {}, {}, id="wcsim in wcsim"),
        pytest.param(
            "Fährt d'été (2)/libsumo/numba/wcsim", (), {"LC_ALL": "C", "TZ": "Pacific/Chatham"}, {"umask": 0o077},
            id="odd names, letters, hours and rights",
        ),
        pytest.param("a", (), {"TMPDIR": str(MEMORY / (97 * "x"))}, {}, id="long temporary folder on another disk"),
        pytest.param("a", (), {"HOME": "/nowhere"}, {"user": UID, "group": UID, "extra_groups": ()},
            id="another user", marks=AS_ROOT),
        pytest.param("a", NO_NETWORK, {}, {}, id="no network", marks=AS_ROOT),
    ],
)  # fmt: skip
def test_a_sample_passes(
    work: Path, place: str, before: tuple[str, ...], env: dict[str, str], more: dict[str, Any]
) -> None:
    top, temporary = work / place, Path(env.get("TMPDIR", work / "tmp"))
    for path in tracked():
        there = top / path.relative_to(ROOT)
        there.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, there)
    temporary.mkdir()
    temporary.chmod(0o777)
    more["env"] = {**os.environ, "PYTHONPATH": f"{top}:{LIBRARIES}", "TMPDIR": str(temporary), **env}
    python = interpreter() if "user" in more else sys.executable
    command = [*before, python, "-m", "pytest", "-q", "-n", "0", "-m", "not proof", *SAMPLE]
    try:
        done = subprocess.run(command, cwd=top, capture_output=True, text=True, check=False, **more)
    finally:
        shutil.rmtree(temporary)
    assert done.returncode == 0, done.stdout[-3000:]
