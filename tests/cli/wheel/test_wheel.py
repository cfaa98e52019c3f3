"""The built wheel, away from the checkout: everything that the commands need is inside."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.support.tracked import tracked
from wcsim.agents.runs.policy_file import FILES, HELD
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel as pip would lay it out."""
    place = tmp_path_factory.mktemp("wheel")
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


def test_a_shipped_town_opens(unpacked, tmp_path):
    load_street(find_town("manhattan"))  # once, so that no command has to
    assert "trips without a route" in run(unpacked, tmp_path, "town", "check", "manhattan")


def test_a_shipped_policy_goes_into_the_wheel(tmp_path):
    """What `tools/ship_policy.py` writes, in a copy of the project with nothing else."""
    held = (*HELD, FILES)
    loop = "examples/exported_policy.py"
    for name in ("pyproject.toml", "README.md", "LICENSE", ".gitignore", "wcsim/__init__.py", loop):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    (tmp_path / "scenarios" / "sumo").mkdir(parents=True)
    place = tmp_path / "wcsim" / "agents" / "shipped"
    place.mkdir(parents=True)
    for name in held:
        (place / name).write_text(name)
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(tmp_path)]
    subprocess.run(build, check=True, capture_output=True)
    with zipfile.ZipFile(next(tmp_path.glob("*.whl"))) as wheel:
        assert {f"wcsim/agents/shipped/{name}" for name in held} <= set(wheel.namelist())
