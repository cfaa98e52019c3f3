"""PPO in one file, in the manner of CleanRL: `python cleanrl_ppo.py [TOWN] [STEPS] [SEED] [section.key=value ...]`.

Eight chairs of one street learn together from numbers (`env.observation=state`). Read it, then change it.
Each choice is held for half a second: the user's stick, or one of nine others. At first the user's is the likeliest.
Its weights are kept in `cleanrl_ppo.pt`; `state_policy.py` drives with them.
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

import wcsim

WEIGHTS = Path("cleanrl_ppo.pt")
SETTINGS = ("env.observation=state", "env.actions=stick", "env.max_steps=600")
CHAIRS, HOLD, ROLLOUT, EPOCHS, BATCHES = 8, 5, 128, 6, 4  # HOLD in steps, ROLLOUT in choices
ACTOR_RATE, CRITIC_RATE, GAMMA, LAMBDA, CLIP, ENTROPY, MOST_GRADIENT = 7e-4, 1e-3, 0.9, 0.8, 0.2, 0.06, 0.5
REWARD_SCALE = 0.02  # a crash costs 100, a step is worth 1
TURNED = ((0.0, 1.0), (0.0, 0.4), (0.0, 0.0), (0.6, 1.0), (-0.6, 1.0), (1.2, 0.7), (-1.2, 0.7))  # rad, push
FIXED = ((0.0, -0.5), (0.6, 0.0), (-0.6, 0.0))  # backwards, and to each side
USER_FIRST = 2.0  # logit of the user's stick before anything is learned
BLOCKS = ((1, 9), (9, 25), (25, 41), (41, 57))  # rows of `state`: the route, solid things, kerbs, road users


def layer(wide: int, narrow: int, gain: float = 2**0.5) -> nn.Linear:
    """A layer with orthogonal weights, as PPO is begun."""
    made = nn.Linear(wide, narrow)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


class Rows(nn.Module):
    """Looks at each row of `state` beside row 0, which is of the chair itself, and keeps the most of each block."""

    def __init__(self, outputs: int, gain: float, more: int = 0) -> None:
        super().__init__()
        each = (nn.Sequential(layer(18, 64), nn.ReLU(), layer(64, 64), nn.ReLU()) for _ in BLOCKS)
        self.each, self.own = nn.ModuleList(each), nn.Sequential(layer(9, 64), nn.ReLU())
        self.both, self.out = nn.Sequential(layer(64 * 5, 128), nn.ReLU()), layer(128 + more, outputs, gain)

    def features(self, seen: torch.Tensor) -> torch.Tensor:
        """Frames (N, rows, 9) to (N, 128)."""
        own, found = seen[:, :1], [self.own(seen[:, 0])]
        for net, (first, end) in zip(self.each, BLOCKS, strict=True):
            rows = seen[:, first:end]
            used = (rows.abs().sum(2, keepdim=True) > 0).float()  # an unused row would look like something near
            found.append((used * net(torch.cat([rows, own.expand(-1, end - first, -1)], 2))).amax(1))
        return self.both(torch.cat(found, 1))


class Agent(nn.Module):
    """Actor and critic. The actor also sees the critic's features, which learn soonest where it is dangerous."""

    def __init__(self) -> None:
        super().__init__()
        self.actor, self.critic = Rows(10, 0.01, more=128), Rows(1, 1.0)
        self.first = torch.tensor([USER_FIRST] + 9 * [0.0])

    def choices(self, seen: torch.Tensor) -> Categorical:
        """How likely each of `sticks` is, for frames (N, rows, 9)."""
        found = torch.cat([self.actor.features(seen), self.critic.features(seen).detach()], 1)
        return Categorical((self.actor.out(found) + self.first).softmax(1))

    def value(self, seen: torch.Tensor) -> torch.Tensor:
        """What is still to be earned, (N,)."""
        return self.critic.out(self.critic.features(seen))[:, 0]


def stick(seen: torch.Tensor, choice: torch.Tensor) -> torch.Tensor:
    """The sticks (N, 2) of choices (N,), for what users hold now: x right, y ahead, the user's own first."""
    user, found = seen[:, 0, 1:3], []
    for turn, push in TURNED:
        cos, sin = np.cos(turn), np.sin(turn)
        found.append(push * torch.stack([cos * user[:, 0] - sin * user[:, 1], sin * user[:, 0] + cos * user[:, 1]], 1))
    found += torch.tensor(FIXED).expand(len(user), 3, 2).unbind(1)
    return torch.stack(found, 1)[torch.arange(len(user)), choice]


def advantages(rewards: torch.Tensor, values: torch.Tensor, after: torch.Tensor, done: torch.Tensor) -> torch.Tensor:
    """Generalised advantage estimation over a rollout (T, N); `after` is the value of what really came next."""
    found, last = torch.zeros_like(rewards), torch.zeros(rewards.shape[1])
    for t in reversed(range(len(rewards))):
        gain = rewards[t] + GAMMA * after[t] - values[t]
        found[t] = last = gain + GAMMA * LAMBDA * (1.0 - done[t]) * last
    return found


@torch.no_grad()
def held(env: gymnasium.vector.VectorEnv, agent: Agent, seen: torch.Tensor, ended: dict) -> tuple:
    """Choose once and hold it; returns what was seen, done and earned (N, ...), and the frame after it."""
    chances = agent.choices(seen)
    choice, value = chances.sample(), agent.value(seen)
    reward, after, alive, now = torch.zeros(len(seen)), torch.zeros(len(seen)), torch.ones(len(seen)), seen
    for _ in range(HOLD):  # a chair whose episode ends begins the next one with its user's stick
        put = torch.where(alive[:, None] > 0, stick(now, choice), now[:, 0, 1:3])
        shown, earned, crashed, cut, infos = env.step(put.numpy())
        ended["reward"] += float(earned.sum())
        reward += alive * torch.from_numpy(earned).float() * REWARD_SCALE
        now = torch.from_numpy(shown)
        for chair in np.flatnonzero(crashed | cut):
            ended["crashes"] += int(crashed[chair])
            ended["successes"] += int(infos["final_info"]["is_success"][chair])
            if alive[chair] and not crashed[chair]:
                after[chair] = agent.value(torch.from_numpy(infos["final_obs"][chair])[None])[0]
            alive[chair] = 0.0
    after = torch.where(alive > 0, agent.value(now), after)
    return (seen, choice, chances.log_prob(choice), value, reward, after, 1.0 - alive), now


def improve(agent: Agent, best: list[torch.optim.Optimizer], batch: tuple[torch.Tensor, ...]) -> None:
    """One step down the clipped loss of PPO."""
    seen, choice, likely, gain, wanted = batch
    chances = agent.choices(seen)
    ratio = (chances.log_prob(choice) - likely).exp()
    policy = -torch.min(gain * ratio, gain * ratio.clamp(1.0 - CLIP, 1.0 + CLIP)).mean()
    losses = (policy - ENTROPY * chances.entropy().mean(), (agent.value(seen) - wanted).square().mean())
    for part, adam, loss in zip((agent.actor, agent.critic), best, losses, strict=True):
        adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(part.parameters(), MOST_GRADIENT)
        adam.step()


def train(town: str, steps: int, seed: int = 1, more: tuple[str, ...] = (), chairs: int = CHAIRS) -> Iterator[dict]:
    """Train for so many steps of all chairs together; a row of numbers for each update."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # more threads only wait for each other in small updates
    env = gymnasium.make_vec(wcsim.ENV_ID, num_envs=chairs, town=town, overrides=(*SETTINGS, *more))
    agent = Agent()
    rates = ((agent.actor, ACTOR_RATE), (agent.critic, CRITIC_RATE))
    best = [torch.optim.Adam(part.parameters(), rate, eps=1e-5) for part, rate in rates]
    begun_s, size = time.perf_counter(), min(ROLLOUT, max(8, steps // (chairs * HOLD)))
    try:
        seen = torch.from_numpy(env.reset(seed=seed)[0])
        for update in range(1, steps // (chairs * HOLD * size) + 1):
            ended, kept = {"crashes": 0, "successes": 0, "reward": 0.0}, []
            for _ in range(size):
                done, seen = held(env, agent, seen, ended)
                kept.append(done)
            frames, choices, likely, values, rewards, after, over = (torch.stack(x) for x in zip(*kept, strict=True))
            gains = advantages(rewards, values, after, over)
            scaled = (gains - gains.mean()) / (gains.std() + 1e-8)
            data = [item.flatten(0, 1) for item in (frames, choices, likely, scaled, gains + values)]
            for _ in range(EPOCHS):
                for some in torch.randperm(len(data[0])).chunk(BATCHES):
                    improve(agent, best, tuple(item[some] for item in data))
            ended |= {"reward": ended["reward"] / (chairs * HOLD * size), "seconds": time.perf_counter() - begun_s}
            torch.save(agent.state_dict(), WEIGHTS)
            yield {"steps": update * chairs * HOLD * size, **ended}
    finally:
        env.close()


if __name__ == "__main__":
    town, steps, seed = [*sys.argv[1:4], *("helsinki", "40000", "1")[len(sys.argv[1:4]) :]]
    for row in train(town, int(steps), int(seed), tuple(sys.argv[4:])):
        sys.stdout.write(" ".join(f"{key}={value:.5g}" for key, value in row.items()) + "\n")
        sys.stdout.flush()
