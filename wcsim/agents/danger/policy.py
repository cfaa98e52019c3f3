"""A danger network as a policy: it sees, says how bad each joystick position is, and answers the user's stick."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import torch

from wcsim.agents.danger.lessons import Inputs, tensors_of
from wcsim.agents.danger.network import DangerNet
from wcsim.agents.danger.rule import LEVELS, DangerRule, choose, next_recent, within
from wcsim.agents.danger.sight import DangerSight, Eye
from wcsim.agents.policies.alarm import Alarm, next_alarm
from wcsim.agents.policies.dynamic_window.surroundings import SENSES
from wcsim.agents.policy_api import JOYSTICK_KEY, NotFinite, Observation, require_level
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.types import F64, Bool

_SURE: Final = 60.0  # a logit beyond it says no more


class DangerPolicy:
    """Drives one chair.

    Args:
        name: How tables call it.
        net: The network; it may be shared by policies that act in turn.
        config: Of the run: its first camera is seen, and its chair driven.
        rule: From dangers to an action.
        delay_ticks: From a command to the chair that obeys it; as the configuration says when it is None.
    """

    def __init__(
        self, name: str, net: DangerNet, config: RunConfig, rule: DangerRule, delay_ticks: int | None = None
    ) -> None:
        self.name, self.senses = name, SENSES
        self.rule, self._net, self._alarm = rule, net, Alarm()
        self._device = next(net.parameters()).device
        self._actions = action_set(config.env.actions)
        self._eye = Eye(config, delay_ticks, net.spec.street, net.spec.pictures)
        self._last, self._recent = -1, 0
        self.unsafe: Bool = np.zeros(len(self._actions), np.bool_)  # (A,) above the threshold at the last choice
        self.sight: DangerSight  # of the newest observation
        self.told: F64  # the newest dangers

    @property
    def warning(self) -> bool:
        """Whether the user's own stick is about to end badly, see `next_alarm`."""
        return self._alarm.on

    @property
    def levels(self) -> tuple[float, float]:
        """Thresholds of danger, see `rule.LEVELS`: the highest assists least."""
        return LEVELS

    @property
    def level(self) -> float:
        """The threshold of danger."""
        return self.rule.threshold

    def set_level(self, level: float) -> None:
        """Take another threshold of danger from now on. Raises PolicyError for one out of bounds."""
        require_level(level, LEVELS)
        self.rule = replace(self.rule, threshold=level)

    def set_delay(self, ticks: int) -> None:
        """From the next `reset` on a command reaches the chair so many ticks late."""
        self._eye.around.ego.delay_ticks = ticks

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self._eye.forget()
        self._alarm, self._last, self._recent = Alarm(), -1, 0

    def act(self, observation: Observation) -> int:
        """The action nearest to the user's stick that is safe enough."""
        action = self.choose(observation)
        self.sent(action)
        return action

    def choose(self, observation: Observation) -> int:
        """The same, while another action may still be sent."""
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        danger = self.dangers(observation)
        own = self._actions.nearest(stick)
        self._alarm = next_alarm(self._alarm, float(danger[own]), self.rule.warn)
        self.unsafe = ~within(danger, self.rule, self._last)
        taken = choose(danger, stick, self._actions, self.rule, self._last, self._recent > 0)
        self._recent = next_recent(self._recent, bool(self.unsafe[own]), float(danger[own]), self.rule)
        return taken

    def watch(self, observation: Observation) -> None:
        """See what there is to see, and choose nothing."""
        self.sight = self._eye.look(observation)

    def dangers(self, observation: Observation) -> F64:
        """How bad each action is (A,), while any action may still be sent."""
        self.watch(observation)
        self.told = self.danger(self.sight)
        return self.told

    def sent(self, action: int) -> None:
        """Say which action is carried out."""
        self._eye.command(action)
        self._last = action

    def danger(self, sight: DangerSight) -> F64:
        """How bad each action is, (A,) in 0..1. Raises NotFinite when the network leaves the finite numbers."""
        with torch.inference_mode():
            logits = self._net(*(part.to(self._device) for part in inputs([sight], self._eye))).cpu().numpy()[0]
        if not np.isfinite(logits).all():
            raise NotFinite(f"policy {self.name!r} returns dangers that are not finite; train it again")
        danger: F64 = 1.0 / (1.0 + np.exp(-logits.astype(np.float64).clip(-_SURE, _SURE)))
        return danger


def inputs(sights: list[DangerSight], eye: Eye) -> Inputs:
    """What the network is called with, for a batch of sights of chairs like that of `eye`."""
    return tensors_of(
        eye,
        picture=np.stack([sight.picture for sight in sights]),
        vector=np.stack([sight.vector for sight in sights]),
        start=np.stack([sight.start for sight in sights]).astype(np.float64),
        frames=np.stack([sight.frames for sight in sights]),
    )
