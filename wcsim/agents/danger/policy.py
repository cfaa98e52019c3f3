"""A danger network as a policy: it sees, says how bad each joystick position is, and answers the user's stick."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch

from wcsim.agents.danger.dataset import to_tensors
from wcsim.agents.danger.network import DangerNet
from wcsim.agents.danger.rule import LEVELS, choose, next_recent, within
from wcsim.agents.danger.street_map import FeatureExtractor, Features
from wcsim.agents.policies.alarm import Alarm, next_alarm
from wcsim.agents.policy_api import JOYSTICK_KEY, MOTION_SENSES, HearsSent, NotFinite, Observation, require_level
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerRule
from wcsim.supervisor.actions import action_set
from wcsim.types import F64, Bool

_SURE: Final = 60.0  # a logit beyond it says no more


class DangerPolicy(HearsSent):
    """Drives one chair: its action is the nearest to the user's stick that is safe enough.

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
        self.name, self.senses = name, MOTION_SENSES
        self.rule, self._net, self._alarm = rule, net, Alarm()
        self._device = next(net.parameters()).device
        self._actions = action_set(config.env.actions)
        self._extractor = FeatureExtractor(config, delay_ticks, net.spec.street, net.spec.pictures)
        self._last, self._recent = -1, 0
        self.unsafe: Bool = np.zeros(len(self._actions), np.bool_)  # (A,) above the threshold at the last choice
        self.features: Features  # of the newest observation

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
        self.rule = self.rule.model_copy(update={"threshold": level})

    def set_delay(self, ticks: int) -> None:
        """From the next `reset` on a command reaches the chair so many ticks late."""
        self._extractor.around.ego.delay_ticks = ticks

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self._extractor.forget()
        self._alarm, self._last, self._recent = Alarm(), -1, 0

    def choose(self, observation: Observation) -> int:
        """The action, while another one may still be sent."""
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        self.observe(observation)
        danger = self.danger(self.features)
        own = self._actions.nearest(stick)
        self._alarm = next_alarm(self._alarm, float(danger[own]), self.rule.warn)
        self.unsafe = ~within(danger, self.rule, self._last)
        taken = choose(danger, stick, self._actions, self.rule, self._last, self._recent > 0)
        # After the choice, which goes by what was unsafe before this tick.
        self._recent = next_recent(self._recent, bool(self.unsafe[own]), float(danger[own]), self.rule)
        return taken

    def observe(self, observation: Observation) -> None:
        """Take in the observation, and choose nothing."""
        self.features = self._extractor.extract(observation)

    def sent(self, action: int) -> None:
        """Say which action is carried out."""
        self._extractor.command(action)
        self._last = action

    def danger(self, features: Features) -> F64:
        """How bad each action is, (A,) in 0..1. Raises NotFinite when the network leaves the finite numbers."""
        with torch.inference_mode():
            tensors = [part.to(self._device) for part in to_tensors(self._extractor, *features.batch())]
            logits = self._net(*tensors).cpu().numpy()[0]
        if not np.isfinite(logits).all():
            raise NotFinite(f"policy {self.name!r} returns dangers that are not finite; train it again")
        # In float64 and clipped, so that exp never overflows and equal logits stay equal dangers.
        danger: F64 = 1.0 / (1.0 + np.exp(-logits.astype(np.float64).clip(-_SURE, _SURE)))
        return danger
