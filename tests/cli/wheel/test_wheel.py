"""The built wheel, away from the checkout: everything that the commands need is inside."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.support.tracked import tracked

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return unpacked_in(tmp_path_factory.mktemp("wheel"))


def unpacked_in(place: Path) -> Path:
    """The wheel as pip would lay it out."""
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(place), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    with zipfile.ZipFile(next(place.glob("*.whl"))) as wheel:
        wheel.extractall(place / "site")
    return place / "site"


def run(unpacked: Path, folder: Path, *words: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(unpacked), "OMP_NUM_THREADS": "1", "COLUMNS": "200"}
    command = [sys.executable, "-m", "wcsim", *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_towns_and_scenes_are_inside(unpacked, tmp_path):
    towns = run(unpacked, tmp_path, "town", "list")
    for name in ("helsinki", "manhattan", "monaco"):
        assert str(unpacked / "wcsim" / "scenarios" / "sumo" / name) in towns
    shipped = {path.parent.name for path in tracked("scenarios/sumo/scenes", "scene.toml")}
    scenes = run(unpacked, tmp_path, "scene", "list")
    assert all(name in scenes for name in shipped)


def test_every_file_that_is_no_code_is_inside(unpacked):
    data = {path.relative_to(ROOT) for path in tracked("wcsim")}
    data |= {Path("wcsim") / path.relative_to(ROOT) for path in tracked("scenarios")}
    data.add(Path("wcsim/examples/exported_policy.py"))
    assert {path for path in data if not (unpacked / path).is_file()} == set()
