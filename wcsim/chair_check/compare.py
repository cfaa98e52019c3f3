"""How much the rows of a plant change with the step of the physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from wcsim.chair_check.row import Row

_MOST_CHANGE: Final = 0.10
_MOST_CHANGE_IMPACT: Final = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One row at several rates."""

    name: str
    unit: str
    values: tuple[float, ...]  # in the order of the rates
    change: float  # largest difference between two of them, as a share
    most: float
    ok: bool


def changes(tables: Mapping[int, Sequence[Row]]) -> list[Change]:
    """The change of every row over tables of the same plant, by rate in Hz.

    The difference between the largest and the smallest value counts as a share of the largest magnitude; of the bound
    instead, where a row is expected to lie near zero and its bound is larger.
    """
    by_rate = [{row.name: row for row in rows} for rows in tables.values()]
    out = []
    for name, first in by_rate[0].items():
        rows = [rows[name] for rows in by_rate if name in rows]
        values = tuple(row.value for row in rows)
        whole = max([abs(value) for value in values] + ([abs(first.low), abs(first.high)] if _near_zero(first) else []))
        change = (max(values) - min(values)) / whole if whole > 0.0 else 0.0
        most = _MOST_CHANGE_IMPACT if first.impact else _MOST_CHANGE
        out.append(Change(name=name, unit=first.unit, values=values, change=change, most=most, ok=change <= most))
    return out


def _near_zero(row: Row) -> bool:
    return row.low <= 0.0 <= row.high
