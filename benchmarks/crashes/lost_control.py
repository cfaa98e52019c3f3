"""Lost control: stretches in which a chair does the opposite of what its stick asks for.

The stick is the one that the chair has during a tick, after any delay. At the end of a tick a chair

* turns against it, when the stick asks for a turn and the chair turns to the other side by more than 0.25 rad/s;
* rolls on, when the stick asks for no speed (y = 0, or within the deadband) and the chair drives, forwards or
  backwards, by more than 0.25 m/s.

A run of such ticks, of one kind, is lost control when it lasts 0.7 s or more and at least 0.2 s of it are late: ticks
at which a chair that does as it is configured to would have been below the limit. That chair begins with what the real
one does when the stick begins to ask for this: for the turn with its turn rate, which it changes by the yaw
acceleration; for the rest with its speed and gain of speed, from which it stops by deceleration and jerk, as the
oracle's chair does. So a stop from full speed, which takes longer than 0.7 s, or turning round, are none, unless they
take 0.2 s more than they are configured to. Runs of both kinds that touch or overlap are one stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.joystick import ACCEL, YAW_ACCEL, driven, limits_of, shaped_rows
from wcsim.errors import ConfigError
from wcsim.types import F64, Bool

LASTS_S = 0.7
_OTHER_WAY_RADPS = 0.25
_ROLLS_ON_MPS = 0.25
LATE_S = 0.2  # the motors follow what they are told a little later
_PARTS = 4  # of a tick, in which the normal stop is reckoned


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """One episode of a chair, tick by tick."""

    tick_s: float
    sticks: F64  # (N, 2) x, y that the chair had during each tick
    speed_mps: F64  # (N + 1,) forwards, at the beginning and after each tick
    turn_radps: F64  # (N + 1,) to the left, likewise


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Some ticks of a track during which control was lost."""

    first: int  # tick
    ticks: int
    turned: bool  # against its stick
    rolled: bool  # on, with the stick at rest


def stretches(track: Track, chair: ChairConfig) -> tuple[Stretch, ...]:
    """The stretches of lost control in an episode, in order (see the module's text).

    Raises ConfigError when the arrays of the track do not fit each other.
    """
    count = len(track.sticks)
    if len(track.speed_mps) != count + 1 or len(track.turn_radps) != count + 1:
        raise ConfigError(
            f"a track of {count} sticks has {len(track.speed_mps)} speeds and {len(track.turn_radps)} turn rates; "
            f"expected {count + 1} of each"
        )
    sticks, limits = shaped_rows(track.sticks, chair), limits_of(chair)
    turned = _lost(*_turns_against(track, sticks, limits), track.tick_s)
    rolled = _lost(*_rolls_on(track, sticks, limits), track.tick_s)
    lost = turned | rolled
    return tuple(
        Stretch(first=a, ticks=b - a, turned=bool(turned[a:b].any()), rolled=bool(rolled[a:b].any()))
        for a, b in runs(lost)
    )


def _turns_against(track: Track, shaped_sticks: F64, limits: F64) -> tuple[Bool, Bool]:
    """Ticks (N,) at whose end the chair turns against its stick, and ticks (N,) at which that is late.

    Sticks (N, 2) are those without the deadband, `limits` (7,) those of the drive.
    """
    against, late = (np.zeros(len(shaped_sticks), np.bool_) for _ in range(2))
    before, left_radps = 0.0, 0.0  # what is left of the turn to the other side
    for i, side in enumerate((0.0 - np.sign(shaped_sticks[:, 0])).tolist()):
        left_radps = left_radps if side == before else max(0.0, -side * float(track.turn_radps[i]))
        left_radps = max(0.0, left_radps - float(limits[YAW_ACCEL]) * track.tick_s)
        before = side
        against[i] = -side * float(track.turn_radps[i + 1]) > _OTHER_WAY_RADPS
        late[i] = left_radps <= _OTHER_WAY_RADPS
    return against, late


def _rolls_on(track: Track, shaped_sticks: F64, limits: F64) -> tuple[Bool, Bool]:
    """Ticks (N,) at whose end the chair rolls on though no speed is asked for, and ticks (N,) at which that is late.

    Sticks (N, 2) are those without the deadband, `limits` (7,) those of the drive.
    """
    rolling, late = (np.zeros(len(shaped_sticks), np.bool_) for _ in range(2))
    speed_mps = np.abs(track.speed_mps)
    resting, v, a = False, 0.0, 0.0
    for i, y in enumerate(shaped_sticks[:, 1].tolist()):
        if y != 0.0:
            resting = False
            continue
        if not resting:
            gain_mps2 = float(speed_mps[i] - speed_mps[max(i - 1, 0)]) / track.tick_s
            resting, v, a = True, float(speed_mps[i]), min(max(gain_mps2, 0.0), float(limits[ACCEL]))
        for _ in range(_PARTS):
            v, _, a = driven(v, 0.0, a, 0.0, 0.0, limits, track.tick_s / _PARTS)
        rolling[i] = float(speed_mps[i + 1]) > _ROLLS_ON_MPS
        late[i] = abs(v) <= _ROLLS_ON_MPS
    return rolling, late


def runs(marked: Bool) -> list[tuple[int, int]]:
    """Where runs of True begin, and where they have ended.

    >>> runs(np.array([False, True, True, False, True]))
    [(1, 3), (4, 5)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _lost(marked: Bool, late: Bool, tick_s: float) -> Bool:
    """Only the runs of LASTS_S and more of which LATE_S and more are late."""
    kept = np.zeros_like(marked)
    for a, b in runs(marked):
        late_s = float(np.count_nonzero(late[a:b])) * tick_s
        kept[a:b] = (b - a) * tick_s >= LASTS_S - 1e-6 and late_s >= LATE_S - 1e-6
    return kept
