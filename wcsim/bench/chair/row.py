"""What a trial is asked and what it answers: one row of the table of a plant."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from wcsim.config import ChairConfig
from wcsim.errors import PhysicsError

SLOWEST_HZ: Final = 100
FASTEST_HZ: Final = 1000
TICK_S: Final = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """The chair that is tried and the rate of its physics.

    Raises:
        PhysicsError: `hz` is out of bounds or does not divide a tick of 0.1 s.
    """

    chair: ChairConfig
    hz: int

    def __post_init__(self) -> None:
        if not SLOWEST_HZ <= self.hz <= FASTEST_HZ or self.hz % 10:
            raise PhysicsError(
                f"physics rate is {self.hz} Hz; expected a multiple of 10 from {SLOWEST_HZ} to {FASTEST_HZ} Hz"
            )

    @property
    def substeps(self) -> int:
        """Physics steps in a tick of 0.1 s."""
        return self.hz // 10

    def at_speed(self, v_max_mps: float) -> Setup:
        """The same chair with another top speed."""
        return self._with(v_max_mps=v_max_mps, profile="custom")

    def at_com_height(self, com_height_m: float) -> Setup:
        """The same chair with its centre of mass at another height."""
        return self._with(com_height_m=com_height_m)

    def _with(self, **changed: float | str) -> Setup:
        return Setup(chair=self.chair.model_copy(update=changed), hz=self.hz)


Measure = Callable[[Setup], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One row before it was measured.

    Args:
        name: The row's name, unique in a table.
        unit: Unit of the value, "" for none.
        low: Smallest value that is expected.
        high: Largest value that is expected.
        method: How the value is taken, in a sentence.
        source: Where the expectation comes from.
        measure: A pure function from chair and rate to the value.
        impact: Whether the value is the peak of an impact, which depends on the step more than others do.
    """

    name: str
    unit: str
    low: float
    high: float
    method: str
    source: str
    measure: Measure
    impact: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of the table: a value beside the range that is expected, the method and its source."""

    name: str
    value: float
    unit: str
    low: float
    high: float
    method: str
    source: str
    ok: bool
    impact: bool = False


def at_speed(setup: Setup, speed_mps: float, measure: Measure) -> float:
    """A trial's value at another top speed."""
    return measure(setup.at_speed(speed_mps))


def measured(trial: Trial, setup: Setup) -> Row:
    """Do a trial. Raises PhysicsError when its value is not finite."""
    value = float(trial.measure(setup))
    if not math.isfinite(value):
        raise PhysicsError(f"trial {trial.name}: the value is {value}; expected a finite number: check the plant")
    return Row(
        name=trial.name,
        value=value,
        unit=trial.unit,
        low=trial.low,
        high=trial.high,
        method=trial.method,
        source=trial.source,
        ok=trial.low <= value <= trial.high,
        impact=trial.impact,
    )
