"""What moves in the street at one moment, as rows of instances that the cameras of all seats share.

The lamps of traffic lights are among them, lit by the state that SUMO gives. Their heads stand
still and belong to the street's mesh; the lamps change, so they are drawn like actors.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from wcsim.physics.renderer.instances import (
    ChairPose,
    Instances,
    actor_instances,
    chair_instances,
    joined,
)
from wcsim.physics.renderer.models.catalog import (
    LAMP_APART_M,
    LAMP_DEPTH_M,
    LAMP_RADIUS_M,
    Template,
)
from wcsim.types import F64, I32, ActorState, Bool, SignalHead, SignalState, chair_actor_id

AHEAD_M = 0.16  # from the middle of a head to its lamps' backs: heads are 0.3 m deep
_VEHICLE_SIZE_M = (LAMP_DEPTH_M, 2 * LAMP_RADIUS_M, 2 * (LAMP_APART_M + LAMP_RADIUS_M))
_WALKER_SIZE_M = (LAMP_DEPTH_M, 2 * LAMP_RADIUS_M, LAMP_APART_M + 2 * LAMP_RADIUS_M)

# What the characters of SUMO's states light; any other one is off.
_VEHICLE_STATES = {
    Template.SIGNAL_RED: "rs",  # s: a green arrow to the right beside the red
    Template.SIGNAL_RED_AMBER: "u",
    Template.SIGNAL_AMBER: "yYo",  # o: blinks
    Template.SIGNAL_GREEN: "gG",
}
_WALKER_STATES = {Template.WALK_RED: "rsuyY", Template.WALK_GREEN: "gG"}


class Cast:
    """Makes the rows: actors, wheelchairs, lamps that shine; and which of them each seat sees."""

    def __init__(self, heads: Sequence[SignalHead]) -> None:
        """`heads` of the traffic lights."""
        self._lamps = _SignalLamps(heads)
        self._actors: Sequence[ActorState] = ()
        self._rows = actor_instances(())

    def seen(
        self,
        actors: Sequence[ActorState],
        chairs: Sequence[ChairPose],
        signals: Sequence[SignalState],
        seats: Sequence[int],
        eyes_W_m: F64,
        range_m: float,
    ) -> tuple[Instances, Bool]:
        """The rows of now, for some seats.

        Args:
            actors: what moves; a tuple that is given again (the same object) is not read again.
            chairs: the wheelchairs.
            signals: the traffic lights; a head whose light is not among them is dark.
            seats: m seats whose cameras look.
            eyes_W_m: where they are, (m, 3).
            range_m: how far they see.

        Returns:
            The rows, n of them, and (m, n) which of them each seat sees, never its own wheelchair.
        """
        # A list that is given again may have changed.
        if actors is not self._actors or not isinstance(actors, tuple):
            self._actors, self._rows = actors, actor_instances(actors)
        moving = self._rows
        lamps, shining = self._lamps.near(eyes_W_m, range_m, signals)
        shown = np.ones((len(seats), len(moving) + len(chairs) + len(lamps)), np.bool_)
        for column, chair in enumerate(chairs, len(moving)):
            # The cameras sit within the model of their own chair, which would cover the picture.
            if chair.seat in seats:
                shown[seats.index(chair.seat), column] = False
        shown[:, len(moving) + len(chairs) :] = shining
        return joined(moving, chair_instances(chairs), lamps), shown


def names(actors: Sequence[ActorState], chairs: Sequence[ChairPose]) -> list[str]:
    """The ids of the actors and chairs in the first rows."""
    return [actor.whole_id for actor in actors] + [chair_actor_id(chair.seat) for chair in chairs]


class _SignalLamps:
    """The lamps of all heads of a street; only those near a camera become instances."""

    def __init__(self, heads: Sequence[SignalHead]) -> None:
        self._heads = tuple(heads)
        self._p_W_m = np.array([head.p_W_m for head in heads], np.float64).reshape(-1, 3)
        self._yaw_rad = np.array([head.yaw_rad for head in heads], np.float64)
        walker = np.array([head.pedestrian for head in heads], np.bool_)
        self._size_m = np.where(walker[:, None], _WALKER_SIZE_M, _VEHICLE_SIZE_M).reshape(-1, 3)
        self._ahead_W = np.column_stack([np.cos(self._yaw_rad), np.sin(self._yaw_rad)])
        self._foot_W_m = self._p_W_m.copy()
        self._foot_W_m[:, :2] += (AHEAD_M + 0.5 * LAMP_DEPTH_M) * self._ahead_W
        self._foot_W_m[:, 2] -= 0.5 * self._size_m[:, 2]
        self._vehicle_table = _table_of(_VEHICLE_STATES, Template.SIGNAL_OFF)
        self._walker_table = _table_of(_WALKER_STATES, Template.WALK_OFF)
        self._walker = walker
        self._lights: tuple[tuple[str, int], ...] = ()  # id and length of the state of each
        # By head the place of its character in all states, one after another.
        self._place: I32 = np.zeros(0, np.int32)
        self._signals: Sequence[SignalState] = ()
        self._template: I32 = np.full(len(heads), Template.SIGNAL_OFF, np.int32)

    def near(
        self, eyes_W_m: F64, range_m: float, signals: Sequence[SignalState]
    ) -> tuple[Instances, Bool]:
        """The lamps that shine towards any camera, not further than range_m from it.

        Args:
            eyes_W_m: where the cameras are, (m, 3).
            range_m: how far they see.
            signals: the traffic lights of now.

        Returns:
            The lamps, n of them, and (m, n) which of them each camera sees.
        """
        if not self._heads:
            return self._rows(np.zeros(0, np.int64)), np.zeros((len(eyes_W_m), 0), np.bool_)
        if signals is not self._signals:
            self._light(signals)
        gap = eyes_W_m[:, None, :2] - self._p_W_m[:, :2]
        # From behind its head hides a lamp, so only the half space ahead of it counts.
        towards = np.einsum("kij,ij->ki", gap, self._ahead_W) > 0.0
        seen = towards & (np.einsum("kij,kij->ki", gap, gap) < range_m * range_m)
        rows = np.flatnonzero(seen.any(axis=0))
        return self._rows(rows), seen[:, rows]

    def _light(self, signals: Sequence[SignalState]) -> None:
        """Take the template of every head from the states of now."""
        self._signals = signals
        lights = tuple([(signal.tls_id, len(signal.colours)) for signal in signals])
        # States change every few seconds, the set of lights hardly ever: places are looked up only
        # for a new one. A head without a light has the place behind all states.
        if lights != self._lights or len(self._place) != len(self._heads):
            self._lights = lights
            start, end = {}, 0
            for name, count in lights:
                start[name] = (end, count)
                end += count
            places = []
            for head in self._heads:
                first, count = start.get(head.tls_id, (end, 0))
                places.append(first + head.link if 0 <= head.link < count else end)
            self._place = np.array(places, np.int32)
        # One character more, which means off.
        states = "".join([signal.colours for signal in signals]) + "O"
        code = np.frombuffer(states.encode("latin-1"), np.uint8)[self._place]
        self._template = np.where(self._walker, self._walker_table[code], self._vehicle_table[code])

    def _rows(self, chosen: npt.NDArray[np.intp]) -> Instances:
        """The lamps of the heads with these numbers."""
        count = len(chosen)
        return Instances(
            template=np.ascontiguousarray(self._template[chosen], np.int32),
            p_W_m=self._foot_W_m[chosen],
            yaw_rad=self._yaw_rad[chosen],
            pitch_rad=np.zeros(count),
            roll_rad=np.zeros(count),
            scale_m=self._size_m[chosen],
            colour_seed=np.zeros(count, np.uint32),
            lamps=np.zeros(count, np.int32),
        )


def _table_of(states: dict[Template, str], otherwise: Template) -> I32:
    """Template (256,) by the character of SUMO's state."""
    table = np.full(256, otherwise, np.int32)
    for template, characters in states.items():
        table[[ord(character) for character in characters]] = template
    return table
