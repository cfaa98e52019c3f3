"""Who answers for a seat of a world in this process: agents, which choose actions, and what joins one to its seat."""

from __future__ import annotations

from typing import Protocol

from wcsim.agents.envs.episode_view import Chair, EpisodeStep, Info, named
from wcsim.agents.policy_api import HearsSent, Helping, Observation, Policy, SeesTruth, tell_delay
from wcsim.config import RunConfig
from wcsim.types import ClientSnapshot, Joystick


class Agent(Protocol):
    """Chooses the actions of one chair; wrappers around a policy are agents, too."""

    def reset(self, info: Info) -> None:
        """An episode begins; `info` is that of its first observation."""

    def act(self, observation: Observation, info: Info) -> object:
        """The action for this observation; `info` is of the same moment."""


class SeatDriver:
    """An agent in a seat; `observation` and `info` are those of now.

    Args:
        config: Of the world.
        agent: Who answers.
        first: The frame with which the first episode begins.
    """

    def __init__(self, config: RunConfig, agent: Agent, first: ClientSnapshot) -> None:
        """Begin an episode. Raises ConfigMismatchError when the world's cameras are not those of `config`."""
        self.action = 0  # the last one
        self._chair, self._agent = Chair(config), agent
        self._begin(first)

    def choose(self, now: ClientSnapshot) -> Joystick:
        """The `Driver` of the seat for `rollout`. Raises BadActionError for an action that is not in the set."""
        if not self._chair.ready:
            self._begin(now)
        self.action = self._chair.checked(self._agent.act(self.observation, self.info))
        return self._chair.command(self.action).joystick

    def take(self, after: ClientSnapshot) -> EpisodeStep:
        """What came of it, with the seat's frame after the tick."""
        step = self._chair.take(after)
        self.observation, self.info = named(step.observation), step.info
        return step

    def _begin(self, first: ClientSnapshot) -> None:
        seen, self.info = self._chair.begin(first)
        self.observation = named(seen)
        self._agent.reset(self.info)


class PolicyAgent:
    """A policy as an agent: it is told the delay of each episode, the truth where it sees it, and requests for help.

    Args:
        policy: Who chooses; it is begun with its first episode.
        help_ticks: See `Helping`.
    """

    def __init__(self, policy: Policy, help_ticks: int = 0) -> None:
        self.policy, self.help = policy, Helping(policy, help_ticks)
        self._begun = False

    def reset(self, info: Info) -> None:
        """Begin an episode."""
        if not self._begun:
            self._begun = True  # first: one that fails is not begun again
            self.policy.begin()
        tell_delay(self.policy, info["drawn"])
        self.policy.reset()

    def act(self, observation: Observation, info: Info) -> int:
        """Ask the policy."""
        self._show(info)
        if info["help"]:
            self.help.ask()
        action = self.policy.act(observation)
        self.help.tick()
        return action

    def choose(self, observation: Observation, info: Info) -> int:
        """The same, where the caller answers calls for help, and tells a `HearsSent` what was sent."""
        self._show(info)
        policy = self.policy
        return int(
            policy.choose(observation) if isinstance(policy, HearsSent) else policy.act(observation)
        )

    def _show(self, info: Info) -> None:
        if isinstance(self.policy, SeesTruth):
            self.policy.see(info["truth"])
