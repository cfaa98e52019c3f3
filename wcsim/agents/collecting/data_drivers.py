"""Who drives while data is recorded: the user, the oracle or the network, with sticks that go astray now and then.

A user who never errs near a wall teaches nothing of walls: so for a third of the time an offset is laid over the wish,
and some of these wishes are carried out as they are, so that the data holds what happens when one errs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wcsim.agents.collecting.segment import FOLLOW, NETWORK, ORACLE, RECKLESS
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation
from wcsim.config import CollectConfig
from wcsim.supervisor.actions import ActionSet
from wcsim.types import F64, Verdict

_ASTRAY_SIGMA = 0.5  # spread of the offset, in stick units
_ASTRAY_TICKS = (4, 12)  # shortest and longest time that an offset is held
_RECKLESS_SHARE = 0.4  # share of these offsets that are executed as they are


class Learned(Protocol):
    """The network as a driver: in each step `choose` or `observe`, then `sent`."""

    def reset(self) -> None:
        """An episode begins."""

    def choose(self, observation: Observation) -> int:
        """Its action."""

    def observe(self, observation: Observation) -> None:
        """Take in an observation without choosing."""

    def sent(self, action: int) -> None:
        """What is carried out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What was done in one step."""

    action: int
    wish: F64  # (2,)
    driver: int


class DataDriver:
    """Drives one chair.

    Args:
        settings: How often who drives.
        actions: The joystick positions.
        rng: Of this chair.
        learned: The network, where there is one.
    """

    def __init__(
        self, settings: CollectConfig, actions: ActionSet, rng: np.random.Generator, learned: Learned | None
    ) -> None:
        self._settings, self._actions, self._rng, self._learned = settings, actions, rng, learned
        self.begin()

    def begin(self) -> None:
        """Draw who drives the episode that begins now."""
        settings, draw = self._settings, self._rng.random(2)
        alone = FOLLOW if draw[1] < settings.follow_share else ORACLE
        learned = self._learned is not None and draw[0] < settings.network_share
        self._driver = NETWORK if learned else alone
        self._held, self._offset, self._reckless = 0, np.zeros(2), False
        if self._learned is not None and self._driver == NETWORK:
            self._learned.reset()

    def choose(self, observation: Observation, said: Verdict) -> Choice:
        """Answer an observation; `said` is the oracle's verdict of its moment."""
        wish = self._wish(np.asarray(observation[JOYSTICK_KEY], np.float64))
        reckless = self._held > 0 and self._reckless
        action = self._actions.nearest(wish)
        if self._driver == NETWORK and self._learned is not None:
            if reckless:
                self._learned.observe(observation)
            else:
                action = self._learned.choose({**observation, JOYSTICK_KEY: wish.astype(np.float32)})
            self._learned.sent(action)
        elif self._driver == ORACLE and not reckless:
            action = self._safest(wish, said.first_s)
        return Choice(action=action, wish=wish, driver=RECKLESS if reckless else self._driver)

    def _wish(self, stick: F64) -> F64:
        """The user's stick, or with an offset that is held for a while."""
        settings, rng = self._settings, self._rng
        self._held -= 1
        low, high = _ASTRAY_TICKS
        mean = 0.5 * (low + high)
        if self._held <= 0 and rng.random() < settings.astray_share / (mean - (mean - 1) * settings.astray_share):
            self._offset = rng.normal(0.0, _ASTRAY_SIGMA, 2)
            self._held = int(rng.integers(low, high + 1))
            self._reckless = bool(rng.random() < _RECKLESS_SHARE)
        if self._held <= 0:
            return stick
        wish: F64 = np.clip(stick + self._offset, -1.0, 1.0)
        return wish

    def _safest(self, wish: F64, first_s: F64) -> int:
        distance = self._actions.distances(wish[None])[0]
        return int(np.argmin(np.where(first_s == first_s.max(), distance, np.inf)))
