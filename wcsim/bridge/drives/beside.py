"""Who sits beside a person that drives: a simulated user, who says where the way goes and when it is at its end.

The world asks its seat's user about the way, whoever drives. So a person's drive is the same again only with the same
user beside: another one would arrive elsewhere, and press other buttons.
"""

from __future__ import annotations

from wcsim.log.records import DriveTick
from wcsim.users.recorded import RecordedUser
from wcsim.users.user import SimulatedUser


def let_wait(user: SimulatedUser | RecordedUser, *, patient: bool) -> None:
    """A person has all the time in the world; a simulated user who drives gives up as its profile says."""
    if isinstance(user, SimulatedUser):
        user.patient = patient


def by_person(tick: DriveTick) -> bool:
    """Whether a person drove in a tick: what a simulated user wants is always known."""
    return tick.intent is None
