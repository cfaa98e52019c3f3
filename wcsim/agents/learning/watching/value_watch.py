"""Does a learner promise too much? Values at the starts of episodes beside the returns that followed.

The maximum over noisy values is too high on average, which is why DQN overestimates and Double DQN was made (van
Hasselt, Guez, Silver 2016). Both numbers are in units of the scaled reward, as the network's values are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

_TAIL: Final = 0.05  # an episode that was cut short says nothing of its return while more than this share is to come


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueCheck:
    """What an episode says about the value at its start; None where it does not."""

    value: float | None
    discounted: float | None

    @property
    def overestimate(self) -> float | None:
        """By how much the value was higher than what followed."""
        return None if self.value is None or self.discounted is None else self.value - self.discounted


@dataclass(slots=True)
class ValueWatch:
    """The discounted return of one episode as it comes in.

    >>> watch = ValueWatch(gamma=0.5, scale=0.1, value=3.0)
    >>> for reward in (10.0, 20.0):
    ...     watch.add(reward)
    >>> check = watch.check(ended=True)
    >>> check.value, check.discounted, check.overestimate
    (3.0, 2.0, 1.0)
    >>> watch.check(ended=False).discounted is None
    True
    """

    gamma: float
    scale: float  # of rewards
    value: float | None = None  # of the greedy action at the start
    _sum: float = 0.0
    _weight: float = 1.0  # of the next reward

    def add(self, reward: float) -> None:
        """Take in the reward of a step, unscaled."""
        self._sum += self._weight * self.scale * reward
        self._weight *= self.gamma

    def check(self, ended: bool) -> ValueCheck:
        """What came of it; `ended` by itself, or cut short by its limit."""
        whole = ended or self._weight <= _TAIL
        return ValueCheck(value=self.value, discounted=self._sum if whole else None)
