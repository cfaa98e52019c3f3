"""A danger network as a policy: it sees, says how bad each joystick position is, and answers the user's stick."""

from __future__ import annotations

import numpy as np
import torch

from wcsim.agents.danger.network import DangerNet
from wcsim.agents.danger.roll_outs import EACH_SLICE, SLICES, sweep
from wcsim.agents.danger.rule import DangerRule, choose
from wcsim.agents.danger.sight import DangerSight, Eye
from wcsim.agents.policies.dynamic_window.surroundings import SENSES
from wcsim.agents.policy_api import JOYSTICK_KEY, NotFinite, Observation
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.types import F64


class DangerPolicy:
    """Drives one chair.

    Args:
        name: How tables call it.
        net: The network; it may be shared by policies that act in turn.
        config: Of the run: its first camera is seen, and its chair driven.
        rule: From dangers to an action.
        delay_ticks: From a command to the chair that obeys it; as the configuration says when it is None.
    """

    senses = SENSES

    def __init__(
        self, name: str, net: DangerNet, config: RunConfig, rule: DangerRule, delay_ticks: int | None = None
    ) -> None:
        self.name, self.warning = name, False
        self._net, self._rule = net, rule
        self._actions = action_set(config.env.actions)
        self._eye = Eye(config, delay_ticks, net.spec.gaps, net.spec.rival)
        self._last = -1

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self._eye.forget()
        self.warning, self._last = False, -1

    def act(self, observation: Observation) -> int:
        """The action nearest to the user's stick that is safe enough."""
        action = self.choose(observation)
        self.sent(action)
        return action

    def choose(self, observation: Observation) -> int:
        """The same, while another action may still be sent."""
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        danger = self.danger(self._eye.look(observation))
        self.warning = bool(danger[self._actions.nearest(stick)] > self._rule.warn)
        return choose(danger, stick, self._actions, self._rule, self._last)

    def watch(self, observation: Observation) -> None:
        """See what there is to see, and choose nothing."""
        self._eye.look(observation)

    def sent(self, action: int) -> None:
        """Say which action is carried out."""
        self._eye.command(action)
        self._last = action

    def danger(self, sight: DangerSight) -> F64:
        """How bad each action is, (A,) in 0..1. Raises NotFinite when the network leaves the finite numbers."""
        with torch.inference_mode():
            logits = self._net(*inputs([sight], self._eye)).numpy()[0]
        if not np.isfinite(logits).all():
            raise NotFinite(f"policy {self.name!r} gives dangers that are not finite; train it again")
        danger: F64 = 1.0 / (1.0 + np.exp(-logits.astype(np.float64)))
        return danger


def inputs(sights: list[DangerSight], eye: Eye) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """What the network is called with, for a batch of sights of chairs like that of `eye`."""
    around, starts = eye.around, np.stack([sight.start for sight in sights]).astype(np.float64)
    swept = np.empty((len(sights), len(around.commands), SLICES * EACH_SLICE * len(eye.chair)), np.int32)
    sweep(starts, around.commands, around.limits, eye.chair, swept)
    return (
        torch.from_numpy(np.stack([sight.picture for sight in sights])).float() / 255.0,
        torch.from_numpy(np.stack([sight.actions for sight in sights])).float() / 255.0,
        torch.from_numpy(np.stack([sight.vector for sight in sights])),
        torch.from_numpy(swept).long(),
    )
