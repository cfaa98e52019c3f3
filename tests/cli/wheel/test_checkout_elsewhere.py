"""The checkout in other places and surroundings: a sample of its tests passes in each."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.cli.wheel.test_wheel_elsewhere import LIBRARIES, UID, interpreter
from tests.support.tracked import ROOT, tracked

pytestmark = [
    pytest.mark.proof,
    pytest.mark.timeout(1500),
    pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else, or without a network"),
]
SAMPLE = [
    "tests/api/test_package.py",
    "tests/benchmarks/tick/test_tick_profile.py",
    "tests/cli/shared/test_told_cause.py",
    "tests/cli/test_commands.py",
    "tests/server/host/test_server_parts.py",
    "tests/towns/checks/test_faults.py",
    "tests/towns/furniture/test_buildings.py",
]
MEMORY = Path("/dev/shm")  # noqa: S108


@pytest.mark.parametrize(
    "place, before, env",
    [
        ("wcsim/wcsim", "", {}),
        ("Fährt d'été (2)/libsumo/numba/wcsim", "umask 077 &&", {"LC_ALL": "C", "TZ": "Pacific/Chatham"}),
        ("long temporary folder on another disk", "", {"TMPDIR": str(MEMORY / (97 * "x"))}),
        ("another user", f"setpriv --reuid={UID} --regid={UID} --clear-groups", {"HOME": "/nowhere"}),
        ("no network", "ip link set lo up &&", {}),
    ],
)
def test_a_sample_passes(place: str, before: str, env: dict[str, str]) -> None:
    with tempfile.TemporaryDirectory(prefix="wcsim-elsewhere-", dir="/tmp") as work:
        top, temporary = Path(work) / place, Path(env.get("TMPDIR", f"{work}/t"))
        for path in tracked():
            there = top / path.relative_to(ROOT)
            there.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, there)
        temporary.mkdir(exist_ok=True)
        for folder, mode in ((Path(work), 0o755), (temporary, 0o777)):
            folder.chmod(mode)
        python = interpreter() if "setpriv" in before else sys.executable
        here = {**os.environ, "PYTHONPATH": f"{top}:{LIBRARIES}", "TMPDIR": str(temporary), **env}
        words = ["-m", "pytest", "-q", "-n", "0", "-m"]
        command = ["bash", "-c", f'{before} "$0" "$@"', python, *words, "not proof", *SAMPLE]
        alone = ["unshare", "--net"] if place == "no network" else []
        done = subprocess.run([*alone, *command], cwd=top, env=here, capture_output=True, text=True, check=False)
        shutil.rmtree(temporary)
    assert done.returncode == 0, done.stdout[-3000:]
