"""The joystick positions that an agent can choose: a lattice of step 0.25 (x right, y forward).

`square81` is the paper's grid. `disc69` has the lattice cells that meet the unit disc, which is all
that a joystick in a round gate can reach. The 49 lattice points inside the disc would not do: more
than a third of the directions of a full push would have no point within 0.1768, the largest
distance that still earns the reward for following.
"""

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from wcsim.core.reading import escape_repr
from wcsim.errors import BadActionError, ConfigError
from wcsim.types import F32, F64, I64

NAMES: Final = ("square81", "disc69")
# The largest distance within a round gate; a corner of the square counts as this far.
MAX_DISTANCE: Final = 2.0
_STEP: Final = 0.25
_HALF_CELLS: Final = 4  # the lattice runs from -4 to 4 steps on both axes
_DISC_LIMIT: Final = 20  # i * i + j * j <= 20: the cells that the unit disc (16) reaches into


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionSet:
    """A discrete set of joystick positions; an action is an index into `points`."""

    name: str
    points: F64  # (A, 2) x, y in [-1, 1]
    mirror: I64  # (A,) index of the same position with x -> -x

    def __len__(self) -> int:
        return len(self.points)

    def index(self, action: object) -> int:
        """The index of an action in the set: an integer, or an array of one; 1.0 is none.

        Raises BadActionError when it is no integer, or not in the set.
        """
        is_one = isinstance(action, np.ndarray) and action.size == 1
        try:
            index = operator.index(action.item() if is_one else action)  # type: ignore
        except TypeError:
            index = -1
        most = len(self) - 1
        if not 0 <= index <= most:
            raise BadActionError(
                f"action {escape_repr(action)} is not in the action set; expected an integer "
                f"from 0 to {most}"
            )
        return index

    def nearest(self, joystick_xy: Sequence[float] | F32 | F64) -> int:
        """The action nearest to a joystick position (2,); ties go to the lower index."""
        return int(self.nearest_many(np.asarray(joystick_xy, np.float64)[None])[0])

    def nearest_many(self, joysticks_xy: F32 | F64) -> I64:
        """The nearest actions to many positions, (N, 2) -> (N,)."""
        return np.asarray(self._squared(joysticks_xy).argmin(axis=1), np.int64)

    def distance(self, action: int, joystick_xy: Sequence[float] | F32 | F64) -> float:
        """Distance of an action's position to a joystick position, at most 2 (Table 1)."""
        dx, dy = self.points[action] - np.asarray(joystick_xy, np.float64)
        return min(float(np.hypot(dx, dy)), MAX_DISTANCE)

    def distances(self, joysticks_xy: F32 | F64) -> F64:
        """Distances of every action to every position, (N, 2) -> (N, A) in 0..2."""
        return np.minimum(np.sqrt(self._squared(joysticks_xy)), MAX_DISTANCE)

    def _squared(self, joysticks_xy: F32 | F64) -> F64:
        # Axis by axis: a sum over so short an axis takes several times as long.
        gap_x, gap_y = np.asarray(joysticks_xy, np.float64).T[:, :, None] - self.points.T[:, None]
        return np.asarray(gap_x * gap_x + gap_y * gap_y, np.float64)


def action_set(name: str) -> ActionSet:
    """The action set of that name. Raises ConfigError for an unknown one.

    >>> len(action_set("square81")), len(action_set("disc69"))
    (81, 69)
    """
    if name not in NAMES:
        hint = ""
        if name == "stick":
            hint = ": env.actions=stick is for environments, what chooses from a list needs one"
        raise ConfigError(f"unknown action set {name!r}; expected one of: {', '.join(NAMES)}{hint}")
    steps = np.arange(-_HALF_CELLS, _HALF_CELLS + 1)
    # Policies are saved with indices into this list, so its order may never change.
    cells = np.array([(i, j) for i in steps for j in steps])
    if name == "disc69":
        cells = cells[(cells**2).sum(axis=1) <= _DISC_LIMIT]
    index = {(int(i), int(j)): k for k, (i, j) in enumerate(cells)}
    mirror = np.array([index[-int(i), int(j)] for i, j in cells], np.int64)
    return ActionSet(name=name, points=cells * _STEP, mirror=mirror)
