"""The view model of a drive: what its page shows of the session, of its state, and of events."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from wcsim.agents.evaluation.suite.list_file import open_suite, shipped
from wcsim.core.frames import deg
from wcsim.drive import messages as m
from wcsim.drive.driven import DriveEvent, DrivenTick, EventKind
from wcsim.drive.session import ELSEWHERE, DriveSession
from wcsim.towns.scenario.town import list_towns
from wcsim.types import Joystick
from wcsim.users.profiles import profile_names

_NOTICES: Final = {
    EventKind.ARRIVED: ("good", "Arrived. A new destination is set."),
    EventKind.GAVE_UP: ("note", "The simulated user gave up this route. A new destination is set."),
    EventKind.HELP_END: ("note", "Help is over. The assistance is as before."),
    EventKind.STEP_LIMIT: ("note", "This episode has reached its time limit. It starts again."),
}


class _Clock(Protocol):
    """The clock of a drive."""

    @property
    def paused(self) -> bool:
        """Whether it was stopped."""

    @property
    def pace(self) -> float:
        """Times real time."""

    @property
    def waiting(self) -> str:
        """Why it stands still."""

    @property
    def must_rest(self) -> bool:
        """Whether the stick has to be let go of before it counts."""

    tick_s: float
    picture_s: float
    gap_s: float


def drive_about(session: DriveSession) -> m.About:
    """What is driven, and what else could be."""
    suites = {
        name: [(f"{block.part}, {block.town}", len(block.episodes)) for block in open_suite(name).file.blocks]
        for name in shipped()
    }
    assistance = session.assistance
    return m.About(
        place=session.place.told,
        town=session.place.town.name,
        seed=session.place.start.seed,
        policy=assistance.name,
        profile=session.profile,
        points=[(x, y) for x, y in session.actions.points.tolist()],
        towns=[town.name for town in list_towns()],
        profiles=list(profile_names()),
        suites=suites,
        levels=assistance.levels,
        own_level=assistance.own_level,
        tells_unsafe=assistance.tells_unsafe,
        tick_s=session.tick_s,
    )


def drive_state(clock: _Clock, session: DriveSession, last: DrivenTick | None) -> m.DriveState:
    """The drive as it is; `last` is its newest tick, None at the beginning of an episode."""
    rest = Joystick(0.0, 0.0)
    return m.DriveState(
        tick=session.ticks,
        time_s=round(session.time_s, 3),
        step=session.metrics.steps,
        driver=session.driver,
        paused=clock.paused,
        waiting=clock.waiting,
        let_go=clock.must_rest,
        alone=not session.handed_over,
        pace=clock.pace,
        stick=_xy(last.stick if last else rest),
        chosen=_xy(last.chosen if last else rest),
        commanded=_xy(last.commanded if last else rest),
        unsafe=list(last.unsafe) if last else [],
        assisted=session.assistance.on,
        level=session.assistance.level,
        help_s=round(session.help_left_s, 3),
        warning=last is not None and last.warning,
        intervening=last is not None and last.intervening,
        overruled=last is not None and last.overruled,
        on_road=session.client.events.on_carriageway,
        speed_mps=round(last.speed_mps, 3) if last else 0.0,
        left_m=round(session.left_m, 1),
        bearing_deg=round(deg(session.bearing_rad)),
        crash=session.crash,
        profile=session.profile,
        kpis=_kpis(session),
        tick_ms=round(1000.0 * clock.tick_s, 2),
        pictures_ms=round(1000.0 * clock.picture_s, 2),
        rate=round(1.0 / clock.gap_s, 1) if clock.gap_s > 0.0 else 0.0,
    )


def _kpis(session: DriveSession) -> m.Kpis:
    metrics = session.metrics
    return m.Kpis(
        kpi1=None if metrics.kpi1 is None else round(metrics.kpi1, 4),
        kpi2=round(metrics.kpi2, 1),
        way_m=round(metrics.way_m, 1),
        time_s=round(session.time_s, 1),
        crashes=metrics.crashes,
        arrivals=metrics.arrivals,
        given_up=metrics.given_up,
        helps=metrics.helps,
        overrules=metrics.overrules,
        warnings=metrics.warnings,
        interventions=metrics.interventions,
    )


def _xy(stick: Joystick) -> tuple[float, float]:
    return round(stick.x, 3), round(stick.y, 3)


class PageNotifier:
    """Sends events to the page.

    Args:
        say: Sends a notice to the page.
    """

    def __init__(self, say: Callable[[m.Notice], None]) -> None:
        self._say = say

    def tick(self, driven: DrivenTick) -> None:
        """The state says it."""

    def event(self, event: DriveEvent) -> None:
        """Those that a person wants to hear of; a crash is in the state."""
        if event.told == ELSEWHERE:
            self._say(m.Notice(kind="note", told="No place before the crash is free. You start somewhere else."))
        elif event.kind in _NOTICES:
            kind, told = _NOTICES[event.kind]
            self._say(m.Notice(kind=kind, told=told))
        elif event.kind is EventKind.HELP:
            self._say(m.Notice(kind="note", told=event.told))
        elif event.kind is EventKind.POLICY_FAILED:
            self._say(m.Notice(kind="bad", told=f"The assistance failed and is off: {event.told}"))

    def close(self) -> None:
        """Nothing is held."""
