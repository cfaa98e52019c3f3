"""For whom the others wait: not who is late now, but how much of everybody's waiting each one has caused."""

from __future__ import annotations

from collections.abc import Sequence

from wcsim.server.orders import Held


class HoldUps:
    """Adds up time in which some members had acted and others had not; a moment's late ones share it evenly.

    >>> holdups = HoldUps()
    >>> holdups.saw(("a", "b"), ("a", "b"), 0.0)  # nobody waits yet
    >>> holdups.saw(("a", "b"), ("b",), 1.0)  # a has acted
    >>> holdups.saw(("a", "b"), (), 3.5)  # b too
    >>> holdups.held()
    (Held(name='a', seconds=0.0), Held(name='b', seconds=2.5))
    """

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._late: tuple[str, ...] = ()  # for whom somebody has waited since `_seen_s`
        self._seen_s = 0.0

    def saw(self, members: Sequence[str], late: Sequence[str], now_s: float) -> None:
        """Things are so from now on; to be called whenever they may have changed."""
        for name in self._late:
            self._seconds[name] = self._seconds.get(name, 0.0) + (now_s - self._seen_s) / len(self._late)
        self._late = tuple(late) if len(late) < len(members) else ()
        self._seen_s = now_s
        if [*self._seconds] != [*members]:
            self._seconds = {name: self._seconds.get(name, 0.0) for name in members}

    def held(self) -> tuple[Held, ...]:
        """Seconds that each member was waited for, in the members' order."""
        return tuple(Held(name=name, seconds=seconds) for name, seconds in self._seconds.items())
