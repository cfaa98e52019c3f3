"""The module of three.js that the pages load is what its script makes."""

import shutil
import subprocess
from pathlib import Path

import pytest

from wcsim.drive.serving.server import PAGE

BUILD = Path(__file__).parents[3] / "tools" / "three"


def test_it_carries_its_licence_and_one_version() -> None:
    assert "SPDX-License-Identifier: MIT" in (PAGE / "three.js").read_text()[:300]
    assert "three.js authors" in (PAGE / "three.LICENSE").read_text()


@pytest.mark.proof
@pytest.mark.skipif(shutil.which("npm") is None, reason="no npm here: install Node.js to build three.js again")
def test_the_script_makes_the_same_module(tmp_path: Path) -> None:
    place = shutil.copytree(BUILD, tmp_path / "three")
    got = subprocess.run(["npm", "install", "--no-audit", "--no-fund"], cwd=place, capture_output=True, check=False)
    if got.returncode:
        pytest.skip(f"npm finds no packages here: {got.stderr.decode()[-200:]}")
    subprocess.run(["npm", "run", "-s", "build"], cwd=place, check=True, capture_output=True)
    assert (place / "three.js").read_bytes() == (PAGE / "three.js").read_bytes()
