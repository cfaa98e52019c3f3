"""A run that learns from groups: killed and resumed, it learns what it would have learned."""

import signal
import subprocess
import sys

import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

from tests.agents.learning.test_train import Nervous, weights
from tests.agents.toy import ToyStreet, load_checkpoint, q_config, same_from_here_on, toy_camera, train_toy
from wcsim.agents.learning.build import build_q_learner
from wcsim.agents.learning.checkpoint import save_checkpoint
from wcsim.agents.runs.checkpoint import list_checkpoints
from wcsim.agents.runs.run_folder import open_run

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
        "train_every": 2,
    }  # fmt: skip
    return q_config(CAMERA, **{**small, **learn})


def drive(out, epsilon, resume=False, at=-9):
    """Train to the end, or be killed a few steps after step `at`; the resumed sitting meets the same street."""
    done = int(list_checkpoints(out / "checkpoints")[-1].name[5:]) if resume else 0
    street = Nervous(at + 7, lambda: signal.raise_signal(signal.SIGKILL), Fixed(done // EPISODE))
    explores = {"epsilon_start": epsilon, "epsilon_end": epsilon}
    short = config(replay_frames=100, checkpoint_every=50, **explores)  # at HALF, the oldest frames are gone
    return train_toy(short, out, lambda: street, resume=resume)


@pytest.mark.proof
@pytest.mark.parametrize("epsilon", [0.1, 1.0])
def test_killed_with_groups_it_learns_what_it_would_have_learned(tmp_path, epsilon):
    straight = drive(tmp_path / "straight", epsilon)
    killed = f"Path({str(tmp_path / 'killed')!r})"
    code = f"from pathlib import Path; from {__name__} import drive; drive({killed}, {epsilon}, at={HALF})"
    killed = subprocess.run([sys.executable, "-c", f"import torch; torch.set_num_threads(1); {code}"], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert list_checkpoints(tmp_path / "killed" / "checkpoints")[-1].name == f"step-{HALF:08d}"
    again = drive(tmp_path / "killed", epsilon, resume=True)
    assert open_run(again).manifest.steps == STEPS
    assert weights(again) == weights(straight)


def test_a_checkpoint_restores_states(tmp_path):
    wrote = build_q_learner(config(), DummyVecEnv([Fixed]), 1)
    wrote.learn(120)
    save_checkpoint(tmp_path / "checkpoints", wrote, {})
    again = build_q_learner(config(), DummyVecEnv([Fixed]), 2)
    load_checkpoint(tmp_path / "checkpoints", again)
    assert len(again.replay_buffer.groups.states) > 10
    assert same_from_here_on(wrote, again, batch=16)
