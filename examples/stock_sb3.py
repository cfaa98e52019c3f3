"""Stable-Baselines3's own DQN and PPO in wcsim's street: `python stock_sb3.py [TOWN] [STEPS]`."""

import sys
from pathlib import Path

import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env import VecMonitor

import wcsim
from wcsim.agents.networks.encoder import ObservationEncoder

PICTURES = ("cameras.0.width_px=80", "cameras.0.height_px=60")  # as in preset quick
POLICY = {"features_extractor_class": ObservationEncoder, "normalize_images": False, "net_arch": [64]}


def learn(town: str, steps: int, out: Path, overrides: tuple[str, ...] = PICTURES, chairs: int = 2) -> list[Path]:
    """Train both in turn in one world; returns their files."""
    torch.set_num_threads(1)  # more threads only wait for each other in every small update
    env = VecMonitor(wcsim.StreetVecEnv(town, chairs=chairs, overrides=overrides))
    rollout = max(2, min(256, steps // chairs))
    dqn = {"buffer_size": 10_000, "learning_starts": min(500, steps // 4), "batch_size": min(32, rollout)}
    ppo = {"n_steps": rollout, "batch_size": rollout * chairs, "n_epochs": 4}
    saved = []
    try:
        for kind, settings in ((DQN, dqn), (PPO, ppo)):
            model = kind("MultiInputPolicy", env, policy_kwargs=POLICY, seed=1, device="cpu", **settings)
            model.learn(steps)
            saved.append(out / f"{kind.__name__.lower()}.zip")
            model.save(saved[-1])
            kind.load(saved[-1], env=env, device="cpu")  # loading a zip file runs its code
    finally:
        env.close()
    return saved


if __name__ == "__main__":
    town, steps = [*sys.argv[1:], *("helsinki", "10000")[len(sys.argv) - 1 :]]
    for path in learn(town, int(steps), Path()):
        sys.stdout.write(f"{path}\n")
