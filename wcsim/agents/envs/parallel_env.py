"""Several wheelchairs in one PettingZoo environment: `wcsim.parallel_env("helsinki", chairs=3)`.

Agents are "chair_0", "chair_1", ... An agent whose episode has ended leaves for good, and its chair
the street, until the next `reset` makes a new world with all chairs. All act in every step.
"""

from collections.abc import Mapping
from typing import Unpack

import numpy as np
from gymnasium import spaces

from wcsim.agents.envs import env_spec
from wcsim.agents.envs.episode_view import EnvObservation, Info
from wcsim.core import seeding
from wcsim.errors import ProtocolError, check_installed
from wcsim.types import F32, F64, U8

try:
    from pettingzoo import ParallelEnv
except ModuleNotFoundError:
    check_installed("wcsim.parallel_env needs PettingZoo", "pettingzoo", "pettingzoo")
    raise


class StreetParallelEnv(ParallelEnv[str, EnvObservation, np.int64]):  # type: ignore[misc]  # PettingZoo has no types
    """Several wheelchairs in one town, for PettingZoo."""

    def __init__(
        self, town: str = "helsinki", *, chairs: int = 2, **options: Unpack[env_spec.EnvOptions]
    ) -> None:
        """Describe the environment; the world is made by the first reset.

        Args:
            town: A town's name or folder.
            chairs: How many agents.
            **options: config, preset, overrides, seed, reward_terms, render_mode, run, hook: see
                `EnvOptions`.

        Raises:
            ConfigError: The configuration cannot be used.
            TypeError: There is no such option.
        """
        spec = env_spec.make_env_settings(town, options, ("town", "chairs"))
        self._chairs = env_spec.ChairGroup(spec, chairs, options)
        self._seed = self._chairs.first_seed
        self._resets = 0  # since the seed was given, the first of them included
        self.config = spec.config
        self.render_mode = spec.render_mode
        self.metadata = {**spec.metadata, "is_parallelizable": True}
        self.state_space = spaces.Box(-1e6, 1e6, (15 * chairs,), np.float64)
        self.possible_agents = [f"chair_{seat}" for seat in range(chairs)]
        self.agents: list[str] = []
        self._observation_spaces = {
            agent: spec.observation_space() for agent in self.possible_agents
        }
        self._action_spaces = {agent: spec.action_space() for agent in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Dict | spaces.Box:
        """The space of an agent's observations; the same object each time."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete | spaces.Box:
        """The space of an agent's actions; the same object each time."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Info | None = None
    ) -> tuple[dict[str, EnvObservation], dict[str, Info]]:
        """Begin with all agents in a new world; without a seed, with the next one of the last seed.

        Raises:
            ConfigError: The seed is no integer from 0 on, or there are options.
            TownError: The town cannot be used.
        """
        # PettingZoo's own tests give the option "options".
        env_spec.refuse_reset_options(name for name in options or () if name != "options")
        seed = env_spec.validate_seed(seed)
        if seed is not None:
            self._seed = seed
            self._resets = 0
        elif self._seed is None:
            self._seed = env_spec.draw_random_seed()
        self._resets += 1
        if self._resets == 1:
            seed = self._seed
        else:
            seed = seeding.derive_seed(self._seed, "reset", self._resets)
        observations, infos = zip(*self._chairs.begin(seed), strict=True)
        self.agents = list(self.possible_agents)
        return dict(zip(self.agents, observations, strict=True)), dict(
            zip(self.agents, infos, strict=True)
        )

    def step(
        self, actions: Mapping[str, np.int64 | int | F32]
    ) -> tuple[
        dict[str, EnvObservation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, Info],
    ]:
        """Drive for one tick, with one action of every agent that is left; of none nothing happens.

        Raises:
            ProtocolError: An action is missing, not in the set, or of an agent that has left;
                nothing has moved.
        """
        # 1. Check all actions before the first is sent.
        if not isinstance(actions, Mapping) or set(actions) != set(self.agents):
            received: object = f"a {type(actions).__name__}"
            if isinstance(actions, Mapping):
                received = sorted(map(str, actions))
            raise ProtocolError(f"actions of {received}; expected one of each of {self.agents}")
        seats = {agent: self.possible_agents.index(agent) for agent in self.agents}
        for agent, seat in seats.items():
            self._chairs.all[seat].stick(actions[agent])
        # 2. Step. The world waits for every action.
        for agent, seat in seats.items():
            self._chairs.send(seat, actions[agent])
        steps = {agent: self._chairs.receive(seat) for agent, seat in seats.items()}
        # 3. An agent whose episode has ended leaves, and its chair the street before the next tick.
        for agent, step in steps.items():
            if step.done:
                self.agents.remove(agent)
                self._chairs.link(seats[agent]).close()
        return (
            {agent: step.observation for agent, step in steps.items()},
            {agent: step.reward for agent, step in steps.items()},
            {agent: step.terminated for agent, step in steps.items()},
            {agent: step.truncated for agent, step in steps.items()},
            {agent: step.info for agent, step in steps.items()},
        )

    def state(self) -> F64:
        """The true states of all chairs (15 N,), rows of `PlantState`; the last of who has left.

        Raises ProtocolError before the first reset.
        """
        frames = [chair.now for chair in self._chairs.all if chair.now is not None]
        if not frames:
            raise ProtocolError("state() came before reset(); call reset() first")
        return np.concatenate([frame.plant.row for frame in frames])

    def render(self) -> U8 | None:
        """The picture (H, W, 3) uint8 of the first agent that is left, in mode "rgb_array"."""
        if self.render_mode != "rgb_array" or not self.agents:
            return None
        return self._chairs.all[self.possible_agents.index(self.agents[0])].picture

    def close(self) -> None:
        """End the world; a second call does nothing."""
        self._chairs.close()
        self.agents = []


parallel_env = StreetParallelEnv
"""The name by which PettingZoo's own environments are made."""
