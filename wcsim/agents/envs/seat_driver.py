"""Drives seats of a world in this process: agents choose actions, `AgentSeatDriver` acts."""

from typing import Protocol

from wcsim.agents.envs.episode_view import (
    OBJECTS,
    EnvStepResult,
    Info,
    SeatEnvAdapter,
    env_to_policy_observation,
)
from wcsim.agents.policy_api import (
    HearsSent,
    Helping,
    Observation,
    Policy,
    SeesTruth,
    pass_delay,
)
from wcsim.config import RunConfig
from wcsim.supervisor.actions import ActionSet
from wcsim.types import ClientSnapshot, Joystick


class ChairAgent(Protocol):
    """Chooses the actions of one chair; wrappers around a policy are agents, too."""

    def reset(self, info: Info) -> None:
        """Begin an episode; `info` is that of its first observation."""

    def act(self, observation: Observation, info: Info) -> object:
        """The action for an observation; `info` is of the same moment."""


class AgentSeatDriver:
    """An agent in a seat; `observation` and `info` are the latest, `action` the last one.

    Args:
        config: Of the world.
        agent: Chooses the actions.
        first: The first frame of the first episode.
    """

    def __init__(self, config: RunConfig, agent: ChairAgent, first: ClientSnapshot) -> None:
        """Begin an episode. Raises ConfigMismatchError when the world is not that of `config`."""
        self.action = 0
        self._chair = SeatEnvAdapter(config)
        self._agent = agent
        self._begin(first)

    def choose(self, now: ClientSnapshot) -> Joystick:
        """The `Driver` of the seat for `rollout`. Raises BadActionError."""
        if not self._chair.ready:
            self._begin(now)
        self.action = self._chair.action_index(self._agent.act(self.observation, self.info))
        return self._chair.command(self.action).joystick

    def finish_step(self, after: ClientSnapshot) -> EnvStepResult:
        """The result of the action; `after` is the seat's frame after the tick."""
        step = self._chair.finish_step(after)
        self.observation = env_to_policy_observation(step.observation)
        self.info = step.info
        return step

    def _begin(self, first: ClientSnapshot) -> None:
        observation, self.info = self._chair.begin(first)
        self.observation = env_to_policy_observation(observation)
        self._agent.reset(self.info)


class PolicyAgentAdapter:
    """A policy as an agent.

    It passes on the delay of each episode, the truth to a policy that sees it, and calls for help.

    Args:
        policy: Chooses the actions; its `begin` is called with the first episode.
        actions: The joystick positions.
        help_ticks: See `Helping`.
    """

    def __init__(self, policy: Policy, actions: ActionSet, help_ticks: int = 0) -> None:
        self.policy = policy
        self.help = Helping(policy, help_ticks, actions)
        self._is_new = True

    def reset(self, info: Info) -> None:
        """Begin an episode."""
        if self._is_new:
            # Set first: a policy that fails to begin is not begun again.
            self._is_new = False
            self.policy.begin()
        pass_delay(self.policy, info[OBJECTS].drawn)
        self.policy.reset()

    def act(self, observation: Observation, info: Info) -> int:
        """The policy's action, or what help makes of it. Raises BadActionError."""
        self._show(info)
        if info["help"]:
            self.help.request()
        policy = self.policy
        if isinstance(policy, HearsSent):
            action = self.help.choice(policy.choose(observation))
            policy.sent(action)
        else:
            action = self.help.choice(policy.act(observation))
        self.help.tick()
        return action

    def choose(self, observation: Observation, info: Info) -> int:
        """As `act`; the caller handles calls for help, and sends a `HearsSent` the action."""
        self._show(info)
        if isinstance(self.policy, HearsSent):
            return int(self.policy.choose(observation))
        return int(self.policy.act(observation))

    def _show(self, info: Info) -> None:
        if isinstance(self.policy, SeesTruth):
            self.policy.see(info[OBJECTS].truth)
