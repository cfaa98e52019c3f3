"""A recorded hand as the fit takes it: samples some 30 ms apart, and the intents behind them.

Keys and switches know few positions, and show nothing of how a hand moves between them.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from wcsim.core.reading import escape
from wcsim.errors import ConfigError
from wcsim.log.drive import DriveRecording
from wcsim.log.records import DriveTick
from wcsim.types import F64, Bool
from wcsim.users.hand import STICK_FILTER_S, SWITCH_POSITIONS

# Of the stick's travel.
SAME_STICK: Final = 1e-4  # sticks no farther apart are the same
MOVES: Final = 0.05  # less is rest
_AT_GATE: Final = 1.0 - 1e-5  # from here on the gate may have stopped the stick
_MOST_POSITIONS: Final = 24  # eight directions of keys, and those at half way
# Keys repeat each position so many times on the mean. A hand seldom returns to the same place.
_REPEATED: Final = 4
_FINE_STEPS: Final = 24  # of a tick, at least, in which an intent is followed to the hand
_APART_S: Final = 0.034  # between two samples that are fitted
_FINE_S: Final = 0.01  # samples no farther apart show what the joystick's low-pass took off
SHORTEST_S: Final = 5.0  # of an episode that is fitted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandTimeSeries:
    """A hand over one episode of N ticks."""

    tick_s: float
    steps: int  # of a tick, in which an intent is followed
    intents: F64  # (N, 2) intent during each tick
    at: np.typing.NDArray[np.intp]  # (n,) the steps after which the samples were taken
    hand: F64  # (n, 2) samples, before the joystick's low-pass where that can be undone
    stick: F64  # (n, 2) the same as recorded
    filter_s: float  # the part of the low-pass that is still in the samples
    start_s: float  # of the episode

    @property
    def apart_s(self) -> float:
        """Seconds between two samples."""
        return self.tick_s / self.steps * float(self.at[1] - self.at[0])

    @property
    def free(self) -> Bool:
        """(n,) which samples the gate did not stop."""
        found: Bool = np.hypot(self.stick[:, 0], self.stick[:, 1]) < _AT_GATE
        return found

    @property
    def time_s(self) -> F64:
        """(n,) when they were taken."""
        return np.asarray(self.start_s + self.tick_s / self.steps * (self.at + 1), np.float64)


def hand_series_from_drives(drives: Iterable[DriveRecording]) -> tuple[HandTimeSeries, ...]:
    """The episodes of drives with intents, one after the other; short ones are left out."""
    found, start_s = [], 0.0
    for drive in drives:
        for ticks in drive.episodes:
            if len(ticks) * drive.header.tick_s >= SHORTEST_S:
                found.append(_series(ticks, drive.header.tick_s, start_s))
            start_s += len(ticks) * drive.header.tick_s
    return tuple(found)


def require_analogue_stick(name: str, ticks: Sequence[DriveTick]) -> None:
    """Refuse a drive by keys, or by the switches of a drive's page: no hand can be fitted to it.

    The four switches of the user model are none of these: a user that drove with them is fitted by
    what they do.

    Raises:
        ConfigError: With the number of positions.
    """
    sticks = np.array([(tick.stick.x, tick.stick.y) for tick in ticks]).reshape(-1, 2)
    moving = sticks[np.hypot(sticks[:, 0], sticks[:, 1]) > MOVES]
    if not len(moving) or mask_switch_positions(moving).all():
        return
    count = len(np.unique(moving.round(4), axis=0))
    if count <= _MOST_POSITIONS and len(moving) >= _REPEATED * count:
        raise ConfigError(
            f"{escape(name)}: its stick took only {count} position{'s' * (count > 1)}, "
            "as with keys or switches, which do not show delay, gain and tremor; "
            "expected a drive by gamepad, pointer or finger: leave this one out"
        )


def mask_switch_positions(sticks: F64) -> Bool:
    """(N,) which sticks (N, 2) are positions of the user model's four switches."""
    away = np.abs(sticks[:, None, :] - np.array(SWITCH_POSITIONS)[None]).max(axis=2).min(axis=1)
    found: Bool = away < SAME_STICK
    return found


def find_mean_correction_interval_s(intents: F64, tick_s: float) -> float | None:
    """Mean time between changes of an intent (N, 2) without stretches at rest; None without any."""
    changed = np.flatnonzero((np.diff(intents, axis=0) != 0.0).any(axis=1))
    gaps = np.array(
        [b - a for a, b in pairwise(changed.tolist()) if (intents[a + 1 : b + 1] != 0.0).any()]
    )
    return float(gaps.mean()) * tick_s if len(gaps) else None


def find_true_spans(flags: Bool) -> Sequence[tuple[int, int]]:
    """(start, stop) of each run of true flags.

    >>> find_true_spans(np.array([False, True, True, False, True]))
    [(1, 3), (4, 5)]
    """
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False].astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _series(ticks: Sequence[DriveTick], tick_s: float, start_s: float) -> HandTimeSeries:
    """The samples of one episode, thinned; where a tick has none, the stick at its start."""
    intents = np.array(
        [(0.0, 0.0) if tick.intent is None else (tick.intent.x, tick.intent.y) for tick in ticks]
    )
    samples = min(len(tick.sticks) for tick in ticks)
    if samples:
        sticks = np.concatenate([tick.sticks[-samples:] for tick in ticks])
    else:
        # The stick at the start of each tick is that at the end of the one before.
        samples, intents = 1, intents[:-1]
        sticks = np.array([(tick.stick.x, tick.stick.y) for tick in ticks[1:]])
    apart_s = tick_s / samples
    hand, filter_s = sticks, STICK_FILTER_S
    if apart_s <= _FINE_S:
        before = np.concatenate([[(ticks[0].stick.x, ticks[0].stick.y)], sticks[:-1]])
        decay = math.exp(-apart_s / STICK_FILTER_S)
        hand, filter_s = (sticks - decay * before) / (1.0 - decay), 0.0
    thin = max(1, round(_APART_S / apart_s))
    per_sample = math.ceil(_FINE_STEPS / samples)
    chosen = np.arange(thin - 1, len(sticks), thin)
    return HandTimeSeries(
        tick_s=tick_s,
        steps=samples * per_sample,
        intents=intents,
        at=(chosen + 1) * per_sample - 1,
        hand=np.ascontiguousarray(hand[chosen]),
        stick=sticks[chosen],
        filter_s=filter_s,
        start_s=start_s,
    )
