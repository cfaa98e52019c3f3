"""Whether somebody holds the stick: after half a second without a message the chair must stand.

Pure except for its memory; times are those of a monotonic clock.
"""

import math
from typing import Final

from wcsim.drive.session import Wish
from wcsim.types import Joystick
from wcsim.types.chair import AT_REST

LOST_S: Final = 0.5  # without a message: the stick no longer counts
GONE_S: Final = 1.5  # without one: the stick has to be released before it counts again
STANDS_STILL_S: Final = 3.0  # without one: time stops too, as the chair has stopped by now
_RESTS: Final = 0.1  # a stick within this is at rest


def rests(x: float, y: float) -> bool:
    """Whether a stick has been released."""
    return math.hypot(x, y) < _RESTS


class StickWatch:
    """The stick of the person who drives, as far as it can be trusted.

    After a long loss, and at the beginning of each episode, it counts only once it was at rest: so
    nobody drives off with a stick that was still pushed.
    """

    def __init__(self) -> None:
        self._stick, self._overrule = AT_REST, False
        self.must_rest = True  # the stick does not count before it has been at rest
        self._pressed = False  # the button that overrules, since the last wish
        # Times of the newest message, and of the newest one of a page that nobody has left.
        self._heard_s = self._here_s = -math.inf

    def hear(self, stick: Joystick, overrule: bool, now_s: float, *, away: bool = False) -> None:
        """A message has come.

        After a long loss the stick must rest first: nobody may have watched it meanwhile.

        Args:
            stick: Where it is.
            overrule: The button is pressed.
            now_s: Time of the clock.
            away: The page is hidden, or has lost the focus.
        """
        self.must_rest = self.must_rest or now_s - self._heard_s > GONE_S
        self._stick, self._overrule, self._heard_s = stick, overrule, now_s
        self._pressed = self._pressed or overrule
        self._here_s = self._here_s if away else now_s
        if rests(stick.x, stick.y):
            self.must_rest = False

    def let_go(self) -> None:
        """The page is gone: stick and button are at rest from now on."""
        self._stick, self._overrule = AT_REST, False
        self._heard_s = self._here_s = -math.inf
        self.require_rest()

    def require_rest(self) -> None:
        """Another episode begins."""
        self.must_rest = True
        self.forget_press()

    def forget_press(self) -> None:
        """Time goes on: a press of the button while time stood overrules nothing."""
        self._pressed = False

    def lost(self, now_s: float) -> bool:
        """Whether no message came for so long that the stick no longer counts."""
        return now_s - self._heard_s > LOST_S

    def silent(self, now_s: float) -> bool:
        """Whether no message came for so long that time stops where a person drives."""
        return now_s - self._heard_s > STANDS_STILL_S

    def stands_still(self, now_s: float, *, by_person: bool = False) -> bool:
        """Whether time stops.

        Where a person drives, it stops some time after the last message of a page that nobody has
        left. A simulated user drives on while there is a page: browsers let a page that is hidden
        for long send only once a minute.
        """
        return now_s - self._here_s > STANDS_STILL_S if by_person else math.isinf(self._heard_s)

    def wish(self, now_s: float) -> Wish:
        """What the person wants in this tick; a press since the tick before counts for one tick."""
        pressed, self._pressed = self._pressed, False
        if self.lost(now_s):
            self.must_rest = self.must_rest or now_s - self._heard_s > GONE_S
            return Wish()
        stick = AT_REST if self.must_rest else self._stick
        return Wish(stick=stick, overrule=self._overrule or pressed)
