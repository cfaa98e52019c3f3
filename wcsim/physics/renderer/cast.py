"""What moves in the street at one moment, as rows of instances that the cameras of all seats share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wcsim.physics.renderer.instances import ChairPose, Instances, actor_instances, chair_instances, joined
from wcsim.physics.renderer.signal_lamps import SignalLamps
from wcsim.types import F64, ActorState, Bool, SignalHead, SignalState, chair_actor_id


class Cast:
    """Makes the rows: the actors, the wheelchairs, the lamps that shine; and says which of them a seat sees."""

    def __init__(self, heads: Sequence[SignalHead]) -> None:
        """`heads` of the traffic lights."""
        self._lamps = SignalLamps(heads)
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
            The rows, n of them, and (m, n) which of them each seat sees: its own wheelchair it never does.
        """
        moving = self._read(actors)
        lamps, shining = self._lamps.near(eyes_W_m, range_m, signals)
        shown = np.ones((len(seats), len(moving) + len(chairs) + len(lamps)), np.bool_)
        for column, chair in enumerate(chairs, len(moving)):
            if chair.seat in seats:
                shown[seats.index(chair.seat), column] = False
        shown[:, len(moving) + len(chairs) :] = shining
        return joined(moving, chair_instances(chairs), lamps), shown

    def _read(self, actors: Sequence[ActorState]) -> Instances:
        if not isinstance(actors, tuple):  # a list may have changed since
            return actor_instances(actors)
        if actors is not self._actors:
            self._actors, self._rows = actors, actor_instances(actors)
        return self._rows


def names(actors: Sequence[ActorState], chairs: Sequence[ChairPose]) -> list[str]:
    """Who is who in the first rows."""
    return [actor.whole_id for actor in actors] + [chair_actor_id(chair.seat) for chair in chairs]
