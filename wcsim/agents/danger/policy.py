"""A danger network as a policy, and its folder on disk.

A rule chooses the action. It takes the user's own position until that is clearly dangerous, for
more than a single tick that may be noise. Then it takes a near position that is safe enough, until
the user's own is safe again. The choice among these is calm: the chair does not waver between two
ways round an obstacle. The threshold of danger is the level of assistance; it can be set while
driving.
"""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

import numpy as np
import torch

from wcsim.agents.danger.dataset import to_tensors
from wcsim.agents.danger.network import DangerNet, channels_last, spec_of
from wcsim.agents.danger.street_map import FeatureExtractor, Features
from wcsim.agents.perception.alarm import AlarmState, next_alarm_state
from wcsim.agents.policy_api import (
    JOYSTICK_KEY,
    MOTION_SENSES,
    HearsSent,
    NotFinite,
    Observation,
    require_level,
)
from wcsim.agents.runs.policy_file import read_danger_policy_file, require_danger_policy_fits
from wcsim.agents.runs.weights import load_network, write_policy_folder
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerRuleSettings
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.rewards import reward_of_distance
from wcsim.types import F64, Bool

LEVELS: Final = (0.95, 0.02)  # thresholds that assist least and most
USUAL_THRESHOLD: Final = 0.2  # at which a crash costs what `StickValue` says
# For so long after the user's own action was taken away, one unsafe tick takes it away again.
RECENT_TICKS: Final = 5
# Of the threshold: an action of the user that was taken away is given back below this danger.
GIVES_BACK: Final = 0.5
# Danger that counts as much as a joystick distance of 1 where no action is safe enough.
DANGER_PER_DISTANCE: Final = 0.02
_TAKES_AWAY: Final = 12.0  # times the odds of the threshold
_MAX_LOGIT: Final = 60.0  # a logit beyond it says no more


class DangerPolicy(HearsSent):
    """Drives one chair: of the actions that are safe enough it takes one near the user's stick.

    Args:
        name: In tables.
        net: The network; policies that act in turn may share it.
        config: Of the run: its cameras of `env.camera` are seen, and its chair driven.
        rule: From dangers to an action.
        delay_ticks: From a command to the chair that obeys it; None for the configuration's.
    """

    levels = LEVELS

    def __init__(
        self,
        name: str,
        net: DangerNet,
        config: RunConfig,
        rule: DangerRuleSettings,
        delay_ticks: int | None = None,
    ) -> None:
        self.name, self.senses = name, MOTION_SENSES
        self.rule, self._net, self._alarm = rule, net, AlarmState()
        self._device = next(net.parameters()).device
        self._actions = action_set(config.env.actions)
        # A network of one camera sees that alone, whatever else is in the observation.
        names = [camera.name for camera in config.eyes.values()][: 1 + len(net.spec.more_cameras)]
        env = config.env.model_copy(update={"camera": names})
        self.extractor = FeatureExtractor(config.model_copy(update={"env": env}), delay_ticks)
        self._last, self._recent = -1, 0  # the last action, and see `_next_recent`
        self.unsafe: Bool = np.zeros(len(self._actions), np.bool_)  # (A,) at the last choice
        self.features: Features  # of the newest observation
        self._judged: F64 | None = None  # (A,) dangers for the next choice, of `judge_together`

    @property
    def warning(self) -> bool:
        """Whether the user's own stick is about to end badly, see `next_alarm_state`."""
        return self._alarm.on

    @property
    def level(self) -> float:
        """The threshold of danger."""
        return self.rule.threshold

    def set_level(self, level: float) -> None:
        """Use this threshold from the next choice on. Raises PolicyError if out of bounds."""
        require_level(level, LEVELS)
        self.rule = self.rule.model_copy(update={"threshold": level})

    def set_delay(self, ticks: int) -> None:
        """From the next `reset` on, commands reach the chair this many ticks late."""
        self.extractor.around.ego.delay_ticks = ticks

    def begin(self) -> None:
        """A test starts; no state outlives an episode."""

    def reset(self) -> None:
        """An episode starts: the chair stands still, and the street is unknown."""
        self.extractor.forget()
        self._alarm, self._last, self._recent = AlarmState(), -1, 0
        self._judged = None

    def choose(self, observation: Observation) -> int:
        """The action for this observation; another one may be sent.

        Raises:
            PolicyError: The observation lacks a sense.
            NotFinite: The dangers are not finite.
        """
        # 1. The dangers, unless `judge_together` has computed them.
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        danger, self._judged = self._judged, None
        if danger is None:
            self.observe(observation)
            (danger,) = self._judge([self.features])
        if not np.isfinite(danger).all():
            raise NotFinite(
                f"policy {self.name!r} returns dangers that are not finite; train it again"
            )

        # 2. The warning, of the user's own action.
        own = self._actions.nearest(stick)
        self._alarm = next_alarm_state(self._alarm, float(danger[own]), self.rule.warn)

        # 3. The choice. It depends on what was unsafe before this tick.
        taken = own if self._recent > 1 and own != self._last else -1
        free = own if self._recent == 0 else -1
        self.unsafe = ~_mask_safe_actions(danger, self.rule, self._last, taken, free)
        chosen = _choose(
            danger, stick, self._actions, self.rule, self._last, self._recent > 0, taken
        )
        self._recent = _next_recent(
            self._recent, bool(self.unsafe[own]), float(danger[own]), self.rule
        )
        return chosen

    def observe(self, observation: Observation) -> None:
        """Take in an observation without choosing. Raises PolicyError when it lacks a sense."""
        self.features = self.extractor.extract(observation)

    def sent(self, action: int) -> None:
        """Record the action that is executed."""
        self.extractor.command(action)
        self._last = action

    def judge_together(self, seen: Sequence[tuple[Self, Observation]]) -> None:
        """Compute the dangers for several policies of this network in one call.

        Each of them takes in its observation, which it is given in its next `choose` again.
        """
        observed = []
        for policy, observation in seen:
            # One that lacks a sense raises this error again in `choose`.
            with suppress(PolicyError):
                policy.observe(observation)
                observed.append(policy)
        if observed:
            batch = [policy.features for policy in observed]
            for policy, danger in zip(observed, self._judge(batch), strict=True):
                policy._judged = danger

    def _judge(self, features: Sequence[Features]) -> F64:
        """(B, A) the danger of each action in 0..1; NaN where a logit is not finite."""
        batch = map(np.concatenate, zip(*(each.batch() for each in features), strict=True))
        with torch.inference_mode():
            tensors = [part.to(self._device) for part in to_tensors(self.extractor, *batch)]
            logits = self._net(*tensors).cpu().numpy().astype(np.float64)
        # In float64 and clipped: exp never overflows, and equal logits stay equal dangers.
        danger = 1.0 / (1.0 + np.exp(-logits.clip(-_MAX_LOGIT, _MAX_LOGIT)))
        return np.where(np.isfinite(logits), danger, np.nan)


def load_danger(
    folder: Path, name: str, config: RunConfig, level: float | None = None
) -> DangerPolicy:
    """A policy for one chair.

    Args:
        folder: Of the policy.
        name: In tables.
        config: Of the run in which it drives.
        level: Of assistance, a threshold of danger; None for the policy's own.

    Raises:
        PolicyError: A file is missing, damaged or unfit. Or the policy was trained with other
            cameras, classes or actions.
    """
    require_danger_policy_fits(folder, name, config)
    net, rule = load_net(folder, level)
    return DangerPolicy(name, net, config, rule)


def load_net(folder: Path, level: float | None = None) -> tuple[DangerNet, DangerRuleSettings]:
    """The network and the rule of a policy folder; for `level` see `load_danger`.

    Raises:
        PolicyError: A file is missing, damaged or unfit.
    """
    file = read_danger_policy_file(folder)
    net = load_network(folder, file.weights_sha256, lambda: DangerNet(file))
    net.train(False)
    rule = file.rule if level is None else file.rule.model_copy(update={"threshold": level})
    return channels_last(net), rule


def save_danger(
    folder: Path,
    net: DangerNet,
    rule: DangerRuleSettings,
    config: RunConfig,
    manifest_sha256: str = "",
) -> Path:
    """Write a policy folder in one step, replacing an older one; returns it.

    Args:
        folder: The policy folder.
        net: With its weights.
        rule: From dangers to an action.
        config: Of the run.
        manifest_sha256: Of the run, "" for none.

    Raises:
        DiskFullError: There is no room.
    """
    facts = {
        "schema_version": 2,
        "algorithm": "danger",
        "net": net.spec.net.model_dump(),
        "rule": rule.model_dump(),
        **spec_of(config).model_dump(mode="json", exclude={"net"}),
        "chair": config.chair.model_dump(mode="json"),
        "manifest_sha256": manifest_sha256,
    }
    return write_policy_folder(folder, net, facts)


def takes_away_at(rule: DangerRuleSettings) -> float:
    """The danger from which on the user's own action is taken away.

    What is a little above the threshold is mostly a doubt, and users see to it themselves.

    >>> rules = [DangerRuleSettings(threshold=level, at_once=0.6) for level in (0.02, 0.05, 0.2)]
    >>> [round(takes_away_at(rule), 2) for rule in rules]
    [0.2, 0.39, 0.6]
    """
    doubt = _TAKES_AWAY * rule.threshold / (1.0 + (_TAKES_AWAY - 1.0) * rule.threshold)
    return max(rule.threshold, min(doubt, rule.at_once))


def _choose(
    danger: F64,
    stick: F64,
    actions: ActionSet,
    rule: DangerRuleSettings,
    last: int = -1,
    recent: bool = True,
    taken: int = -1,
) -> int:
    """The action for these dangers.

    Args:
        danger: (A,) in 0..1.
        stick: (2,) the user's.
        actions: The joystick positions.
        rule: Its thresholds and costs.
        last: The action before, -1 for none.
        recent: Whether the user's own action was unsafe a short time ago, see `_next_recent`.
        taken: The user's own action if it was taken away and is not given back yet, else -1.
    """
    distance = actions.distances(stick[None])[0]
    # 1. Where sticks have a value, the highest one.
    if rule.value is not None:
        paid = rule.value.steps * reward_of_distance(distance, rule.value)
        # A lower threshold makes crashes dearer.
        value = paid - rule.value.crash * danger * (USUAL_THRESHOLD / rule.threshold)
        # Of equal values the nearest one.
        return int(np.argmax(value - 1e-3 * distance))

    # 2. The user's own action, if it is safe enough or its danger may be noise.
    own = int(np.argmin(distance))
    safe = _mask_safe_actions(danger, rule, last, taken, -1 if recent else own)
    if safe[own] or (not recent and danger[own] < rule.at_once):
        return own

    # 3. Nothing is safe: the least danger, and the distance only where dangers tie, as at 1.
    if not safe.any():
        return int(np.argmin(danger + DANGER_PER_DISTANCE * distance))

    # 4. The cheapest of the safe ones.
    cost = distance + rule.danger_cost * danger / rule.threshold
    if last >= 0:
        # Noise changes dangers more than neighbours differ: without this the chair would waver.
        cost[last] -= rule.hysteresis
    return int(np.argmin(np.where(safe, cost, np.inf)))


def _mask_safe_actions(
    danger: F64, rule: DangerRuleSettings, last: int = -1, taken: int = -1, free: int = -1
) -> Bool:
    """(A,) which actions are safe enough; for the arguments see `_choose`.

    `free` is the user's own action where it was not unsafe a short time ago, else -1.
    """
    limit = np.full(len(danger), rule.threshold)
    if last >= 0:
        # Near the threshold the last action would be safe in one tick and unsafe in the next.
        limit[last] *= rule.hysteresis_factor
    if taken >= 0:
        limit[taken] *= GIVES_BACK
    if free >= 0:
        limit[free] = takes_away_at(rule)
    return danger < limit


def _next_recent(before: int, unsafe: bool, danger: float, rule: DangerRuleSettings) -> int:
    """For how many more ticks a single unsafe tick is enough to take the user's own action away.

    Args:
        before: The result of the last tick; 0 at the start.
        unsafe: Whether the user's own action is unsafe in this tick.
        danger: Of the user's own action.
        rule: Its `at_once` is a danger that is no noise.

    >>> rule, ticks, found = DangerRuleSettings(at_once=0.6), 0, []
    >>> for danger in (0.3, 0.0, 0.3, 0.3, 0.0):
    ...     ticks = _next_recent(ticks, danger >= rule.threshold, danger, rule)
    ...     found.append(ticks)
    >>> found
    [1, 0, 1, 5, 4]
    """
    if not unsafe:
        return max(before - 1, 0)
    return RECENT_TICKS if before > 0 or danger >= rule.at_once else 1
