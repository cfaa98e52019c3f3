"""Several wheelchairs in one vector environment: `gymnasium.make_vec(wcsim.ENV_ID, num_envs=8)`.

Resets are of mode SAME_STEP: a finished chair begins its next episode within the tick that ended
the last one, so both frames are there in the same step. With NEXT_STEP such a chair would stand
still for a tick in which the others drive.
"""

from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from wcsim.agents.envs import env_spec
from wcsim.agents.envs.episode_view import EnvObservation, Info
from wcsim.config import resolve
from wcsim.types import F64, Bool


class StreetVectorEnv(VectorEnv[EnvObservation, Any, npt.NDArray[Any]]):
    """Several wheelchairs in one town, for Gymnasium."""

    task = env_spec.TASK
    task_description = env_spec.TASK_DESCRIPTION

    closed = True  # until the first reset, also where `__init__` raises or never runs

    def __init__(
        self,
        town: str = "helsinki",
        *,
        num_envs: int = 2,
        max_episode_steps: int | None = None,
        **options: Unpack[env_spec.EnvOptions],
    ) -> None:
        """Describe the environment; the world is made by the first reset.

        Args:
            town: A town's name or folder.
            num_envs: How many chairs.
            max_episode_steps: Longest episode, unless `env.max_steps` is shorter; -1: no limit
                beside that.
            **options: config, preset, overrides, seed, reward_terms, render_mode, run, hook: see
                `EnvOptions`.

        Raises:
            ConfigError: The configuration cannot be used.
            TypeError: There is no such option.
        """
        spec = env_spec.make_env_settings(town, options, ("town", "num_envs", "max_episode_steps"))
        if max_episode_steps not in (None, -1) and max_episode_steps < spec.config.env.max_steps:
            spec = replace(spec, config=resolve(spec.config, f"env.max_steps={max_episode_steps}"))
        self.num_envs = num_envs
        self.config = spec.config
        self.render_mode = spec.render_mode
        self.autoreset_mode = AutoresetMode.SAME_STEP
        self.metadata = {**spec.metadata, "autoreset_mode": self.autoreset_mode}
        self._max_episode_steps = spec.config.env.max_steps
        self._chairs = env_spec.ChairGroup(spec, num_envs, options)
        self.single_observation_space = spec.observation_space()
        self.single_action_space = spec.action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: Info | None = None
    ) -> tuple[EnvObservation, Info]:
        """Begin an episode in every chair: with a seed, and for the first time, in a new world.

        Raises:
            ConfigError: The seed is no integer from 0 on, as a list is none; or there are options,
                as a reset_mask: chairs share a world, and begin their episodes by themselves.
            TownError: The town cannot be used.
        """
        env_spec.refuse_reset_options(options or ())
        seed = env_spec.validate_seed(seed)
        super().reset(seed=seed)
        self.closed = False
        firsts = self._chairs.begin(seed)
        infos: Info = {}
        for seat, (_, info) in enumerate(firsts):
            infos = self._add_info(infos, info, seat)
        return env_spec.stack_observations([observation for observation, _ in firsts]), infos

    def step(self, actions: object) -> tuple[EnvObservation, F64, Bool, Bool, Info]:
        """Drive for one tick: actions (N,) or (N, 2), rewards, terminations and truncations (N,).

        Where an episode ends, observation and info are the first of the next one; `final_obs` and
        `final_info` hold the last ones.

        Raises:
            BadActionError: There is no such action; nothing has moved.
            ProtocolError: There is another number of actions, or no world.
        """
        self._chairs.send_all(actions)
        steps = self._chairs.receive_all()
        observations: list[EnvObservation] = []
        infos: Info = {}
        for seat, (step, first) in enumerate(steps):
            observation, info = step.observation, step.info
            if first is not None:
                final = {"final_obs": observation, "final_info": info}
                infos = self._add_info(infos, final, seat)
                observation, info = first
            infos = self._add_info(infos, info, seat)
            observations.append(observation)
        rewards = np.array([step.reward for step, _ in steps])
        terminated = np.array([step.terminated for step, _ in steps], np.bool_)
        truncated = np.array([step.truncated for step, _ in steps], np.bool_)
        return env_spec.stack_observations(observations), rewards, terminated, truncated, infos

    def render(self) -> tuple[Any, ...] | None:
        """Every chair's picture (H, W, 3) uint8, in render mode "rgb_array"."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(chair.picture for chair in self._chairs.all)

    def close_extras(self, **kwargs: Any) -> None:
        """End the world."""
        self._chairs.close()
