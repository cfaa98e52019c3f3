"""Several wheelchairs in one world as a PettingZoo environment: `wcsim.parallel_env("helsinki", chairs=3)`.

Agents are "chair_0", "chair_1", ... An agent whose episode has ended leaves for good, and its chair the street: there
is no second life before the next `reset`, which makes the world anew with all chairs. All act in every step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt

from wcsim.agents.envs.env_spec import (
    Chairs,
    EnvOptions,
    checked_chairs,
    checked_seed,
    drawn_seed,
    make_face,
)
from wcsim.agents.envs.episode_view import EpisodeStep, Info, Seen
from wcsim.core import seeding
from wcsim.errors import ProtocolError, check_installed
from wcsim.types import F32

try:
    from pettingzoo import ParallelEnv
except ModuleNotFoundError:
    check_installed("wcsim.parallel_env needs PettingZoo", "pettingzoo", "pettingzoo")
    raise


class StreetParallelEnv(ParallelEnv[str, Seen, np.int64]):  # type: ignore[misc]  # PettingZoo has no types
    """Several wheelchairs in one town, for PettingZoo."""

    def __init__(
        self, town: str = "helsinki", *, chairs: int = 2, **options: Unpack[EnvOptions]
    ) -> None:
        """Describe the environment; the world is made by the first reset.

        Args:
            town: A town's name or folder.
            chairs: How many agents.
            **options: config, preset, overrides, seed, reward_terms, render_mode, run, hook: see `EnvOptions`.

        Raises:
            ConfigError: The configuration cannot be used.
            TypeError: There is no such option.
        """
        face = make_face(town, options, ("town", "chairs"))
        self._chairs = Chairs(face, checked_chairs(chairs), options.get("reward_terms", ()))
        self._seed = checked_seed(options.get("seed"))
        self._resets = 0  # since the seed was given, the first of them included
        self.config, self.render_mode, self.metadata = face.config, face.render_mode, face.metadata
        self.possible_agents = [f"chair_{seat}" for seat in range(chairs)]
        self.agents: list[str] = []
        self._observation_spaces = {
            agent: face.observation_space() for agent in self.possible_agents
        }
        self._action_spaces = {agent: face.action_space() for agent in self.possible_agents}

    def observation_space(self, agent: str) -> gymnasium.spaces.Dict | gymnasium.spaces.Box:
        """The space of an agent's observations; the same object each time."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.spaces.Discrete | gymnasium.spaces.Box:
        """The space of an agent's actions; the same object each time."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Seen], dict[str, Info]]:
        """Begin with all agents in a world made anew; without a seed, with the next one that follows from the last.

        Raises:
            ConfigError: The seed is no integer from 0 on.
            TownError: The town cannot be used.
        """
        del options
        begun = self._chairs.begin(self._next_seed(seed))
        self.agents = list(self.possible_agents)
        observations = {agent: item[0] for agent, item in zip(self.agents, begun, strict=True)}
        return observations, {
            agent: item[1] for agent, item in zip(self.agents, begun, strict=True)
        }

    def step(
        self, actions: Mapping[str, np.int64 | int | F32]
    ) -> tuple[
        dict[str, Seen], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]
    ]:
        """Drive for one tick, with one action of every agent that is left; without one there is nothing to do.

        Raises:
            ProtocolError: An action is missing, not in the set, or of an agent that is not there; nothing has moved.
        """
        self._check(actions)
        seats = {agent: self.possible_agents.index(agent) for agent in self.agents}
        for agent, seat in seats.items():
            self._chairs.send(seat, actions[agent])
        steps = {agent: self._chairs.receive(seat) for agent, seat in seats.items()}
        self._let_go(steps)
        return (
            {agent: step.observation for agent, step in steps.items()},
            {agent: step.reward for agent, step in steps.items()},
            {agent: step.terminated for agent, step in steps.items()},
            {agent: step.truncated for agent, step in steps.items()},
            {agent: step.info for agent, step in steps.items()},
        )

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The picture of the first agent that is left, (H, W, 3) uint8, in render mode "rgb_array"."""
        if self.render_mode != "rgb_array" or not self.agents:
            return None
        return self._chairs.all[self.possible_agents.index(self.agents[0])].picture

    def close(self) -> None:
        """End the world; a second call does nothing."""
        self._chairs.close()
        self.agents = []

    def _next_seed(self, seed: int | None) -> int:
        seed = checked_seed(seed)
        if seed is not None:
            self._seed, self._resets = seed, 0
        elif self._seed is None:
            self._seed = drawn_seed()
        self._resets += 1
        return (
            self._seed if self._resets == 1 else seeding.derive(self._seed, "reset", self._resets)
        )

    def _check(self, actions: Mapping[str, np.int64 | int | F32]) -> None:
        if not isinstance(actions, Mapping) or set(actions) != set(self.agents):
            got = (
                sorted(map(str, actions))
                if isinstance(actions, Mapping)
                else f"a {type(actions).__name__}"
            )
            raise ProtocolError(f"actions of {got}; expected one of each of {self.agents}")
        for agent, action in actions.items():
            self._chairs.all[self.possible_agents.index(agent)].stick(action)

    def _let_go(self, steps: Mapping[str, EpisodeStep]) -> None:
        """Whose episode has ended leaves, and its chair the street before the next tick."""
        for agent, step in steps.items():
            if step.done:
                self.agents.remove(agent)
                self._chairs.link(self.possible_agents.index(agent)).close()


parallel_env = StreetParallelEnv
"""The name that PettingZoo's own environments give it."""
