"""A danger network as a policy: what it sees, the rule that answers the user's stick, and its folder on disk.

The rule takes the user's own position whenever it is safe enough, or is not for a single tick; among the others the
choice is calm, so
that the chair does not waver between two ways round. The threshold is the assistance level, and can be set at run time.
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
from wcsim.agents.policy_api import JOYSTICK_KEY, MOTION_SENSES, HearsSent, NotFinite, Observation, require_level
from wcsim.agents.runs.policy_file import read_danger_policy_file, require_danger_policy_fits
from wcsim.agents.runs.weights import load_network, write_policy_folder
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerRuleSettings
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.rewards import reward_of_distance
from wcsim.types import F64, Bool

LESS_M = 0.02  # danger that a joystick distance of 1 is worth where nothing is safe
LEVELS: Final = (0.95, 0.02)  # thresholds that may be set while driving: with the first it assists least
RECENT_TICKS: Final = 5  # for so long after it was taken away, the user's own is again as soon as it is unsafe
USUAL_THRESHOLD: Final = 0.2
GIVES_BACK: Final = 0.5  # of the threshold: what was taken away is given back only where there is room


def _within(danger: F64, rule: DangerRuleSettings, last: int = -1, taken: int = -1) -> Bool:
    """(A,) which actions are safe enough; the arguments are those of `_choose`."""
    limit = np.full(len(danger), rule.threshold)
    if last >= 0:
        # Near the threshold the last action would be allowed in one tick and not in the next.
        limit[last] *= rule.hysteresis_factor
    if taken >= 0:
        limit[taken] *= GIVES_BACK
    return danger < limit


def _next_recent(before: int, unsafe: bool, danger: float, rule: DangerRuleSettings) -> int:
    """For how many ticks more the user's own action is taken away as soon as it is unsafe.

    Args:
        before: What it was a tick ago; 0 at the start.
        unsafe: Whether the user's own action is unsafe in this tick.
        danger: Of it.
        rule: See there.

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


def _choose(
    danger: F64,
    stick: F64,
    actions: ActionSet,
    rule: DangerRuleSettings,
    last: int = -1,
    recent: bool = True,
    taken: int = -1,
) -> int:
    """The action. Where none is safe enough, it is the least dangerous.

    Args:
        danger: (A,) in 0..1.
        stick: (2,) the user's.
        actions: The joystick positions.
        rule: See there.
        last: The action before, -1 for none.
        recent: Whether the user's own was unsafe a short time ago, see `_next_recent`.
        taken: The user's own where it was taken away and is not given back yet, else -1.
    """
    distance = actions.distances(stick[None])[0]
    cost = distance + rule.danger_cost * danger / rule.threshold
    # Noise moves dangers by more than neighbours differ: without it the chair would waver between two ways round.
    if last >= 0:
        cost[last] -= rule.hysteresis
    allowed = _within(danger, rule, last, taken)
    own = int(np.argmin(distance))
    if rule.value is not None:
        paid = rule.value.steps * reward_of_distance(distance, rule.value)
        # A lower threshold makes crashes dearer.
        value = paid - rule.value.crash * danger * (USUAL_THRESHOLD / rule.threshold)
        return int(np.argmax(value - 1e-3 * distance))
    if allowed[own] or (not recent and danger[own] < rule.at_once):
        return own
    if allowed.any():
        return int(np.argmin(np.where(allowed, cost, np.inf)))
    # All are bad: safety decides, and the stick only where dangers tie, as they do at 1.
    return int(np.argmin(danger + LESS_M * distance))


_SURE: Final = 60.0  # a logit beyond it says no more


class DangerPolicy(HearsSent):
    """Drives one chair: its action is the nearest to the user's stick that is safe enough.

    Args:
        name: How tables call it.
        net: The network; it may be shared by policies that act in turn.
        config: Of the run: its cameras of `env.camera` are seen, and its chair driven.
        rule: From dangers to an action.
        delay_ticks: From a command to the chair that obeys it; as the configuration says when it is None.
    """

    levels = LEVELS

    def __init__(
        self, name: str, net: DangerNet, config: RunConfig, rule: DangerRuleSettings, delay_ticks: int | None = None
    ) -> None:
        self.name, self.senses = name, MOTION_SENSES
        self.rule, self._net, self._alarm = rule, net, AlarmState()
        self._device = next(net.parameters()).device
        self._actions = action_set(config.env.actions)
        # A network of one camera sees that alone, whatever else is in the observation.
        names = [camera.name for camera in config.eyes.values()][: 1 + len(net.spec.more_cameras)]
        env = config.env.model_copy(update={"camera": names})
        self.extractor = FeatureExtractor(config.model_copy(update={"env": env}), delay_ticks)
        self._last, self._recent = -1, 0
        self.unsafe: Bool = np.zeros(len(self._actions), np.bool_)  # (A,) above the threshold at the last choice
        self.features: Features  # of the newest observation
        self._judged: F64 | None = None  # (A,) dangers of what `judge_together` has taken in

    @property
    def warning(self) -> bool:
        """Whether the user's own stick is about to end badly, see `next_alarm_state`."""
        return self._alarm.on

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
        self.extractor.around.ego.delay_ticks = ticks

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        """Stand still, and know nothing of the street."""
        self.extractor.forget()
        self._alarm, self._last, self._recent = AlarmState(), -1, 0
        self._judged = None

    def choose(self, observation: Observation) -> int:
        """The action, while another one may still be sent."""
        stick = np.asarray(observation[JOYSTICK_KEY], np.float64)
        danger, self._judged = self._judged, None
        if danger is None:
            self.observe(observation)
            (danger,) = self._judge([self.features])
        if not np.isfinite(danger).all():
            raise NotFinite(f"policy {self.name!r} returns dangers that are not finite; train it again")
        own = self._actions.nearest(stick)
        self._alarm = next_alarm_state(self._alarm, float(danger[own]), self.rule.warn)
        taken = own if self._recent > 1 and own != self._last else -1
        self.unsafe = ~_within(danger, self.rule, self._last, taken)
        chosen = _choose(danger, stick, self._actions, self.rule, self._last, self._recent > 0, taken)
        # After the choice, which goes by what was unsafe before this tick.
        self._recent = _next_recent(self._recent, bool(self.unsafe[own]), float(danger[own]), self.rule)
        return chosen

    def observe(self, observation: Observation) -> None:
        """Take in the observation, and choose nothing."""
        self.features = self.extractor.extract(observation)

    def sent(self, action: int) -> None:
        """Say which action is carried out."""
        self.extractor.command(action)
        self._last = action

    def judge_together(self, seen: Sequence[tuple[Self, Observation]]) -> None:
        """Take in what several policies see, all with this network; judge it in one call.

        Each of them is to choose for that observation next.
        """
        observed = []
        for policy, observation in seen:
            # One that cannot use what it sees says so when it chooses.
            with suppress(PolicyError):
                policy.observe(observation)
                observed.append(policy)
        if observed:
            batch = [policy.features for policy in observed]
            for policy, danger in zip(observed, self._judge(batch), strict=True):
                policy._judged = danger

    def _judge(self, features: Sequence[Features]) -> F64:
        """(B, A) how bad each action is, in 0..1; NaN where the network leaves the finite numbers."""
        batch = map(np.concatenate, zip(*(each.batch() for each in features), strict=True))
        with torch.inference_mode():
            tensors = [part.to(self._device) for part in to_tensors(self.extractor, *batch)]
            logits = self._net(*tensors).cpu().numpy().astype(np.float64)
        # In float64 and clipped, so that exp never overflows and equal logits stay equal dangers.
        return np.where(np.isfinite(logits), 1.0 / (1.0 + np.exp(-logits.clip(-_SURE, _SURE))), np.nan)


def save_danger(
    folder: Path, net: DangerNet, rule: DangerRuleSettings, config: RunConfig, manifest_sha256: str = ""
) -> Path:
    """See `write_policy_folder`."""
    said = {
        "algorithm": "danger",
        "net": net.spec.net.model_dump(),
        "rule": rule.model_dump(),
        **spec_of(config).model_dump(mode="json", exclude={"net"}),
        "chair": config.chair.model_dump(mode="json"),
        "manifest_sha256": manifest_sha256,
    }
    return write_policy_folder(folder, net, said)


def load_net(folder: Path, level: float | None = None) -> tuple[DangerNet, DangerRuleSettings]:
    """The network of a policy folder, and its rule, with another level of assistance where there is one.

    Raises PolicyError: a file is missing, damaged or unfit.
    """
    file = read_danger_policy_file(folder)
    net = load_network(folder, file.weights_sha256, lambda: DangerNet(file))
    net.train(False)
    rule = file.rule if level is None else file.rule.model_copy(update={"threshold": level})
    return channels_last(net), rule


def load_danger(folder: Path, name: str, config: RunConfig, level: float | None = None) -> DangerPolicy:
    """A policy for one chair.

    Args:
        folder: Of the policy.
        name: How tables call it.
        config: Of the run in which it drives.
        level: Of assistance, a threshold of danger; None for the policy's own.

    Raises:
        PolicyError: It cannot be loaded, or was trained with another camera, class form or action set.
    """
    require_danger_policy_fits(folder, name, config)
    net, rule = load_net(folder, level)
    return DangerPolicy(name, net, config, rule)
