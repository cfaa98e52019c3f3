"""A trial and its result: one row of a plant's table, and how it changes with the rate."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Final, Literal, Self

from wcsim.config import ChairConfig, ImuConfig
from wcsim.core.reading import read_module_toml
from wcsim.errors import PhysicsError

SLOWEST_HZ: Final = 100
FASTEST_HZ: Final = 1000
TICK_S: Final = 0.1
_KINDS: Final = read_module_toml(__file__)
_MOST_CHANGE: Final = 0.10
_MOST_CHANGE_IMPACT: Final = 0.15

Bound = Literal["norm", "file", "stick", "wcsim", "rwd, mwd", "trial"]
"""The source of an expectation: a standard, the parameter file, the stick and the controller's
settings, wcsim, what its own plants felt, or an experiment with a rear-wheel drive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSetup:
    """The chair that is tried and the rate of its physics.

    Raises:
        PhysicsError: `hz` is out of bounds or does not divide a tick of 0.1 s.
    """

    chair: ChairConfig
    hz: int
    imu: ImuConfig = field(default_factory=ImuConfig)
    rolling: bool = False  # whether it drives without the engine where it can

    def __post_init__(self) -> None:
        if not SLOWEST_HZ <= self.hz <= FASTEST_HZ or self.hz % 10:
            raise PhysicsError(
                f"physics rate is {self.hz} Hz; "
                f"expected a multiple of 10 from {SLOWEST_HZ} to {FASTEST_HZ} Hz"
            )

    @property
    def substeps(self) -> int:
        """Physics steps in a tick of 0.1 s."""
        return self.hz // 10

    def at_speed(self, v_max_mps: float) -> Self:
        """The same chair with another top speed."""
        return self._with(v_max_mps=v_max_mps, profile="custom")

    def at_com_height(self, com_height_m: float) -> Self:
        """The same chair with its centre of mass at another height."""
        return self._with(com_height_m=com_height_m)

    def _with(self, **changed: float | str) -> Self:
        return replace(self, chair=self.chair.model_copy(update=changed))


@dataclass(frozen=True, slots=True, kw_only=True)
class UnfinishedMeasurement:
    """The result of a trial that did not finish: how far it got, and what happened."""

    value: float
    what: str


Measure = Callable[[TrialSetup], float | UnfinishedMeasurement]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Expected:
    """What is expected of one value.

    Args:
        name: The row's name, unique in a table.
        unit: Unit of the value, "" for none.
        bound: Who says what is expected.
        low: Smallest value that is expected.
        high: Largest value that is expected.
        method: How the value is taken, in a sentence.
        source: Where the expectation comes from.
        impact: Whether the value is the peak of an impact, which depends on the step more than
            others do.
        judged: Whether a value out of its range is a fault; it is none where the range is another
            kind of chair's.
    """

    name: str
    unit: str
    bound: Bound
    low: float
    high: float
    method: str
    source: str
    impact: bool = False
    judged: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSpec(_Expected):
    """One row before it was measured."""

    measure: Measure  # a pure function from chair and rate to the value
    speed_mps: float | None = None  # top speed that the chair is set to; None keeps its own


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialResult(_Expected):
    """One row of the table: a value beside what is expected."""

    value: float
    ok: bool
    note: str = ""  # what happened, where the value does not say it

    @property
    def red(self) -> bool:
        """Whether it is a fault."""
        return self.judged and not self.ok


def make_trial_spec(
    kind: str,
    measure: Measure,
    expected: float = 1.0,
    span: tuple[float, float] | None = None,
    speed_mps: float | None = None,
    judged: bool = True,
    **words: object,
) -> TrialSpec:
    """A trial of a kind of `row.toml`.

    Args:
        kind: The kind, which is the pattern of its name too.
        measure: How its value is taken.
        expected: What its bounds there belong to.
        span: Its bounds, where they are not there.
        speed_mps: As of a `TrialSpec`.
        judged: As of a `TrialSpec`.
        words: Those of its texts in braces.
    """
    row = _KINDS[kind]
    if "within" in row:
        span = expected - row["within"], expected + row["within"]
    low, high = span or (part * expected for part in row["times"])
    return TrialSpec(
        name=kind.format(**words),
        unit=row["unit"],
        bound=row["bound"],
        low=low,
        high=high,
        method=row["method"].format(**words),
        source=row["source"].format(**words),
        impact=row.get("impact", False),
        judged=judged,
        measure=measure,
        speed_mps=speed_mps,
    )


def run_trial(trial: TrialSpec, setup: TrialSetup) -> TrialResult:
    """Do a trial. Raises PhysicsError when its value is not finite."""
    found = trial.measure(setup if trial.speed_mps is None else setup.at_speed(trial.speed_mps))
    value, note = (
        (found.value, found.what)
        if isinstance(found, UnfinishedMeasurement)
        else (float(found), "")
    )
    if not math.isfinite(value):
        raise PhysicsError(
            f"trial {trial.name}: the value is {value}; expected a finite number: check the plant"
        )
    expected = {item.name: getattr(trial, item.name) for item in fields(_Expected)}
    return TrialResult(
        **expected, value=value, ok=not note and trial.low <= value <= trial.high, note=note
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RowComparison:
    """One row of several tables."""

    name: str
    unit: str
    values: tuple[float, ...]  # in the order of the tables
    change: float  # largest difference between two of them, as a share
    most: float
    ok: bool


def compare_rows(tables: Sequence[Sequence[TrialResult]]) -> list[RowComparison]:
    """The change of every row over tables of the same plant.

    The difference between the largest and the smallest value counts as a share of the largest
    magnitude; of the bound instead, where a row is expected to lie near zero and its bound is
    larger.
    """
    by_name = [{row.name: row for row in rows} for rows in tables]
    out = []
    for name, first in by_name[0].items():
        rows = [rows[name] for rows in by_name if name in rows]
        values = tuple(row.value for row in rows)
        bounds = (first.low, first.high) if first.low <= 0.0 <= first.high else ()
        whole = max(map(abs, (*values, *bounds)))
        change = (max(values) - min(values)) / whole if whole > 0.0 else 0.0
        most = _MOST_CHANGE_IMPACT if first.impact else _MOST_CHANGE
        out.append(
            RowComparison(
                name=name,
                unit=first.unit,
                values=values,
                change=change,
                most=most,
                ok=change <= most,
            )
        )
    return out
