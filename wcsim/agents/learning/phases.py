"""The two phases of learning (Action Driven, then Agent Driven) as a plan in steps."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class LearningPhase(IntEnum):
    """Whose joystick is executed while learning."""

    ACTION_DRIVEN = 1  # the user's
    AGENT_DRIVEN = 2  # the agent's


@dataclass(frozen=True, slots=True, kw_only=True)
class PhasePlan:
    """When the phases change and how exploration and supervision fade; pure functions of the step.

    >>> plan = PhasePlan(total_steps=100, phase1_steps=20, epsilon_start=0.2, epsilon_end=0.0, margin_fade=0.25)
    >>> [plan.phase(step).value for step in (0, 19, 20)], plan.epsilon(19), plan.epsilon(60), plan.margin_weight(30)
    ([1, 1, 2], 0.0, 0.1, 0.5)
    """

    total_steps: int
    phase1_steps: int
    epsilon_start: float = 0.2
    epsilon_end: float = 0.05
    margin: float = 1.0
    margin_fade: float = 0.25
    aid: float = 0.0

    def phase(self, step: int) -> LearningPhase:
        """The phase of the step that follows `step` steps done."""
        return LearningPhase.ACTION_DRIVEN if step < self.phase1_steps else LearningPhase.AGENT_DRIVEN

    def progress(self, step: int) -> float:
        """Share of the second phase that is over, 0..1."""
        length = max(self.total_steps - self.phase1_steps, 1)
        return min(max((step - self.phase1_steps) / length, 0.0), 1.0)

    def epsilon(self, step: int) -> float:
        """Exploration rate: 0 in the first phase, then linear from start to end."""
        if self.phase(step) is LearningPhase.ACTION_DRIVEN:
            return 0.0
        return self.epsilon_start + self.progress(step) * (self.epsilon_end - self.epsilon_start)

    def margin_weight(self, step: int) -> float:
        """Weight of the supervised loss: full in the first phase, gone after `margin_fade` of the second."""
        if self.phase(step) is LearningPhase.ACTION_DRIVEN:
            return self.margin
        if self.margin_fade <= 0.0:
            return 0.0
        return self.margin * max(0.0, 1.0 - self.progress(step) / self.margin_fade)

    def aid_weight(self, step: int) -> float:
        """Weight of the advice from the truth: none in the first phase, which teaches obedience alone."""
        return 0.0 if self.phase(step) is LearningPhase.ACTION_DRIVEN else self.aid
