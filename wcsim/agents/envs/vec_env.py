"""Several wheelchairs in one world for one learner: a vectorised environment of Stable-Baselines3.

`DQN("MultiInputPolicy", StreetVecEnv("helsinki", chairs=4))` learns from four chairs that meet in
one street. All act in every step. A finished chair is respawned within the tick that ended it, as
SB3 expects: the observation is the first one of the next episode, `info["terminal_observation"]`
the last one of the episode before.
"""

from collections.abc import Sequence
from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt

from wcsim.agents.envs import env_spec
from wcsim.agents.envs.episode_view import EnvObservation, Info
from wcsim.errors import ConfigError, ProtocolError, check_installed
from wcsim.server.links.base import LinkWaitTimes
from wcsim.types import U8

try:
    from stable_baselines3.common.vec_env.base_vec_env import (
        VecEnv,
        VecEnvIndices,
        VecEnvObs,
        VecEnvStepReturn,
    )
except ModuleNotFoundError:
    check_installed(
        "wcsim.StreetVecEnv needs Stable-Baselines3", "train", "torch", "stable_baselines3"
    )
    raise


class StreetVecEnv(VecEnv):
    """Several wheelchairs in one town, for Stable-Baselines3."""

    def __init__(
        self,
        town: str = "helsinki",
        *,
        chairs: int = 2,
        repeat: bool = False,
        **options: Unpack[env_spec.EnvOptions],
    ) -> None:
        """Describe the environment; the first reset makes the world.

        Args:
            town: A town's name or folder.
            chairs: How many agents.
            repeat: Whether every reset makes the first world again, as evaluations need it.
            **options: As in `StreetParallelEnv`.

        Raises:
            ConfigError: The configuration cannot be used.
            TypeError: There is no such option.
        """
        spec = env_spec.make_env_settings(town, options, ("town", "chairs", "repeat"))
        self._chairs = env_spec.ChairGroup(spec, chairs, options)
        self._repeat = repeat
        self._waiting = False  # for the result of a step
        self.config = spec.config
        self.render_mode = spec.render_mode
        super().__init__(chairs, spec.observation_space(), spec.action_space())
        if repeat:
            first_seed = self._chairs.first_seed
            self.seed(env_spec.draw_random_seed() if first_seed is None else first_seed)
        # SB3 makes metadata without it.
        self.metadata = {**self.metadata, "render_fps": spec.metadata["render_fps"]}

    def reset(self) -> VecEnvObs:
        """Begin an episode in every chair: after `seed`, and for the first time, in a new world.

        Raises ConfigError where `set_options` has set some.
        """
        # A step under way must end first.
        if self._waiting:
            self.step_wait()
        env_spec.refuse_reset_options(self._options[0])
        firsts = self._chairs.begin(self._seeds[0])
        if not self._repeat:
            self._reset_seeds()
        self._reset_options()
        self.reset_infos = [info for _, info in firsts]
        return env_spec.stack_observations([observation for observation, _ in firsts])

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Make the next reset start a new world with this seed, which gives the chairs' seeds."""
        self._seeds = [env_spec.validate_seed(seed)] * self.num_envs
        return self._seeds

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Send every chair's action, (N,) indices or (N, 2) sticks. Raises BadActionError."""
        if self._waiting:
            raise ProtocolError("step_async() came twice; call step_wait() first")
        self._chairs.send_all(actions)
        self._waiting = True

    def step_wait(self) -> VecEnvStepReturn:
        """The results: observations, rewards (N,) float32, dones (N,), infos."""
        if not self._waiting:
            raise ProtocolError("step_wait() came before step_async(); call step_async() first")
        self._waiting = False
        steps = self._chairs.receive_all()
        observations: list[EnvObservation] = []
        infos: list[Info] = []
        for seat, (step, first) in enumerate(steps):
            observation = step.observation
            info = {**step.info, "TimeLimit.truncated": step.truncated}
            # The learner's next observation is of the next episode.
            if first is not None:
                info["terminal_observation"] = observation
                observation, self.reset_infos[seat] = first
            observations.append(observation)
            infos.append(info)
        rewards = np.array([step.reward for step, _ in steps], np.float32)
        return (
            env_spec.stack_observations(observations),
            rewards,
            np.array([step.done for step, _ in steps]),
            infos,
        )

    def get_images(self) -> list[U8 | None]:
        """Every chair's picture (H, W, 3) uint8, in render mode "rgb_array"."""
        return [chair.picture for chair in self._chairs.all]

    def close(self) -> None:
        """End the world; a second call does nothing."""
        self._chairs.close()
        self._waiting = False

    def waits(self, seat: int) -> LinkWaitTimes:
        """The times spent in a chair's link so far."""
        return self._chairs.link(seat).waits

    # --- what SB3 requests of environments one by one; these chairs are parts of one ---

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute that all chairs share, such as `render_mode`, once a chair."""
        return [getattr(self, attr_name) for _ in self._picked(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refused: the chairs are of one world. Raises ConfigError."""
        raise ConfigError(
            f"{attr_name!r} cannot be set in an existing world; make another StreetVecEnv"
        )

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method with the number of each chair as its first argument, such as `waits`."""
        return [
            getattr(self, method_name)(seat, *method_args, **method_kwargs)
            for seat in self._picked(indices)
        ]

    def env_is_wrapped(
        self,
        wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]],
        indices: VecEnvIndices = None,
    ) -> list[bool]:
        """No chair is wrapped."""
        return [False for _ in self._picked(indices)]

    def _picked(self, indices: VecEnvIndices) -> list[int]:
        return [int(index) for index in self._get_indices(indices)]
