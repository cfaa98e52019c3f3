"""The Python of the tutorials and of the README runs as it stands there, but for the town and the length."""

import io
import re
import runpy
import subprocess
from contextlib import chdir, redirect_stdout
from pathlib import Path

import pytest

from tests.support.tracked import ROOT
from wcsim.agents.opening.list_file import open_suite
from wcsim.users.recordings.recorded_user import read_stick_recording

TUTORIALS = ROOT / "docs" / "tutorials"
NO_WARMUP = 'overrides=("world.warmup_s=0", "env.max_steps=20")'
SHORTER = (
    ("range(50)", "range(5)"),
    ("model.learn(1_000)", "model.learn(60)"),
    ("learning_starts=200", "learning_starts=20"),
)


def code_of(page: Path, language: str = "python") -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def small(code: str, corner: Path) -> str:
    """The same in a street corner, for a few steps."""
    for long, short in SHORTER:
        code = code.replace(long, short)
    return code.replace('"helsinki"', f"{str(corner)!r}, {NO_WARMUP}")


def run(code: str, folder: Path) -> str:
    """What it prints, as a script of its own in this folder; a warning is an error here too."""
    file = folder / "tutorial.py"
    file.write_text(code)
    with chdir(folder), redirect_stdout(io.StringIO()) as told:
        runpy.run_path(str(file), run_name="__main__")
    return told.getvalue()


def test_the_environment_of_the_readme_steps(corner: Path, tmp_path: Path) -> None:
    (code,) = code_of(ROOT / "README.md")
    run(small(code, corner) + "env.close()\n", tmp_path)


def test_the_learners_code_runs(corner: Path, tmp_path: Path) -> None:
    loop, network, sb3 = code_of(TUTORIALS / "learner.md")
    told = run(small(loop, corner), tmp_path).splitlines()
    page = (TUTORIALS / "learner.md").read_text()
    assert told[:4] == re.findall(r"^(?:seg|depth|imu|joystick) \(.*$", page, re.MULTILINE)
    assert told[4].startswith("action space: Discrete(81)")
    assert network == (ROOT / "examples" / "own_network.py").read_text()  # which has tests of its own
    run(small(sb3, corner), tmp_path)
    assert (tmp_path / "dqn.zip").is_file()


def test_the_scripts_about_a_recording_and_a_list_run(tmp_path: Path) -> None:
    recording, cut = code_of(TUTORIALS / "assistive-technology.md")
    run(recording, tmp_path)
    assert read_stick_recording(tmp_path / "stick.csv").time_s[-1] == 19.95
    assert len(set(run(cut, tmp_path).split())) == 4
    assert {block.part for block in open_suite(str(tmp_path / "ten.json")).file.blocks} == {"scenes"}


def test_other_tutorials_have_no_python() -> None:
    tested = {"learner.md", "assistive-technology.md"}
    assert {page.name for page in TUTORIALS.glob("*.md") if code_of(page)} == tested


def test_the_contributors_change_can_be_made(tmp_path: Path) -> None:
    """Its patch fits the files of today, and does what the text says."""
    (patch,) = code_of(TUTORIALS / "contributor.md", "diff")
    names = re.findall(r"^\+\+\+ b/(.+)$", patch, re.MULTILINE)
    assert len(names) == 2
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    apply = ["git", "apply", "-"]
    done = subprocess.run(apply, input=patch, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "[tired]" in (tmp_path / names[1]).read_text()


@pytest.mark.parametrize("page", sorted(TUTORIALS.glob("*.md")), ids=lambda page: page.stem)
def test_a_tutorial_says_first_what_one_will_have_and_how_long_it_takes(page: Path) -> None:
    said = page.read_text().partition("\n## ")[0]
    assert "**You will have**" in said
    assert "**It takes**" in said
    steps = re.findall(r"^## \d.*$", page.read_text(), re.MULTILINE)
    assert len(steps) >= 5
