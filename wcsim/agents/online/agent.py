"""Who chooses while a danger network learns as it drives: the user, then its own rule, which explores at times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wcsim.agents.collecting.data_drivers import Choice
from wcsim.agents.collecting.segment import FOLLOW, NETWORK, RECKLESS
from wcsim.agents.danger.network import DangerNet
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.danger.rule import rule_of, to_learn
from wcsim.agents.danger.sight import DangerSight
from wcsim.agents.learning.phases import LearningPhase
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.types import F64


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingTurn:
    """What a step is done with."""

    phase: LearningPhase
    epsilon: float = 0.0
    greedy: bool = False  # in the first phase: tell what the network would do, too


class OnlineAgent:
    """Drives one chair with a network that may change from step to step.

    Args:
        config: Of the run.
        net: The network.
        rng: Of its exploration; it may be exchanged (`rng`).
    """

    def __init__(self, config: RunConfig, net: DangerNet, rng: np.random.Generator) -> None:
        self.rng, self.would = rng, -1
        self._config, self._net = config, net
        self._actions = action_set(config.env.actions)
        self._drivers: dict[int, DangerPolicy] = {}  # by the delay of the commands
        self._driver = self._driver_for(config.world.action_delay_ticks)
        self._held, self._offset, self._reckless = 0, np.zeros(2), False

    @property
    def sight(self) -> DangerSight:
        """What was seen when it last chose."""
        return self._driver.sight

    def begin(self, delay_ticks: int) -> None:
        """An episode begins, in a chair whose commands arrive so many ticks late."""
        self._driver = self._driver_for(delay_ticks)
        self._driver.reset()
        self._held = 0

    def choose(self, observation: Observation, turn: DrivingTurn) -> Choice:
        """The action, and for which wish; `would` is what the network would do, -1 where it was not asked."""
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        wish, driver, self.would = stick, FOLLOW, -1
        if turn.phase is LearningPhase.ACTION_DRIVEN:
            action = self._actions.nearest(stick)
            if turn.greedy:
                self.would = self._driver.choose(observation)
            else:
                self._driver.watch(observation)
        else:
            wish, driver = self._explored(stick, turn.epsilon), NETWORK
            seen = {**observation, JOYSTICK_KEY: wish.astype(np.float32)}
            action = self.would = self._driver.choose(seen)
            if self._held >= 0 and self._reckless:
                action, driver = self._actions.nearest(wish), RECKLESS
        self._driver.sent(action)
        return Choice(action=action, wish=wish, driver=driver)

    def _explored(self, stick: F64, epsilon: float) -> F64:
        """The user's stick, or another one that is held for a while; `collect.reckless_share` of them do as they like.

        An exploration lasts `learn.epsilon_hold` steps, so it begins that much more rarely.
        """
        learn, rng = self._config.learn, self.rng
        self._held -= 1
        begins = self._held < 0 and rng.random() < epsilon / (learn.epsilon_hold - (learn.epsilon_hold - 1) * epsilon)
        if begins:
            self._held = learn.epsilon_hold - 1
            self._reckless = bool(rng.random() < self._config.collect.reckless_share)
            anywhere = self._actions.points[int(rng.integers(len(self._actions)))] - stick
            near = rng.normal(0.0, learn.epsilon_sigma, 2)
            self._offset = near if learn.exploration == "local" else anywhere
        wish: F64 = np.clip(stick + self._offset, -1.0, 1.0) if self._held >= 0 else stick
        return wish

    def _driver_for(self, delay_ticks: int) -> DangerPolicy:
        if delay_ticks not in self._drivers:
            rule = to_learn(rule_of(self._config.danger))
            self._drivers[delay_ticks] = DangerPolicy("own", self._net, self._config, rule, delay_ticks)
        return self._drivers[delay_ticks]
