"""The wrapper `veto:POLICY`: the baseline `dwa` watches any policy, and forbids what it could not brake in time.

Networks and `dwa` miss different crashes, so together they crash less, and intervene more often.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from wcsim.agents.policies.dwa import DynamicWindow
from wcsim.agents.policy_api import (
    MOTION_SENSES,
    HearsDelay,
    HearsSent,
    NeedsSenses,
    Observation,
    Policy,
    SeesTruth,
    TellsUnsafe,
    Warns,
)
from wcsim.config import RunConfig
from wcsim.errors import PolicyError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.types import Bool

_LEVEL: Final = 1.0  # of `dwa`, as it is when it drives alone


class Veto(HearsSent):
    """Drives one chair: its action is the policy's, or the nearest one to it that is not forbidden.

    Its level of assistance is that of `dwa`: how early, and how widely, it forbids.

    Args:
        name: What tables call it.
        inner: The policy that is watched.
        config: Of the run: its first camera is seen, and its chair driven.
    """

    def __init__(self, name: str, inner: Policy, config: RunConfig) -> None:
        """Raises PolicyError for a policy that sees the truth: that is a bound, and drives as well as can be."""
        if isinstance(inner, SeesTruth):
            raise PolicyError(
                f"policy {name!r}: {inner.name} sees the truth, and is the upper bound; expected another policy"
            )
        self.name, self.inner = name, inner
        self._actions: ActionSet = action_set(config.env.actions)
        self._dwa = DynamicWindow("dwa", config, self._actions, plant_spec(config.chair).outline, _LEVEL)
        wanted = inner.senses if isinstance(inner, NeedsSenses) else ()
        self.senses, self.levels = tuple(dict.fromkeys((*MOTION_SENSES, *wanted))), self._dwa.levels
        self.unsafe: Bool = np.zeros(len(self._actions), np.bool_)  # (A,) to either of both at the last choice

    @property
    def warning(self) -> bool:
        """Whether the policy warns; one that cannot lets `dwa` do it."""
        return self.inner.warning if isinstance(self.inner, Warns) else self._dwa.warning

    @property
    def level(self) -> float:
        """That of `dwa`."""
        return self._dwa.level

    def set_level(self, level: float) -> None:
        """Forbid so from the next choice on. Raises PolicyError for a level out of bounds."""
        self._dwa.set_level(level)

    def set_delay(self, ticks: int) -> None:
        """Tell the policy of the delay, if it asks for it."""
        if isinstance(self.inner, HearsDelay):
            self.inner.set_delay(ticks)

    def begin(self) -> None:
        """Begin both anew."""
        self.inner.begin()
        self._dwa.begin()

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self.inner.reset()
        self._dwa.reset()

    def close(self) -> None:
        """Close the policy, if it has something to close."""
        if hasattr(self.inner, "close"):
            self.inner.close()

    def choose(self, observation: Observation) -> int:
        """The action, while another one may still be sent."""
        inner = self.inner
        wanted = int(inner.choose(observation) if isinstance(inner, HearsSent) else inner.act(observation))
        self._dwa.choose(observation)
        forbidden = self._dwa.unsafe
        doubted = inner.unsafe if isinstance(inner, TellsUnsafe) else np.zeros_like(forbidden)
        self.unsafe = forbidden | doubted
        if not forbidden[wanted] or forbidden.all():  # with nothing left to take, `dwa` knows no better than the policy
            return wanted
        allowed = ~forbidden if self.unsafe.all() else ~self.unsafe
        distance = self._actions.distances(self._actions.points[wanted][None])[0]
        return int(np.argmin(np.where(allowed, distance, np.inf)))

    def sent(self, action: int) -> None:
        """Say which action is carried out."""
        if isinstance(self.inner, HearsSent):
            self.inner.sent(action)
        self._dwa.sent(action)
