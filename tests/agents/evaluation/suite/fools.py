"""Policies with one fault each, as somebody may hand them in: `tests.agents.evaluation.suite.fools:Stands`."""

import numpy as np

from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.policy_api import Observation
from wcsim.config import RunConfig
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.kpi import MAX_FOLLOW_DISTANCE
from wcsim.types import ClassId


class Follows:
    """Gives the user's stick on, whatever comes."""

    name = "follows"
    warning = False

    def __init__(self, config: RunConfig) -> None:
        self.points = action_set(config.env.actions)
        self.steps = 0

    def begin(self) -> None:
        """Nothing outlives an episode."""

    def reset(self) -> None:
        self.steps = 0

    def act(self, observation: Observation) -> int:
        self.steps += 1
        x, y = self.stick(observation)
        return self.points.nearest((x, y))

    def stick(self, seen: Observation) -> tuple[float, float]:
        x, y = seen["joystick"].tolist()
        return x, y


class Stands(Follows):
    """Never moves."""

    def stick(self, seen: Observation) -> tuple[float, float]:
        return 0.0, 0.0


class NeverCrosses(Follows):
    """Stops before every carriageway."""

    def stick(self, seen: Observation) -> tuple[float, float]:
        return (0.0, 0.0) if _share(seen, (ClassId.ROAD,), low=0.75) > 0.3 else super().stick(seen)


class FreezesBeforeWalkers(Follows):
    """Stands while somebody is in the picture, however far away."""

    def stick(self, seen: Observation) -> tuple[float, float]:
        afraid = _share(seen, (ClassId.PERSON, ClassId.RIDER), low=0.0, middle=False) > 0.0
        return (0.0, 0.0) if afraid else super().stick(seen)


class Oscillates(Follows):
    """Follows on the average: now more to the left, now more to the right."""

    def stick(self, seen: Observation) -> tuple[float, float]:
        x, y = super().stick(seen)
        return x + (0.5 if self.steps % 2 else -0.5), y


class ReversesHome(Follows):
    """Goes back to where it came from."""

    def stick(self, seen: Observation) -> tuple[float, float]:
        return 0.0, -0.5


class OverridesLittle(Follows):
    """Gives the position farthest to the left that still counts as what was asked."""

    def act(self, observation: Observation) -> int:
        x, y = self.stick(observation)
        near = np.hypot(*(self.points.points - (x, y)).T) <= MAX_FOLLOW_DISTANCE
        return int(np.argmin(np.where(near, self.points.points[:, 0], 2.0))) if near.any() else super().act(observation)


class StandsAtKerbs(Follows):
    """Stands wherever a carriageway is in the lower half of the picture."""

    def stick(self, seen: Observation) -> tuple[float, float]:
        return (0.0, 0.0) if _share(seen, (ClassId.ROAD,), low=0.5, middle=False) > 0.02 else super().stick(seen)


class WarnsOnly(Follows):
    """Warns as `dwa` does, and lets its user drive."""

    senses = ("odometry", "gyro")

    def __init__(self, config: RunConfig) -> None:
        super().__init__(config)
        self.rule = make_baseline_policy("dwa", config)

    @property
    def warning(self) -> bool:  # type: ignore[override]
        return self.rule.warning

    def begin(self) -> None:
        self.rule.begin()

    def reset(self) -> None:
        super().reset()
        self.rule.reset()

    def act(self, observation: Observation) -> int:
        self.rule.act(observation)
        return super().act(observation)


class WarnsAlways(Follows):
    """Warns for a second every two."""

    @property
    def warning(self) -> bool:  # type: ignore[override]
        return self.steps % 20 < 10


def _share(seen: Observation, classes: tuple[ClassId, ...], low: float, middle: bool = True) -> float:
    """Of the picture below `low` of its height, or of its middle third, that shows these classes."""
    picture = seen["seg"].reshape(seen["seg"].shape[-2:])
    rows, columns = picture.shape
    part = picture[int(low * rows) :, columns // 3 : 2 * columns // 3] if middle else picture[int(low * rows) :]
    return float(np.isin(part, [int(item) for item in classes]).mean())


FOOLS = (
    *(Stands, NeverCrosses, FreezesBeforeWalkers, Oscillates, ReversesHome),
    *(OverridesLittle, StandsAtKerbs, WarnsOnly, WarnsAlways),
)
