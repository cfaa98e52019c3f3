"""Several wheelchairs in one world, for Gymnasium's vector form: `gymnasium.make_vec(wcsim.ENV_ID, num_envs=8)`.

Resets are of mode SAME_STEP: the world gives a finished chair its next episode within the tick that ended the last one,
so both frames are there in the same step. NEXT_STEP would let such a chair stand for a tick in which the others drive.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from wcsim.agents.envs.env_spec import (
    Chairs,
    EnvOptions,
    checked_chairs,
    checked_seed,
    make_face,
    stacked,
)
from wcsim.agents.envs.episode_view import Info, Seen
from wcsim.config import resolve
from wcsim.errors import ConfigError
from wcsim.types import F64, Bool


class StreetVectorEnv(VectorEnv[Seen, Any, npt.NDArray[Any]]):
    """Several wheelchairs in one town, for Gymnasium."""

    def __init__(
        self,
        town: str = "helsinki",
        *,
        num_envs: int = 2,
        max_episode_steps: int | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Describe the environment; the world is made by the first reset.

        Args:
            town: A town's name or folder.
            num_envs: How many chairs.
            max_episode_steps: Longest episode, where `env.max_steps` is no shorter; -1 is no limit besides.
            **options: config, preset, overrides, seed, reward_terms, render_mode, run, hook: see `EnvOptions`.

        Raises:
            ConfigError: The configuration cannot be used.
            TypeError: There is no such option.
        """
        face = make_face(town, options, ("town", "num_envs", "max_episode_steps"))
        if max_episode_steps not in (None, -1) and max_episode_steps < face.config.env.max_steps:
            face = replace(face, config=resolve(face.config, f"env.max_steps={max_episode_steps}"))
        self.num_envs, self.config, self.render_mode = (
            checked_chairs(num_envs),
            face.config,
            face.render_mode,
        )
        self.metadata = {**face.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self._chairs = Chairs(face, num_envs, options.get("reward_terms", ()))
        self._first_seed = checked_seed(options.get("seed"))
        self.single_observation_space, self.single_action_space = (
            face.observation_space(),
            face.action_space(),
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: Info | None = None
    ) -> tuple[Seen, Info]:
        """Begin an episode in every chair: with a seed, and for the first time, in a world made anew.

        Raises:
            ConfigError: The seed is no integer from 0 on; a list is none, for all chairs share one world.
            TownError: The town cannot be used.
        """
        seed = checked_seed(seed)
        if "reset_mask" in (options or {}):
            raise ConfigError(
                "options has a reset_mask; expected none: chairs begin their episodes by themselves"
            )
        super().reset(seed=seed)
        self.closed = False  # or the next close() would leave the world open
        begun = (
            self._chairs.begin_next(self._first_seed) if seed is None else self._chairs.begin(seed)
        )
        infos: Info = {}
        for seat, (_, info) in enumerate(begun):
            infos = self._add_info(infos, info, seat)
        return stacked([seen for seen, _ in begun]), infos

    def step(self, actions: object) -> tuple[Seen, F64, Bool, Bool, Info]:
        """Drive for one tick: actions (N,) or (N, 2), rewards, terminations and truncations (N,).

        Where an episode ends, observation and info are the first of the next one; `final_obs` and `final_info` hold
        the last ones.

        Raises:
            BadActionError: There is no such action; nothing has moved.
            ProtocolError: There is another number of actions, or no world.
        """
        self._chairs.send_all(actions)
        observations, steps, infos = [], self._chairs.receive_all(), Info()
        for seat, (step, begun) in enumerate(steps):
            seen, info = step.observation, step.info
            if begun is not None:
                infos = self._add_info(infos, {"final_obs": seen, "final_info": info}, seat)
                seen, info = begun
            infos = self._add_info(infos, info, seat)
            observations.append(seen)
        rewards = np.array([step.reward for step, _ in steps])
        ends = ([getattr(step, how) for step, _ in steps] for how in ("terminated", "truncated"))
        terminated, truncated = (np.array(end, np.bool_) for end in ends)
        return stacked(observations), rewards, terminated, truncated, infos

    def render(self) -> tuple[Any, ...] | None:
        """Every chair's picture (H, W, 3) uint8, in render mode "rgb_array"."""
        return (
            tuple(chair.picture for chair in self._chairs.all)
            if self.render_mode == "rgb_array"
            else None
        )

    def close_extras(self, **kwargs: Any) -> None:
        """End the world."""
        self._chairs.close()
