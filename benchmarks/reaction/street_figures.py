"""What a street can be held against others by: speeds, stops and density of its traffic, and how near people come.

Of what SUMO moves, as it is shown; nobody is moved by it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from wcsim.types import F64, ActorKind, ActorState

MOVES_MPS = 0.3  # slower is standing
STOP_S = 2.0  # shorter is a stumble, and no stop
NEIGHBOUR_M = 5.0
BEHIND_M = 1.5
PAIR_M = 3.0  # who never comes nearer is no pair
_PERCENTILES = (5, 25, 50, 75, 95)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Values of one figure: how many, their percentiles 5, 25, 50, 75 and 95, and where their median may be."""

    n: int
    percentiles: tuple[float, ...]
    median_ci: tuple[float, float]  # 95 %, as if the values were independent

    @property
    def told(self) -> str:
        """Median, its interval and n.

        >>> spread_of([1.0, 2.0, 3.0]).told
        '2.00 (3)'
        """
        low, high = self.median_ci
        interval = f" [{low:.2f}, {high:.2f}]" if math.isfinite(low) else ""
        return f"{self.percentiles[2]:.2f}{interval} ({self.n})" if self.n else "- (0)"


def spread_of(values: Iterable[float]) -> Spread:
    """The spread of any values; the interval is that of order statistics, infinite for fewer than six values."""
    found = np.array(list(values), np.float64)
    if not len(found):
        return Spread(n=0, percentiles=(math.nan,) * len(_PERCENTILES), median_ci=(-math.inf, math.inf))
    low, high = stats.quantile_test(found, q=float(np.median(found)), p=0.5).confidence_interval(0.95)
    infinite = math.isnan(low) or math.isnan(high)
    return Spread(
        n=len(found),
        percentiles=tuple(np.percentile(found, _PERCENTILES).tolist()),
        median_ci=(-math.inf, math.inf) if infinite else (float(low), float(high)),
    )


@dataclass(slots=True)
class StreetFigures:
    """Gathers a street's figures from looks at its actors, `every_s` apart."""

    every_s: float
    _speeds: dict[tuple[ActorKind, str], list[float]] = field(default_factory=dict)  # while they move
    _standing_s: dict[str, float] = field(default_factory=dict)  # of people, so far
    _stops_s: list[float] = field(default_factory=list)
    _density: list[float] = field(default_factory=list)

    def add(self, actors: Sequence[ActorState]) -> None:
        """One look at everybody in the street."""
        people: list[ActorState] = []
        for actor in actors:
            speed_mps = float(np.hypot(*actor.v_W_mps[:2]))
            if speed_mps >= MOVES_MPS:
                self._speeds.setdefault((actor.kind, actor.id), []).append(speed_mps)
            if actor.is_person:
                people.append(actor)
                self._stand(actor.id, speed_mps < MOVES_MPS)
        if people:
            places_W_m = np.array([person.p_W_m[:2] for person in people])
            there_m = np.linalg.norm(places_W_m[:, None] - places_W_m[None], axis=2)
            # Without the one who is looked from: nobody alone is a crowd.
            self._density += (((there_m < NEIGHBOUR_M).sum(axis=1) - 1) / (math.pi * NEIGHBOUR_M**2)).tolist()

    def _stand(self, name: str, stands: bool) -> None:
        if stands:
            self._standing_s[name] = self._standing_s.get(name, 0.0) + self.every_s
        elif (for_s := self._standing_s.pop(name, 0.0)) >= STOP_S:
            self._stops_s.append(for_s)  # only those that are over: the others may have begun or end elsewhere

    def values(self) -> dict[str, list[float]]:
        """By the name of the figure: medians of who moves, by kind, stops that have ended, and density of each look."""
        speeds: dict[str, list[float]] = {f"{kind.value}, m/s": [] for kind in ActorKind}
        for (kind, _), mps in self._speeds.items():
            speeds[f"{kind.value}, m/s"].append(float(np.median(mps)))
        return speeds | {"stops of people, s": self._stops_s, "people per square metre": self._density}


def crowd_figures(people: F64, chair_W_m: F64, free_m: F64) -> dict[str, list[float]]:
    """What a crowd does around a chair, by the name of the figure.

    Args:
        people: Place x, y, speed and sidestep of n people in t ticks as (t, n, 4), nan for who is not there.
        chair_W_m: The chair's middle as (t, 2); it drives along x.
        free_m: From the body of who stands before it to the chair as (t, n), nan for who does not.
    """
    place_W_m, mps = people[..., :2], people[..., 2]
    apart_m = np.nan_to_num(np.linalg.norm(place_W_m[:, :, None] - place_W_m[:, None], axis=3), nan=np.inf)
    near_m = np.nan_to_num(np.linalg.norm(place_W_m - chair_W_m[:, None], axis=2), nan=np.inf)
    behind = np.where((near_m < BEHIND_M) & (place_W_m[..., 0] < chair_W_m[:, None, 0]), mps, np.nan)
    met_m = apart_m.min(axis=0)[np.triu_indices(people.shape[1], 1)]
    aside_m = np.abs(np.nan_to_num(people[..., 3])).max(axis=0)  # 0 for who never stepped aside
    figures = {
        "closest approach to the chair, middles, m": near_m.min(axis=0),
        # Two who are put into the street at one place have not met.
        "closest approach of two walkers, middles, m": np.where(met_m > 0.0, met_m, math.nan),
        "speed behind the chair over a walker's free speed": [
            float(np.median(slow[slow >= 0.0])) / free if free > 0.0 and (slow >= 0.0).any() else math.nan
            for slow, free in zip(behind.T, np.nanpercentile(mps, 80, axis=0).tolist(), strict=True)
        ],
        "sidestep, m": np.where(aside_m > 0.0, aside_m, math.nan),
        "gap to the chair of who stands before it, m": np.nan_to_num(free_m, nan=np.inf).min(axis=0),
        "people per square metre within 5 m of the chair": (near_m < NEIGHBOUR_M).sum(1) / (math.pi * NEIGHBOUR_M**2),
    }
    most = {name: PAIR_M if "closest" in name else math.inf for name in figures}
    return {name: [float(v) for v in values if 0.0 <= v < most[name]] for name, values in figures.items()}


@dataclass(slots=True)
class GapsTaken:
    """Gaps of a main street along x through the origin: those that drivers from beside turned in to, or let go by.

    Of each side the first driver alone lets a gap go by: who queues behind has no choice.
    """

    main_m: float = 6.0  # from its middle to where one has turned in
    queue_m: float = 20.0  # and to where who waits may stand
    _east: dict[str, bool] = field(default_factory=dict)  # of the junction, of those on the main street
    _passed_s: list[float] = field(default_factory=list)
    _waits_s: dict[str, float] = field(default_factory=dict)  # since when
    _turned_s: dict[str, float] = field(default_factory=dict)

    def add(self, actors: Sequence[ActorState], now_s: float) -> None:
        """One tick of the motor vehicles around the junction; every other actor is passed over."""
        drivers = [a for a in actors if not a.is_person and a.kind not in (ActorKind.BICYCLE, ActorKind.SCOOTER)]
        first = set[bool]()
        for actor in sorted(drivers, key=lambda actor: abs(float(actor.p_W_m[1]))):
            (x, y), towards = actor.p_W_m[:2].tolist(), -actor.p_W_m[1] * math.sin(actor.yaw_rad)
            if self.main_m < abs(y) < self.queue_m and towards > self.main_m / 2.0:
                if (y > 0.0) not in first and float(np.hypot(*actor.v_W_mps[:2])) < MOVES_MPS:
                    self._waits_s.setdefault(actor.id, now_s)
                first.add(y > 0.0)
            elif abs(y) <= self.main_m and actor.id in self._waits_s:
                self._turned_s.setdefault(actor.id, now_s)
            elif abs(y) <= self.main_m and self._east.setdefault(actor.id, x > 0.0) != (x > 0.0):
                self._east[actor.id] = x > 0.0
                self._passed_s.append(now_s)

    def taken_refused_s(self) -> tuple[list[float], list[float]]:
        """Gaps of the main street, from vehicle to vehicle, in seconds: those turned in to, and those let go by."""
        passed_s, taken, refused = np.array(self._passed_s), [], []
        for name, at_s in self._turned_s.items():
            waited = passed_s[(passed_s > self._waits_s[name]) & (passed_s <= at_s)]
            refused += np.diff(waited).tolist()
            before, after = passed_s[passed_s <= at_s][-1:], passed_s[passed_s > at_s][:1]
            taken += [float(end - begin) for begin, end in zip(before, after, strict=False)]
        return taken, refused


def critical_gap_s(taken_s: Sequence[float], refused_s: Sequence[float]) -> float:
    """Raff's critical gap: as many shorter ones are taken as longer ones are refused; nan where there are none.

    >>> critical_gap_s([5.0, 7.0, 8.0], [2.0, 3.0, 6.0])
    6.0
    """
    gaps_s = np.unique([*taken_s, *refused_s])
    if not (len(taken_s) and len(refused_s)):
        return math.nan
    taken = np.searchsorted(np.sort(taken_s), gaps_s, "left") / len(taken_s)
    longer = 1.0 - np.searchsorted(np.sort(refused_s), gaps_s, "right") / len(refused_s)
    return float(gaps_s[np.argmin(np.abs(taken - longer))])
