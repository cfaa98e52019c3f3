"""Whether a stick was one: keys and switches know few positions, and say nothing of how a hand moves between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wcsim.core.reading import shown
from wcsim.errors import ConfigError
from wcsim.types import F64, Bool
from wcsim.users.hand import SWITCH_POSITIONS
from wcsim.users.recording.drive_types import RecordedTick

_SAME = 1e-4  # of the stick's travel
MOVES = 0.05  # of the stick's travel: less is rest
_MOST = 24  # positions: eight directions of keys, and those at half way
_REPEATED = 4  # times that each of them comes on the mean; so seldom does a hand come back to the same place


def at_switches(sticks: F64) -> Bool:
    """(N,) which sticks (N, 2) are positions that the user model's four switches stand for."""
    away = np.abs(sticks[:, None, :] - np.array(SWITCH_POSITIONS)[None]).max(axis=2).min(axis=1)
    found: Bool = away < _SAME
    return found


def check_stick(name: str, ticks: Sequence[RecordedTick]) -> None:
    """Raise ConfigError for a drive by keys, or by the switches of the page of a drive, of which no hand can be fitted.

    The four switches of the user model are none of these: who drove with them is fitted by what they do.
    """
    sticks = np.array([(tick.stick.x, tick.stick.y) for tick in ticks]).reshape(-1, 2)
    moving = sticks[np.hypot(sticks[:, 0], sticks[:, 1]) > MOVES]
    if not len(moving) or at_switches(moving).all():
        return
    count = len(np.unique(moving.round(4), axis=0))
    if count <= _MOST and len(moving) >= _REPEATED * count:
        raise ConfigError(
            f"{shown(name)}: its stick took only {count} position{'s' * (count > 1)}, as with keys or switches, which "
            "do not show delay, gain and tremor; expected a drive by gamepad, pointer or finger: leave this one out"
        )
