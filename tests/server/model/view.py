"""What one client's driver has seen, and whether it may be shown what it is shown next."""

from dataclasses import dataclass

from tests.server.model.scope import Violation
from wcsim.errors import WcsimError
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, ClientPhase, Outcome, ReceivedFrame

Last = tuple[int, int, int, int]  # epoch, tick, life, chair

CUTS = ("SeatTakenError", "WorldFullError")


@dataclass(frozen=True, slots=True)
class View:
    """The last frame of a driver, None where it expects a first one."""

    last: Last | None = None


NOTHING_SEEN = View()


def hear(view: View, before: ClientCore, after: ClientCore, outcomes: tuple[Outcome, ...], given_up: bool) -> View:
    """What the driver has seen after these outcomes. Raises Violation for what must not be.

    That it was evicted may be said only where some are given up that live.
    """
    seen = next((x for x in outcomes if isinstance(x, ReceivedFrame)), None)
    errors = [type(x).__name__ for x in outcomes if isinstance(x, WcsimError)]
    told_restart = "WorldRestartedError" in errors
    asked_rebuild = isinstance(before.pending, m.Rebuild)
    for x in outcomes:
        if isinstance(x, WcsimError):
            _may_fail(x, asked_rebuild, before.request.seat, given_up)
    if seen is None:
        if told_restart:
            raise Violation("told of a new epoch without its first frame")
        return NOTHING_SEEN if after.phase is ClientPhase.OFF else view
    now = (seen.epoch, after.tick, after.life, seen.slot)
    if seen.stepped != (view.last is not None and _goes_on(view.last, now) and seen.tick > view.last[1]):
        raise Violation(f"frame {now} after {view.last} says of itself: stepped {seen.stepped}")
    if view.last is None or asked_rebuild:
        if told_restart:
            raise Violation(f"told of a restart with the first frame {now}")
    elif _goes_on(view.last, now):
        if told_restart:
            raise Violation(f"told of a restart, but frame {now} follows {view.last}")
    elif not told_restart:
        raise Violation(f"frame {now} after {view.last}, and no word of a cut")
    return View(now)


def _goes_on(last: Last, now: Last) -> bool:
    epoch, tick, life, chair = last
    return now in ((epoch, tick + 1, 0, chair), (epoch, tick, life + 1, chair))


def _may_fail(error: WcsimError, asked_rebuild: bool, seat: int, given_up: bool) -> None:
    name = type(error).__name__
    if name == "SeatTakenError" and seat == m.ANY_SEAT:
        raise Violation(f"the driver wanted any seat and gets {name}: {error}")
    if name in CUTS or name == "WorldRestartedError" or (name == "NotMasterError" and asked_rebuild):
        return
    if name == "EvictedError" and given_up:
        return
    raise Violation(f"the driver gets {name}: {error}")
