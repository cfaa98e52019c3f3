"""PPO in one file, in the manner of CleanRL: `python cleanrl_ppo.py [TOWN] [STEPS]`. Read it, then change it.

Eight chairs of one street learn together from numbers (`env.observation=state`), with any stick (`env.actions=stick`).
The network's answer is added to the user's stick, so that an untrained one follows its user.
"""

import sys
import time
from collections.abc import Iterator

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import wcsim

SETTINGS = ("env.observation=state", "env.actions=stick", "env.max_steps=600")
CHAIRS, ROLLOUT, EPOCHS, BATCHES = 8, 128, 4, 4
RATE, GAMMA, LAMBDA, CLIP, VALUE, MOST_GRADIENT = 1e-3, 0.97, 0.95, 0.2, 0.5, 0.5
REWARD_SCALE = 0.1  # a crash costs 100, a step is worth 1


def layer(wide: int, narrow: int, gain: float = 2**0.5) -> nn.Linear:
    """A layer with orthogonal weights, as PPO is begun."""
    made = nn.Linear(wide, narrow)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


class Agent(nn.Module):
    """Actor and critic, each with two hidden layers."""

    def __init__(self, numbers: int) -> None:
        super().__init__()
        heads = []
        for size, gain in ((2, 0.01), (1, 1.0)):
            hidden = (nn.Flatten(), layer(numbers, 64), nn.Tanh(), layer(64, 64), nn.Tanh())
            heads.append(nn.Sequential(*hidden, layer(64, size, gain)))
        self.actor, self.critic = heads
        self.log_std = nn.Parameter(torch.full((2,), -1.6))  # 0.2 of the stick's way, at first

    def stick(self, seen: torch.Tensor) -> Normal:
        """Where the stick may be put, for frames (N, rows, columns)."""
        user = seen[:, 0, 1:3]  # row 0 is of the chair itself, and has its user's stick
        return Normal(user + self.actor(seen), self.log_std.exp())

    def value(self, seen: torch.Tensor) -> torch.Tensor:
        """What is still to be earned, (N,)."""
        return self.critic(seen)[:, 0]


def advantages(rewards: torch.Tensor, values: torch.Tensor, after: torch.Tensor, done: torch.Tensor) -> torch.Tensor:
    """Generalised advantage estimation over a rollout (T, N); `after` is the value of what really came next."""
    found, last = torch.zeros_like(rewards), torch.zeros(rewards.shape[1])
    for t in reversed(range(len(rewards))):
        gain = rewards[t] + GAMMA * after[t] - values[t]
        found[t] = last = gain + GAMMA * LAMBDA * (1.0 - done[t]) * last
    return found


def rollout(env: gymnasium.vector.VectorEnv, agent: Agent, seen: torch.Tensor, steps: int) -> tuple:
    """Drive for `steps` ticks; returns what was seen, done and earned (T, N, ...), and the frame after it."""
    kept, ended = [], {"successes": [], "crashes": []}
    for _ in range(steps):
        with torch.no_grad():
            chances = agent.stick(seen)
            stick = chances.sample()
            likely, value = chances.log_prob(stick).sum(1), agent.value(seen)
        shown, reward, crashed, cut, infos = env.step(stick.clamp(-1.0, 1.0).numpy())
        following, done = torch.from_numpy(shown), torch.from_numpy(crashed | cut)
        last = following.clone()
        for chair in np.flatnonzero(crashed | cut):  # `following` is of the next episode there
            last[chair] = torch.from_numpy(infos["final_obs"][chair])
            ended["successes"].append(infos["final_info"]["is_success"][chair])
            ended["crashes"].append(crashed[chair])
        with torch.no_grad():
            after = agent.value(last) * torch.from_numpy(~crashed)
        reward = torch.from_numpy(reward).float()
        kept.append((seen, stick, likely, value, reward, after, done.float()))
        seen = following
    return (*(torch.stack(item) for item in zip(*kept, strict=True)), ended, seen)


def improve(agent: Agent, best: torch.optim.Optimizer, batch: tuple[torch.Tensor, ...]) -> None:
    """One step down the clipped loss of PPO."""
    seen, stick, likely, gain, wanted = batch
    ratio = (agent.stick(seen).log_prob(stick).sum(1) - likely).exp()
    gain = (gain - gain.mean()) / (gain.std() + 1e-8)
    policy = -torch.min(gain * ratio, gain * ratio.clamp(1.0 - CLIP, 1.0 + CLIP)).mean()
    loss = policy + VALUE * (agent.value(seen) - wanted).square().mean()
    best.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(agent.parameters(), MOST_GRADIENT)
    best.step()


def train(town: str, steps: int, settings: tuple[str, ...] = SETTINGS, chairs: int = CHAIRS) -> Iterator[dict]:
    """Train for so many steps of all chairs together; a row of numbers for each update."""
    torch.manual_seed(1)
    torch.set_num_threads(1)  # more threads only wait for each other in small updates
    env = gymnasium.make_vec(wcsim.ENV_ID, num_envs=chairs, town=town, overrides=settings)
    agent = Agent(int(np.prod(env.single_observation_space.shape)))
    best = torch.optim.Adam(agent.parameters(), RATE, eps=1e-5)
    begun_s = time.perf_counter()
    try:
        seen = torch.from_numpy(env.reset(seed=1)[0])
        ticks = min(ROLLOUT, max(8, steps // chairs))
        for update in range(1, steps // (chairs * ticks) + 1):
            frames, sticks, likely, values, rewards, after, done, ended, seen = rollout(env, agent, seen, ticks)
            gains = advantages(REWARD_SCALE * rewards, values, after, done)
            data = [item.flatten(0, 1) for item in (frames, sticks, likely, gains, gains + values)]
            for _ in range(EPOCHS):
                for some in torch.randperm(len(data[0])).chunk(BATCHES):
                    improve(agent, best, tuple(item[some] for item in data))
            row = {"steps": update * chairs * ticks, "reward": float(rewards.mean())}
            row |= {key: float(np.sum(found)) for key, found in ended.items()}
            yield {**row, "seconds": round(time.perf_counter() - begun_s, 1)}
    finally:
        env.close()


if __name__ == "__main__":
    town, steps = [*sys.argv[1:], *("helsinki", "40000")[len(sys.argv) - 1 :]]
    for row in train(town, int(steps)):
        sys.stdout.write(" ".join(f"{key}={value:.5g}" for key, value in row.items()) + "\n")
        sys.stdout.flush()
