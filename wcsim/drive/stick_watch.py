"""Whether somebody holds the stick: without a message for half a second the chair is told to stand.

Pure but for what it remembers; times are a monotonic clock's.
"""

import math
from typing import Final

from wcsim.drive.session import Wish
from wcsim.types import Joystick
from wcsim.types.chair import AT_REST

LOST_S: Final = 0.5  # without a message the stick counts no more
GONE_S: Final = 1.5  # without one it has to be let go of before it counts again
STANDS_STILL_S: Final = 3.0  # then time stops too: by now the chair has
_RESTS: Final = 0.1  # a stick within this is at rest


def rests(x: float, y: float) -> bool:
    """Whether a stick has been let go of."""
    return math.hypot(x, y) < _RESTS


class StickWatch:
    """The stick of the person who drives, as far as it can be trusted.

    After a long loss, and at the beginning of each episode, it counts only once it has been at rest: nobody drives off
    with a stick that was still pushed.
    """

    def __init__(self) -> None:
        self._stick, self._overrule = AT_REST, False
        self.must_rest = True  # the stick does not count before it has been at rest
        self._pressed = False  # the button that overrules, since the last wish
        self._heard_s = self._here_s = -math.inf  # the newest message, and the newest of a page that nobody has left

    def hear(self, stick: Joystick, overrule: bool, now_s: float, *, away: bool = False) -> None:
        """A message has come; after a long loss nobody may have looked at the stick meanwhile.

        Args:
            stick: Where it is.
            overrule: The button is pressed.
            now_s: Of the clock.
            away: The page is hidden, or has lost the focus.
        """
        self.must_rest = self.must_rest or now_s - self._heard_s > GONE_S
        self._stick, self._overrule, self._heard_s = stick, overrule, now_s
        self._pressed = self._pressed or overrule
        self._here_s = self._here_s if away else now_s
        if rests(stick.x, stick.y):
            self.must_rest = False

    def let_go(self) -> None:
        """The page is gone: the stick is at rest from now on, and so is the button."""
        self._stick, self._overrule = AT_REST, False
        self._heard_s = self._here_s = -math.inf
        self.require_rest()

    def require_rest(self) -> None:
        """Another episode begins."""
        self.must_rest = True
        self.forget_press()

    def forget_press(self) -> None:
        """Time goes on: a button that was pressed, and released, while it stood overrules nothing."""
        self._pressed = False

    def lost(self, now_s: float) -> bool:
        """Whether no message came for so long that the stick counts no more."""
        return now_s - self._heard_s > LOST_S

    def silent(self, now_s: float) -> bool:
        """Whether no message came for so long that time stops where a person drives."""
        return now_s - self._heard_s > STANDS_STILL_S

    def stands_still(self, now_s: float, *, by_person: bool = False) -> bool:
        """Whether time stops.

        Where a person drives, it does so long after the last message of a page that nobody has left. A simulated user
        drives on while there is a page: browsers let one that is long hidden speak once a minute.
        """
        return now_s - self._here_s > STANDS_STILL_S if by_person else math.isinf(self._heard_s)

    def wish(self, now_s: float) -> Wish:
        """What the person wants in this tick; a button that was pressed since the one before counts for a tick."""
        pressed, self._pressed = self._pressed, False
        if self.lost(now_s):
            self.must_rest = self.must_rest or now_s - self._heard_s > GONE_S
            return Wish()
        return Wish(stick=AT_REST if self.must_rest else self._stick, overrule=self._overrule or pressed)
