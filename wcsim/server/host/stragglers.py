"""For whom the others wait: not who is late now, but how much of everybody's waiting each one has caused."""

from __future__ import annotations

from collections.abc import Sequence

from wcsim.server.specs import Held


class Stragglers:
    """Adds up time in which some members had acted and others had not; a moment's late ones share it evenly.

    >>> holdups = Stragglers()
    >>> holdups.saw(2, ("a", "b"), 0.0)  # nobody waits yet
    >>> holdups.saw(2, ("b",), 1.0)  # a has acted
    >>> holdups.saw(2, (), 3.5)  # b too
    >>> holdups.held(("a", "b"))
    (Held(name='a', seconds=0.0), Held(name='b', seconds=2.5))
    """

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._late: Sequence[str] = ()  # for whom somebody has waited since `_seen_s`
        self._seen_s = 0.0

    def saw(self, members: int, late: Sequence[str], now_s: float) -> None:
        """So many members there are from now on, of whom these are late; to be called whenever that has changed."""
        if self._late:
            share_s = (now_s - self._seen_s) / len(self._late)
            for name in self._late:
                self._seconds[name] = self._seconds.get(name, 0.0) + share_s
        self._late = late if len(late) < members else ()
        self._seen_s = now_s

    def held(self, members: Sequence[str]) -> tuple[Held, ...]:
        """Seconds that each of these members was waited for; those of others are forgotten."""
        self._seconds = {name: self._seconds.get(name, 0.0) for name in members}
        return tuple(Held(name=name, seconds=seconds) for name, seconds in self._seconds.items())
