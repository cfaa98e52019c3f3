"""Checkpoints of a danger network that learns as it drives: damaged in any place, the one before is taken."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.agents.online.test_train_online import Sensing, config
from tests.agents.toy import a_run
from wcsim.agents.collecting.data_folder import DATA, SEGMENTS
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.learner_files import STATE
from wcsim.agents.learning.checkpoint_file import step_folders
from wcsim.agents.online.online_checkpoint import load_online
from wcsim.agents.online.taught_ride import TaughtRide
from wcsim.agents.online.train_online import Listeners, train_online
from wcsim.agents.rounds.round_checkpoint import digest_of
from wcsim.agents.runs.run_folder import open_run
from wcsim.errors import PolicyError

ENTRIES = (
    "schema_version", "step", "episodes", "crashes", "phase1_done", "updates", "loss", "segments", "explore_rng",
    "lectures_rng", "sha256", "seal",
)  # fmt: skip


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    asked = a_run(config(), tmp_path_factory.mktemp("sound") / "run", 5, town="toy", town_sha256="0" * 64)
    return train_online(asked, Sensing)


@pytest.fixture
def run(done, tmp_path) -> Path:
    return shutil.copytree(done, tmp_path / "run")


def loaded(run: Path):
    """What a run goes on from, its learner and what it learns from."""
    learner, ride = DangerLearner(config(), 9, 60), TaughtRide(config(), run / DATA, 5)
    found = load_online(run / "checkpoints", learner, ride)
    assert found is not None
    return *found, learner, ride


def newest(run: Path) -> Path:
    return step_folders(run / "checkpoints")[-1]


def other(value):
    """The same with another digit, or another flag, in its first place."""
    if isinstance(value, dict):
        first = next(iter(value))
        return {**value, first: other(value[first])}
    if isinstance(value, list):
        return [other(value[0]), *value[1:]]
    if isinstance(value, str):
        return ("1" if value[0] == "0" else "0") + value[1:]
    return not value if isinstance(value, bool) else value + 1


def test_the_newest_sound_one_is_what_the_run_was(run):
    state, told, learner, ride = loaded(run)
    assert (told.path.name, told.sealed, told.passed_over) == ("step-00000240", True, ())
    assert (state.counters.step, state.counters.phase1_done) == (240, True)
    assert learner.updates == json.loads((told.path / STATE).read_text())["updates"] > 40
    assert len(ride.lectures) > 0 and ride.segments == state.segments


@pytest.mark.parametrize("entry", ENTRIES)
def test_another_digit_anywhere_in_its_state_and_the_one_before_is_taken(run, entry):
    before = loaded(run)
    file = newest(run) / STATE
    data = json.loads(file.read_text())
    assert set(data) == set(ENTRIES)
    file.write_text(json.dumps({**data, entry: other(data[entry])}))
    state, told, learner, ride = loaded(run)
    assert state.counters.step == 180 and [item.path for item in told.passed_over] == [newest(run)]
    shutil.rmtree(newest(run))
    _, _, same, again = loaded(run)
    assert digest_of(learner.net) == digest_of(same.net) != digest_of(before[2].net)
    assert len(ride.lectures) == len(again.lectures) and ride.segments == again.segments


@pytest.mark.parametrize("damage", ["name", "segment", "lost"])
def test_another_name_or_segment_and_the_one_before_is_taken(run, damage):
    file = run / DATA / SEGMENTS / sorted(json.loads((newest(run) / STATE).read_text())["segments"])[-1]
    if damage == "name":
        newest(run).rename(newest(run).with_name("step-00000241"))
    elif damage == "segment":
        file.write_bytes(file.read_bytes()[:-1] + b"x")
    else:
        file.unlink()
    told, street = [], Sensing()
    asked = a_run(config("learn.total_steps=240"), run, 5, town="toy", town_sha256="0" * 64, resume=True)
    train_online(asked, lambda: street, Listeners(say=told.append))
    assert len(told) == 1 and "continuing from step-00000180" in told[0]
    assert street.steps == 60 and open_run(run).manifest.steps == 240


OUT_OF_BOUNDS = {
    "step": 10**13, "episodes": -1, "crashes": "1", "phase1_done": 1, "updates": None, "loss": "0.1",
    "segments": {"../5-000-0000.npz.zst": "0" * 64}, "explore_rng": {}, "lectures_rng": None, "sha256": {},
}  # fmt: skip


def test_one_of_the_version_before_has_no_seal_and_is_held_against_its_bounds(run):
    file = newest(run) / STATE
    data = json.loads(file.read_text())
    del data["seal"], data["schema_version"]
    file.write_text(json.dumps(data))
    state, told, *_ = loaded(run)
    assert (state.counters.step, told.sealed) == (240, False)
    for entry, value in OUT_OF_BOUNDS.items():
        file.write_text(json.dumps({**data, entry: value}))
        assert loaded(run)[0].counters.step == 180, entry


def test_none_that_is_sound_is_told_with_what_is_wrong_with_each(run):
    for folder in step_folders(run / "checkpoints"):
        (folder / STATE).write_text("{}")
    with pytest.raises(PolicyError, match=r"no intact checkpoint that fits \(step-00000240: state.json has the keys"):
        loaded(run)
