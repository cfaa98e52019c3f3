"""Training in several towns: they take turns, the run folder keeps them, and no other ones are taken on resume."""

from pathlib import Path

import pytest

from tests.cli.conftest import QUICK
from tests.conftest import ROOT
from tests.support.events import read_events
from wcsim.agents.runs.run_folder import open_run
from wcsim.cli import serve
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import open_town, streets_hash
from wcsim.towns.scene_folders.build import build_scene, find_scene

FEW = ("--set", "learn.total_steps=24", "--set", "learn.phase1_steps=8", "--set", "world.epoch_ticks=8")
EPISODES = ("--set", "learn.episode_steps=4")


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second small town."""
    work = tmp_path_factory.mktemp("other")
    build_scene(find_scene(str(ROOT / "scenarios" / "sumo" / "scenes" / "two-chairs")), work)
    return work


def towns_told(run: Path) -> list[str]:
    return [event["town"] for event in read_events(run) if event["event"] == "town"]


def test_towns_take_turns_and_resume_goes_on_with_them(wcsim, folder, corner, other):
    words = ("train-q", "--town", f"{corner},{other}", "--out", "run", *QUICK, *FEW, *EPISODES)
    done = wcsim(*words)
    assert done.code == 0, done.err
    name = open_town(corner).name
    run = folder / "run"
    told = towns_told(run)
    assert set(told) == {corner.name, other.name} and told[0] == told[2] and len(told) >= 3
    manifest = open_run(run).manifest
    assert (manifest.town, list(manifest.more_towns.values())) == (name, [streets_hash(open_town(other))])
    again = wcsim("train-q", "--out", "same", *words[1:3], *words[5:])
    assert again.code == 0 and towns_told(folder / "same") == told
    longer = wcsim("resume", "run", "--steps", "40")
    assert longer.code == 0, longer.err
    assert open_run(run).manifest.steps == 40 and len(towns_told(run)) > len(told)
    for typed in (str(corner), f"{other},{corner}"):
        refused = wcsim("resume", "run", "--town", typed)
        assert refused.code == 2 and "--town" in refused.err
    assert wcsim("resume", "run", "--town", f"{corner},{other}").code == 0
    tested = wcsim("test", "run", "--town", other, "--only", "--episodes", "1", "--max-steps", "2")
    assert tested.code == 2 and "was trained in" in tested.err
    assert wcsim("report", "run").code == 0
    page = (run / "report.html").read_text()
    assert name in page and other.name in page


def test_a_served_world_changes_town_as_a_training_does(wcsim, corner, other, monkeypatch):
    def plan(order, *place):
        raise ConfigError(f"{order.town} then {order.more_towns}")

    monkeypatch.setattr(serve, "make_world_launch_plan", plan)
    words = ("serve", "--town", f"{corner},{other}", *QUICK)
    assert f"{corner} then ('{other}',)" in wcsim(*words, "--run", "w").err
    for more in ((), ("--run", "w", "--set", "world.epoch_ticks=0")):
        assert "the world never changes town" in wcsim(*words, *more).err


BAD = {
    "corner,corner": "a town comes twice",
    "corner,monaco": "monaco is a test town",
    "made:x": "expected made:SEED with a seed",
    ",": "expected one or more names",
}


@pytest.mark.parametrize("town", BAD)
def test_towns_that_cannot_be_used_are_refused_before_a_folder_is_made(wcsim, folder, corner, town):
    for words in (("train-q",), ("train-clients", "patch,fig6"), ("train",)):
        done = wcsim(*words, "--town", town.replace("corner", str(corner)), "--out", "run")
        assert done.code == 2 and BAD[town] in done.err and not (folder / "run").exists()
