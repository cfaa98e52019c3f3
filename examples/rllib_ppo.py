"""RLlib's PPO on numbers and any stick: `python rllib_ppo.py [TOWN] [ROUNDS]`; pip install 'ray[rllib]' torch."""

import sys
from collections.abc import Iterator

import gymnasium
from gymnasium.wrappers import FlattenObservation
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

import wcsim


def learn(town: str, rounds: int, more: tuple[str, ...] = (), batch: int = 1000) -> Iterator[dict[str, float]]:
    """The means of each round of learning."""
    settings = ("env.observation=state", "env.actions=stick", *more)
    register_env("street", lambda _: FlattenObservation(gymnasium.make(wcsim.ENV_ID, town=town, overrides=settings)))
    config = PPOConfig().environment("street").env_runners(num_env_runners=0)
    config.training(train_batch_size_per_learner=batch, minibatch_size=batch // 4, num_epochs=4)
    algorithm = config.build_algo()
    for _ in range(rounds):
        yield algorithm.train()["env_runners"]
    algorithm.stop()


if __name__ == "__main__":
    town, rounds = [*sys.argv[1:], *("helsinki", "10")[len(sys.argv) - 1 :]]
    for means in learn(town, int(rounds)):
        sys.stdout.write(f"{means['num_env_steps_sampled_lifetime']} {means['episode_return_mean']}\n")
