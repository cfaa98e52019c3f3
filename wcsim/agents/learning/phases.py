"""The two phases of learning, Action Driven and then Agent Driven, as functions of the step."""

from dataclasses import dataclass
from enum import IntEnum

from wcsim.config import LearnConfig


class LearningPhase(IntEnum):
    """Whose joystick is executed while learning."""

    ACTION_DRIVEN = 1  # the user's
    AGENT_DRIVEN = 2  # the agent's


@dataclass(frozen=True, slots=True)
class PhasePlan:
    """When the phases change and how exploration and supervision fade; pure functions of the step.

    >>> steps = {"total_steps": 100, "phase1_steps": 20}
    >>> plan = PhasePlan(LearnConfig(**steps, epsilon_start=0.2, epsilon_end=0.0))
    >>> [plan.phase(step).value for step in (0, 19, 20)], plan.epsilon(19), plan.epsilon(60)
    ([1, 1, 2], 0.0, 0.1)
    >>> plan.margin_weight(30)
    0.5
    """

    learn: LearnConfig

    def phase(self, step: int) -> LearningPhase:
        """The phase of the step that follows `step` steps done."""
        if step < self.learn.phase1_steps:
            return LearningPhase.ACTION_DRIVEN
        return LearningPhase.AGENT_DRIVEN

    def progress(self, step: int) -> float:
        """Share of the second phase that is over, 0..1."""
        first = self.learn.phase1_steps
        return min(max((step - first) / max(self.learn.total_steps - first, 1), 0.0), 1.0)

    def epsilon(self, step: int) -> float:
        """Exploration rate: 0 in the first phase, then linear from start to end."""
        if self.phase(step) is LearningPhase.ACTION_DRIVEN:
            return 0.0
        start, end = self.learn.epsilon_start, self.learn.epsilon_end
        return start + self.progress(step) * (end - start)

    def margin_weight(self, step: int) -> float:
        """Weight of the supervised loss: full in phase 1, faded over `margin_fade` of phase 2."""
        margin = 0.0 if self.learn.phase1 == "td" else self.learn.margin
        fade = self.learn.margin_fade
        if self.phase(step) is LearningPhase.ACTION_DRIVEN:
            return margin
        if fade <= 0.0:
            return 0.0
        return margin * max(0.0, 1.0 - self.progress(step) / fade)

    def aid_weight(self, step: int) -> float:
        """Weight of the advice from the truth: none in phase 1, which teaches obedience alone."""
        if self.learn.aid == "none" or self.phase(step) is LearningPhase.ACTION_DRIVEN:
            return 0.0
        return self.learn.aid_weight
