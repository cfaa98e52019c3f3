"""How fast somebody likes to drive, how often they look elsewhere or correct; intervals by drawing stretches anew."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wcsim.config import RunConfig, parse_json
from wcsim.core import seeding
from wcsim.types import F64, Bool
from wcsim.users.fitting.habits import correction_s, stretches
from wcsim.users.fitting.hand_likelihood import BLOCK_S
from wcsim.users.fitting.hand_series import HandSeries
from wcsim.users.perception import LONGEST_AWAY, UNCUT_AWAY
from wcsim.users.recording.drive_types import DriveRecording

_RESAMPLED, _SD = 400, 1.96
_USUAL_SPEED = 0.9  # quantile
_SMOOTH_S = 1.0
_LOOK_S = 0.5  # an intent that stands still for less may do so by chance
_RARE_SHARE = 0.05  # of looks elsewhere that are none
_ON_ITS_WAY = 2.0  # ticks: corrections as near to each other are no single ones


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedNumber:
    """A number of a user, and its interval of 95 %."""

    value: float
    low: float
    high: float


def usual_speed(
    drives: Sequence[DriveRecording], series: Sequence[HandSeries], found: Mapping[str, FittedNumber], wanted: bool
) -> FittedNumber:
    """The usual speed as a share of the chair's: what the stick, without this hand's gain and bias, asks for at most.

    Args:
        drives: Of one chair.
        series: Their episodes.
        found: The hand, as far as it was fitted.
        wanted: Whether the intents are what was wanted; else the stick is asked, averaged over a second.
    """
    chair = parse_json(RunConfig, drives[0].header.config, "the configuration in the drive").chair
    gain = found["gain_y"].value if "gain_y" in found else 1.0
    bias = found["bias_y"].value if "bias_y" in found else 0.0
    rows = [item.intents[:, 1] if wanted else (_smooth(item) - bias) / max(gain, 0.05) for item in series]

    def share(parts: F64) -> float:
        pushed = float(np.quantile(parts[:, 0], _USUAL_SPEED))
        if "correct_every_s" in found:  # who misses the size of corrections asks for more and less than is liked
            pushed = float(np.median(parts[parts[:, 0] > 0.5 * pushed, 0], axis=0)) if pushed > 0.0 else 0.0
        out = max(0.0, pushed - chair.deadband) / (1.0 - chair.deadband)
        return float(min(1.0, max(0.05, out**chair.shape_exponent)))

    return _resampled([part[:, None] for part in rows], series, share)


def looks(series: Sequence[HandSeries]) -> dict[str, FittedNumber]:
    """Looks elsewhere, or single corrections, by how intents stand still."""
    tick_s = series[0].tick_s
    gaps = [correction_s(item.intents, tick_s) for item in series]
    known = [gap for gap in gaps if gap is not None]
    changes = np.concatenate([(np.diff(item.intents, axis=0) != 0.0).any(axis=1) for item in series])
    if known and float(changes.mean()) < 1.0 / _ON_ITS_WAY:
        # between two corrections an intent stands still as in a look elsewhere, which cannot be told then

        def every(parts: F64) -> float:
            return correction_s(parts, tick_s) or float(np.mean(known))

        return {"correct_every_s": _resampled([item.intents for item in series], series, every)}
    rows = [_looked(item) for item in series]
    away = _resampled(rows, series, lambda t: float(t[:, 0].sum() / max(1.0, t[:, 1].sum())))
    if away.value < _RARE_SHARE:
        return {"away_share": replace(away, value=0.0, low=0.0)}
    lasting = _resampled(rows, series, lambda t: _mean_look(tick_s * float(t[:, 0].sum() / max(1.0, t[:, 2].sum()))))
    return {"away_share": away, "away_s": lasting}


def _looked(item: HandSeries) -> F64:
    """(N - 1, 3) of each tick: in a look elsewhere, driven forward, the last one of a look."""
    intents = item.intents
    driven: Bool = intents[1:, 1] > 0.0
    still: Bool = (np.diff(intents[:, 1]) == 0.0) & (np.diff(np.abs(intents[:, 0])) <= 0.0) & driven
    rows = np.zeros((len(still), 3))
    rows[:, 1] = driven
    for start, stop in stretches(still):
        if (stop - start) * item.tick_s >= _LOOK_S - 1e-9:
            rows[start:stop, 0] = 1.0
            rows[stop - 1, 2] = 1.0
    return rows


def _mean_look(seen_s: float) -> float:
    """The mean of all looks, when those of half a second or more last `seen_s` on average."""
    low_s, high_s = 0.1, 30.0
    for _ in range(40):
        mean_s = 0.5 * (low_s + high_s)
        rate_s, most_s = UNCUT_AWAY * mean_s, max(_LOOK_S, LONGEST_AWAY * mean_s)
        lasts_s = _LOOK_S + rate_s * (1.0 - math.exp(-(most_s - _LOOK_S) / rate_s))
        low_s, high_s = (mean_s, high_s) if lasts_s < seen_s else (low_s, mean_s)
    return 0.5 * (low_s + high_s)


def _smooth(item: HandSeries) -> F64:
    width = min(len(item.stick), max(1, round(_SMOOTH_S / item.apart_s)))
    return np.asarray(np.convolve(item.stick[:, 1], np.full(width, 1.0 / width), mode="valid"), np.float64)


def _resampled(rows: Sequence[F64], series: Sequence[HandSeries], value: Callable[[F64], float]) -> FittedNumber:
    """A number of the rows (n, k) of all episodes, and its interval by drawing stretches of 10 s anew."""
    rng = seeding.generator(0, "stretches resampled")
    parts: list[F64] = []
    for table, item in zip(rows, series, strict=True):
        seconds = len(item.intents) * item.tick_s
        parts += np.array_split(table, max(1, round(seconds / BLOCK_S)))
    drawn = [
        value(np.concatenate([parts[k] for k in rng.integers(len(parts), size=len(parts)).tolist()]))
        for _ in range(_RESAMPLED)
    ]
    found, half = value(np.concatenate(list(rows))), _SD * float(np.std(drawn))
    return FittedNumber(value=found, low=max(0.0, found - half), high=found + half)
