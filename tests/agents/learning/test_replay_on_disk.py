"""A run whose frames are on disk: killed and gone on with, it learns what it would have learned."""

import json
import shutil
import signal
import subprocess
import sys

import pytest
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv

from tests.agents.toy import ToyStreet, a_run, same_from_here_on, toy_camera
from wcsim.agents.learning.build import build_model
from wcsim.agents.learning.checkpoint import load_checkpoint, save_checkpoint
from wcsim.agents.learning.checkpoint_file import step_folders
from wcsim.agents.learning.train import train
from wcsim.agents.replay.disk_store import blobs_path, index_path, segments_in
from wcsim.agents.runs.run_folder import open_run
from wcsim.config import LearnConfig, RunConfig
from wcsim.errors import InterruptedRunError, PolicyError

CAMERA = toy_camera(16, 20)
EPISODE = 25  # steps: every checkpoint is taken where an episode ends
STEPS, HALF = 300, 150


class Fixed(ToyStreet):
    """The n-th episode is the same in every sitting, as the checkpoint's counter says which one begins."""

    def __init__(self, first=0):
        super().__init__(CAMERA, max_steps=EPISODE, obstacles=1)
        self.number = first

    def reset(self, *, seed=None, options=None):
        self.number += 1
        return super().reset(seed=1000 + self.number)

    def clearance(self):
        return 1.0


def config(**learn):
    small = {
        "total_steps": STEPS, "phase1_steps": 100, "learning_starts": 20, "replay_frames": 200, "batch_size": 16,
        "checkpoint_every": 100, "network": "fig6", "memory": "groups", "group_steps": 8, "burn_in": 4,
        "replay_store": "disk", "train_every": 2,
    }  # fmt: skip
    return RunConfig(cameras=(CAMERA,), learn=LearnConfig(**{**small, **learn}))


def weights(path):
    return (path / "policies" / "final" / "weights.safetensors").read_bytes()


def drive(out, epsilon, resume=False, at=None):
    """Train to the end, or be killed a few steps after step `at`; the resumed sitting meets the same street."""
    done = int(step_folders(out / "checkpoints")[-1].name[5:]) if resume else 0

    class Killed(Fixed):
        steps = 0

        def step(self, action):
            self.steps += 1
            if at is not None and self.steps == at + 7:
                signal.raise_signal(signal.SIGKILL)
            return super().step(action)

    explores = {"epsilon_start": epsilon, "epsilon_end": epsilon}
    short = config(replay_frames=100, checkpoint_every=50, **explores)  # at HALF, the oldest frames are gone
    return train(a_run(short, out, 5, resume=resume), lambda: Killed(done // EPISODE))


@pytest.mark.proof
@pytest.mark.parametrize("epsilon", [0.1, 1.0])
def test_killed_with_groups_on_disk_it_learns_what_it_would_have_learned(tmp_path, epsilon):
    straight = drive(tmp_path / "straight", epsilon)
    assert (straight / "replay").is_dir()
    killed = f"Path({str(tmp_path / 'killed')!r})"
    code = f"from pathlib import Path; from {__name__} import drive; drive({killed}, {epsilon}, at={HALF})"
    killed = subprocess.run([sys.executable, "-c", f"import torch; torch.set_num_threads(1); {code}"], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert step_folders(tmp_path / "killed" / "checkpoints")[-1].name == f"step-{HALF:08d}"
    again = drive(tmp_path / "killed", epsilon, resume=True)
    assert open_run(again).manifest.steps == STEPS
    assert weights(again) == weights(straight)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A run that was stopped after 250 steps."""
    out = tmp_path_factory.mktemp("stopped") / "run"

    def stop(now):
        if now.step >= 250 and not (out / "stopped").exists():
            (out / "stopped").touch()
            raise KeyboardInterrupt

    with pytest.raises(InterruptedRunError):
        train(a_run(config(), out, 5), Fixed, stop, progress_every=10)
    return out


def loaded(out, seed):
    learner = build_model(config(), DummyVecEnv([Fixed]), seed, out / "replay")
    try:
        found = load_checkpoint(out / "checkpoints", learner)
        learner.set_logger(configure(None, []))
        learner.train(5, 16)
        return found, learner
    finally:
        learner.replay_buffer.close()


def test_a_checkpoint_restores_states(tmp_path):
    wrote = build_model(config(), DummyVecEnv([Fixed]), 1, tmp_path / "replay")
    wrote.learn(200)
    save_checkpoint(tmp_path / "checkpoints", wrote, {})
    again = build_model(config(), DummyVecEnv([Fixed]), 2, shutil.copytree(tmp_path / "replay", tmp_path / "copy"))
    load_checkpoint(tmp_path / "checkpoints", again)
    assert len(again.replay_buffer.groups.states) > 10
    assert same_from_here_on(wrote, again, batch=16)
    for each in (wrote, again):
        each.replay_buffer.close()


def test_a_store_that_lost_frames_is_told_in_a_line(stopped):
    out = stopped
    assert segments_in(out / "replay") == [0]
    kept = {path(out / "replay", 0): path(out / "replay", 0).read_bytes() for path in (blobs_path, index_path)}
    index = index_path(out / "replay", 0)
    index.write_bytes(kept[index][: 28 * 150])
    try:
        found, _ = loaded(out, 1)
        assert found.path.name == "step-00000100"
        assert ["lacks 50 of the frames 0 to 200" in item.reason for item in found.passed_over] == [True]
        index.write_bytes(b"")
        with pytest.raises(PolicyError, match=r"no intact checkpoint that fits.*lacks 100"):
            loaded(out, 1)
    finally:
        for path, data in kept.items():
            path.write_bytes(data)


def test_what_was_torn_is_said_and_the_run_goes_on(stopped):
    index = index_path(stopped / "replay", 0)
    index.write_bytes(index.read_bytes()[:-5])
    told = []
    train(a_run(config(), stopped, 5, resume=True), Fixed, say=told.append)
    assert open_run(stopped).manifest.status == "done"
    assert sum("truncated frame were removed" in line for line in told) == 1
    events = [json.loads(line)["event"] for line in (stopped / "events.jsonl").read_text().splitlines()]
    assert "replay_torn" in events
