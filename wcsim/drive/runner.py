"""The process behind a page: it keeps time, obeys the page, draws for it and drives a session."""

import signal
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from wcsim.agents.opening.list_file import list_shipped_suites, open_suite
from wcsim.config import CameraConfig
from wcsim.core.files import iter_unused_paths
from wcsim.core.frames import rad2deg
from wcsim.core.reading import pluralize
from wcsim.drive import messages as m
from wcsim.drive.driven import DriveRecord, DriverKind, EventKind, xy_of
from wcsim.drive.recording.session_recorder import RecorderStatus, SessionRecorder
from wcsim.drive.recording.study_lead import OpenStudy, StudyHands, StudyLead
from wcsim.drive.recording.study_plan import StepKind
from wcsim.drive.session import ELSEWHERE, DriveSession
from wcsim.drive.starting import DriveStart, check_offered, checked
from wcsim.drive.stick_watch import STANDS_STILL_S, StickWatch
from wcsim.errors import WcsimError
from wcsim.log.records import DriveTick, Note
from wcsim.towns.scenario.town import list_towns
from wcsim.types import Joystick, Street
from wcsim.types.chair import AT_REST
from wcsim.users.profiles import list_profile_names
from wcsim.view.street_pictures import Moment, moment_of
from wcsim.view.street_scene import CameraKind, StreetFeed

# Kinds of messages to the server; `DONE`: a slow message has been done.
JSON, PICTURES, LINE, FILE, DONE = b"J", b"P", b"L", b"F", b"D"
Does = dict[type, Callable[[Any], object]]
"""What is done with each kind of message; the page is told of a WcsimError that it raises."""
_CRASH_S: Final = 3.0  # for which a crash is shown
_IDLE_S: Final = 0.05
_NEWEST: Final = 0.05  # share of the newest in a mean
# Messages that are refused while a study runs.
_STUDY: Final = (m.Assist, m.SetLevel, m.DriveBy, m.Pace, m.NewPlace, m.Again, m.SetUser, m.Open)
# The state before the first tick of an episode.
_RESTS: Final = DriveTick(
    tick=0,
    episode=0,
    time_s=0.0,
    stick=AT_REST,
    commanded=AT_REST,
    chosen=AT_REST,
    p_WB_m=np.zeros(3),
    yaw_rad=0.0,
    speed_mps=0.0,
)
_NOTICES: Final[dict[str, tuple[str, str]]] = {
    EventKind.ARRIVED: ("good", "Arrived. A new destination is set."),
    EventKind.GAVE_UP: ("note", "The simulated user gave up this route. A new destination is set."),
    EventKind.HELP_END: ("note", "Help is over. The assistance is as before."),
    EventKind.STEP_LIMIT: ("note", "This episode has reached its time limit. It starts again."),
}


class PageRunner(ABC):
    """Runs until the pipe to the server ends, or it is told to end.

    Args:
        pipe: To the server.
        clock: Monotonic seconds.
    """

    def __init__(self, pipe: Connection, clock: Callable[[], float] = time.monotonic) -> None:
        self._pipe, self._now_s = pipe, clock
        self._feed: StreetFeed | None = None
        self._streets, self._camera = 0, CameraKind.NOTHING
        self._ready, self._stale = False, True  # the page takes pictures; its pictures are old
        self._over = False
        self._does: Does = {m.SetView: self._view, m.Ready: self._take_ready, m.End: self._end}

    def run(self) -> None:
        """Run until the server ends."""
        with suppress(EOFError, BrokenPipeError, ConnectionResetError):
            try:
                self._begin()
                while not self._over:
                    self._turn()
            finally:
                self.close()

    def run_process(self) -> None:
        """Run as the whole work of a process."""
        signal.signal(signal.SIGTERM, self.leave)
        with self._pipe:
            self.run()

    def leave(self, *_: object) -> None:
        """Handle SIGTERM: leave what takes long at once; an end that has begun goes on."""
        if not self._over:
            self._over = True
            raise SystemExit

    @abstractmethod
    def close(self) -> None:
        """End what is shown."""

    @abstractmethod
    def _begin(self) -> None:
        """Open what is shown first."""

    @abstractmethod
    def _turn(self) -> None:
        """One turn of the loop."""

    @abstractmethod
    def _heard(self) -> None:
        """The page has sent a message that may change what is shown."""

    def _hear(self) -> None:
        """Handle all messages of the page that have come."""
        while self._pipe.poll():
            message = self._pipe.recv()
            # None for a message of the other kind of page.
            does = self._does.get(type(message))
            try:
                if does is not None:
                    does(message)
            except WcsimError as error:
                self._say("notice", kind="refused", told=str(error))
            if message.slow:
                self._pipe.send_bytes(DONE)
            if not isinstance(message, m.Stick | m.Ready | m.End):
                self._stale = True
                self._heard()

    def _open_feed(self, street: Street, front: CameraConfig | None) -> None:
        self._streets += 1
        self._feed = StreetFeed(street, front, self._streets)

    def _draw(self, moment: Moment, feed: StreetFeed) -> None:
        """Send a moment, and before it what a page needs to show it."""
        for name, told in feed.news(moment):
            if isinstance(told, bytes):
                self._pipe.send_bytes(FILE + name.encode() + b"\0" + told)
            else:
                self._say(name, **told)
        self._pipe.send_bytes(PICTURES + feed.picture(moment, self._camera))
        self._ready = self._stale = False

    def _say(self, say: str, **told: object) -> None:
        self._pipe.send_bytes(JSON + m.spoken(say, told))

    def _busy(self, told: str) -> None:
        self._say("busy", told=told, waits=True)

    def _log(self, told: str) -> None:
        self._pipe.send_bytes(LINE + told.encode())

    def _view(self, said: m.SetView) -> None:
        self._camera = said.camera

    def _take_ready(self, _: m.Ready) -> None:
        self._ready = True

    def _end(self, _: m.End) -> None:
        self._over = True


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOrder:
    """What is driven, and whether it is kept."""

    start: DriveStart
    keep: Path | OpenStudy | None = None  # a new file for the first world that is kept, or a study

    word: ClassVar = "drive"  # its name in messages
    page: ClassVar = "index.html"  # its file
    begins: ClassVar = "starting the simulator, then the street; the page shows the progress"
    # Shown by pages when the process has ended.
    over: ClassVar = "The drive has ended. Start wcsim drive again."

    def run(self, pipe: Connection) -> None:
        """What the drive's process does."""
        _DriveRunner(pipe, self.start, self.keep).run_process()


@dataclass(slots=True, kw_only=True)
class _DriveClock:
    """Whether time goes, and how fast; when the next tick is due. Seconds."""

    paused: bool = False  # somebody stopped it
    pace: float = 1.0  # times real time; 0 is as fast as possible
    due_s: float = 0.0
    held_s: float = 0.0  # a crash is shown until then
    opened_s: float = 0.0
    ticked_s: float = 0.0  # 0 before the first tick, and after time stood still
    gap_s: float = 0.0  # between ticks, a mean

    @property
    def next_s(self) -> float:
        """When the next tick is due."""
        return max(self.due_s, self.held_s)

    def opened(self, now_s: float) -> None:
        """A street has been opened, and its first tick is due."""
        self.due_s = self.opened_s = now_s
        self.held_s, self.ticked_s, self.paused = 0.0, 0.0, False

    def ticked(self, now_s: float, tick_s: float) -> None:
        """A tick of `tick_s` in the world has been driven; it began at `now_s`."""
        if self.ticked_s:
            gap_s = now_s - self.ticked_s
            self.gap_s += _NEWEST * (gap_s - self.gap_s) if self.gap_s else gap_s
        self.ticked_s = now_s
        self.due_s = max(self.due_s + (tick_s / self.pace if self.pace else 0.0), now_s)


class _DriveRunner(PageRunner):
    """Runs drives one after another, until the pipe to the server ends.

    Args:
        pipe: To the server.
        start: The first drive.
        keep: File of the first world that is kept, or a study of several drives; None for nothing.
        clock: Monotonic seconds.
    """

    def __init__(
        self,
        pipe: Connection,
        start: DriveStart,
        keep: Path | OpenStudy | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(pipe, clock)
        self._start = start
        self._names = iter_unused_paths(keep) if isinstance(keep, Path) else None
        self._study = keep if isinstance(keep, OpenStudy) else None
        self._lead: StudyLead | None = None
        self.session: DriveSession | None = None
        self._watch, self.clock = StickWatch(), _DriveClock()
        self._told_failure = self._unseen = False
        self._told_waiting = ""
        self._drawn_episode = -1
        does: Does = {
            m.Stick: self._stick,
            m.Help: lambda _: self._open_session().ask_for_help(),
            m.Assist: self._assist,
            m.SetLevel: lambda said: self._open_session().set_level(said.level),
            m.ShapeStick: lambda said: self._open_session().shape_stick(
                said.speed, said.sensitivity
            ),
            m.DriveBy: self._drive_by,
            m.Pace: self._set_pace,
            m.Pause: self._pause,
            m.NewPlace: lambda _: self._begin_anew(self._open_session().new_place),
            m.Again: lambda _: self._begin_anew(
                self._open_session().again, "Restarting the street ..."
            ),
            m.SetUser: self._set_user,
            m.Open: self._open_other,
            m.GoOn: lambda said: self._leads().go_on(said.step),
            m.AnswerAll: lambda said: self._leads().answer(said.step, said.answers),
            m.Gone: lambda _: self._watch.let_go(),
        }
        self._does |= does

    def close(self) -> None:
        """End the drive, and log its place, length, arrivals and crashes."""
        if self.session is not None:
            session, self.session = self.session, None
            metrics = session.metrics
            told = (
                f"{session.place.told}: {session.time_s / 60.0:.1f} min, {session.way_m:.0f} m, "
                f"{pluralize(metrics.arrivals, 'arrival')}, {pluralize(metrics.crashes, 'crash')}"
            )
            session.close()
            with suppress(BrokenPipeError, OSError):
                self._log(told)

    @property
    def waiting(self) -> str:
        """Why time stands still though nobody paused it; "" while it goes."""
        now_s = self._now_s()
        if not self._stands_still(now_s) or now_s - self.clock.opened_s <= STANDS_STILL_S:
            return ""
        if self._watch.silent(now_s):
            return "No page is driving. Time is paused."
        return "The driving page is in the background. Time is paused."

    # --- one turn of the loop ---

    def _turn(self) -> None:
        # Wait only once: the page sends its stick more often, and what follows must not be late.
        self._pipe.poll(self._wait_s())
        self._hear()
        if self._lead is not None:
            self._lead.wait()
        now_s = self._now_s()
        if self._unseen and self._ready:
            # Show the street before its first tick, which may have to compile kernels.
            self._show()
        if not self._goes():
            self.clock.ticked_s = 0.0
        elif now_s >= self.clock.next_s:
            self._tick(now_s)
        if self._ready and self._stale:
            self._show()
        if self.waiting != self._told_waiting:
            self._state()  # also when no tick sends it

    def _goes(self) -> bool:
        if self.session is None or self.clock.paused or self._stands_still(self._now_s()):
            return False
        return self._lead is None or self._lead.drives

    def _stands_still(self, now_s: float) -> bool:
        """Whether time stops as nobody is there; a simulated user drives on for a left page."""
        by_person = self.session is None or self.session.driver is DriverKind.PERSON
        return self._watch.stands_still(now_s, by_person=by_person)

    def _wait_s(self) -> float:
        if self._ready and self._stale and self.session is not None:
            return 0.0
        if not self._goes():
            return _IDLE_S
        return min(_IDLE_S, max(0.0, self.clock.next_s - self._now_s()))

    def _tick(self, now_s: float) -> None:
        session = self._open_session()
        if session.ended:  # the crash has been shown, and another episode begins
            self._watch.forget_press()
        real = session.tick_s / self.clock.gap_s if self.clock.gap_s else 1.0
        session.tick(replace(self._watch.wish(now_s), pace=round(real, 3)))
        self.clock.ticked(now_s, session.tick_s)
        if session.crash:
            self.clock.held_s, self.clock.ticked_s = now_s + _CRASH_S, 0.0
        if session.ended:
            self._watch.require_rest()
        # A failed policy stops time once: a person who then goes on knows of it.
        failed = bool(session.assistance.failed)
        self.clock.paused = self.clock.paused or (failed and not self._told_failure)
        self._told_failure = failed
        self._stale = True
        self._state()
        if self._lead is not None:
            self._lead.driven()

    def _show(self) -> None:
        session, feed = self.session, self._feed
        if session is None or feed is None:
            return
        jumped, self._drawn_episode = session.episode != self._drawn_episode, session.episode
        moment = moment_of(
            session.world, session.client, session.route, session.done_m, jumped=jumped
        )
        self._draw(moment, feed)
        self._unseen = False

    def _note(self, record: DriveRecord) -> None:
        notice = _notice_of(record)
        if notice is not None:
            self._say("notice", kind=notice[0], told=notice[1])

    def _tell_kept(self, news: RecorderStatus) -> None:
        self._say("keeping", on=news.on, file=news.file, told=news.told)
        if news.log:
            self._log(news.log)

    def _state(self) -> None:
        if self.session is not None:
            state = _drive_state(self.session, self.clock, self.waiting, self._watch.must_rest)
            self._told_waiting = state["waiting"]
            self._say("state", **state)

    # --- what the page wants ---

    def _heard(self) -> None:
        self._state()

    def _open_session(self) -> DriveSession:
        if self.session is None:
            raise WcsimError("no street is open; choose a town")
        return self.session

    def _stick(self, said: m.Stick) -> None:
        self._watch.hear(Joystick(said.x, said.y), said.overrule, self._now_s(), away=said.away)

    def _assist(self, said: m.Assist) -> None:
        """Switch the assistance. Time stops if it fails again at once, as at its first failure."""
        session = self._open_session()
        session.assist(said.on)
        self._told_failure = bool(session.assistance.failed)
        self.clock.paused = self.clock.paused or (said.on and self._told_failure)

    def _set_pace(self, said: m.Pace) -> None:
        self.clock.pace = said.times if said.times else 0.0
        self.clock.due_s = self._now_s()

    def _drive_by(self, said: m.DriveBy) -> None:
        self._watch.require_rest()
        self._open_session().drive_by(said.who)

    def _pause(self, said: m.Pause) -> None:
        if said.on is not self.clock.paused:
            self.clock.paused = said.on
            self._open_session().say(EventKind.PAUSED if said.on else EventKind.GOES_ON)
            self._watch.forget_press()
            self.clock.due_s = self._now_s()

    def _set_user(self, said: m.SetUser) -> None:
        session = self._open_session()
        check_offered(DriveStart(town=self._start.town, profile=said.profile), self._start)
        checked(DriveStart(town=session.place.start.town, profile=said.profile))
        self._begin_anew(lambda: session.change_user(said.profile))
        self._say("about", **_drive_about(session))

    def _begin_anew(self, begin: Callable[[], None], told: str = "") -> None:
        if told:
            self._busy(told)
        try:
            begin()
        finally:
            # This ends the wait of pages, also if it was refused.
            if told and self.session is not None:
                self._say("about", **_drive_about(self.session))
        self._watch.require_rest()
        self.clock.held_s = self.clock.ticked_s = 0.0

    def _open_other(self, said: m.Open) -> None:
        before = self.session.place.start if self.session is not None else self._start
        profile = before.profile if self.session is None or before.suite else self.session.profile
        start = replace(
            before,
            town=said.town or before.town,
            # The user of a suite's episode may be a file of the suite.
            profile="" if said.suite else profile or DriveStart().profile,
            seed=said.seed,
            suite=said.suite,
            block=said.block,
            seat=said.seat,
        )
        self._open(checked(check_offered(start, self._start)))

    def _open(self, start: DriveStart) -> None:
        """Open a place instead of the open one; the page is told if that fails."""
        try:
            self._open_place(start)
        except WcsimError as error:
            self.close()
            self._say("notice", kind="bad", told=str(error))
            # For pages that come later: there is nothing to wait for.
            self._say("busy", told=str(error), waits=False)

    def _open_place(self, start: DriveStart) -> DriveSession:
        """Open a place. Raises as `DriveSession`; then call `close`, as something may be open."""
        self._busy("Opening the street ...")
        if self.session is not None:
            # The stick keeps its shape.
            speed, sensitivity = self.session.shape
            start = replace(start, speed=speed, sensitivity=sensitivity)
        self.close()
        self._feed = None
        self._watch.require_rest()
        self.session = session = DriveSession(start, (self._note,), self._busy)
        if self._names is not None:
            session.add_observer(SessionRecorder(session, self._names, self._tell_kept))
        session.face_way()
        self._open_feed(session.world.street, session.world.config.cameras[0])
        self._drawn_episode = -1
        self.clock.opened(self._now_s())
        self._stale, self._unseen, self._told_failure = True, True, False
        self._say("about", **_drive_about(session))
        self._state()
        self._log(f"{session.place.told}: ready to drive")
        return session

    # --- a study ---

    def _begin(self) -> None:
        if self._study is None:
            self._open(self._start)
            return
        hands = StudyHands(
            open=self._open_part,
            close=self.close,
            show=self._show_study,
            say=self._log,
            clock=self._now_s,
        )
        try:
            self._lead = StudyLead(self._study, hands)
        except WcsimError as error:
            self._log(str(error))
            self._say("notice", kind="bad", told=str(error))
            self._over = True
            return
        self._does.update(dict.fromkeys(_STUDY, _refuse_in_study))
        self._lead.begin()

    def _open_part(self, start: DriveStart, path: Path) -> DriveSession:
        self._names = iter_unused_paths(path)
        try:
            return self._open_place(start)
        except WcsimError:
            self.close()
            raise

    def _show_study(self, view: dict[str, Any]) -> None:
        if view["kind"] is not StepKind.DRIVE:
            self._watch.require_rest()
        self._say("study", view=view)

    def _leads(self) -> StudyLead:
        if self._lead is None:
            raise WcsimError("this drive is not a study; start one with --study")
        return self._lead


def _refuse_in_study(_: m.PageMessage) -> None:
    """Refuse a message that would change what the study sets."""
    raise WcsimError("the study sets this; it cannot be changed while the study runs")


def _drive_about(session: DriveSession) -> dict[str, Any]:
    """What is driven, and what else can be; sent when a place is opened, and to each new page."""
    suites = {
        name: [
            (f"{block.part}, {block.town}", len(block.episodes))
            for block in open_suite(name).file.blocks
        ]
        for name in list_shipped_suites()
    }
    assistance = session.assistance
    return {
        "place": session.place.told,
        "town": session.place.town.name,
        "seed": session.place.start.seed,
        "policy": assistance.name,
        "profile": session.profile,
        "points": session.actions.points.tolist(),
        "towns": [town.name for town in list_towns()],
        "profiles": list_profile_names(),
        "suites": suites,  # by set: part and town of each block, and its seats
        "levels": assistance.levels,  # that assist least and most; None for a policy without levels
        "own_level": assistance.own_level,
        "tells_unsafe": assistance.tells_unsafe,
        "tick_s": session.tick_s,
    }


def _drive_state(
    session: DriveSession, clock: _DriveClock, waiting: str, let_go: bool
) -> dict[str, Any]:
    """The state of the drive, once a tick. At the beginning of an episode all is at rest."""
    last = session.last or _RESTS
    return {
        "tick": session.ticks,
        "time_s": round(session.time_s, 3),
        "driver": session.driver,
        "paused": clock.paused,
        "waiting": waiting,  # why nobody drives; "" while somebody does
        "let_go": let_go,  # the stick counts only once it has been at rest
        "alone": not session.handed_over,  # the simulated user drives alone, before a handover
        "pace": clock.pace,
        "stick": xy_of(last.stick),
        "commanded": xy_of(last.commanded),
        "unsafe": session.unsafe,
        "assisted": session.assistance.on,
        "level": session.assistance.level,
        "shape": session.shape,
        "help_s": round(session.help_left_s, 3),  # for which help is still on; 0 while it is not
        "warning": last.warning,
        "intervening": last.intervening,
        "overruled": last.overruled,
        "on_road": session.client.events.on_carriageway,  # the chair's middle, also on a crossing
        "speed_mps": round(last.speed_mps, 3),
        "left_m": round(session.left_m, 1),
        # Of the way ahead, to the left of the chair's heading.
        "bearing_deg": round(rad2deg(session.bearing_rad)),
        "crash": session.crash,
        "profile": session.profile,
        "kpis": m.kpis_of(session.metrics, session.tick_s),
        # Times real time, a mean.
        "real": round(session.tick_s / clock.gap_s, 2) if clock.gap_s > 0.0 else 1.0,
    }


def _notice_of(record: DriveRecord) -> tuple[str, str] | None:
    """Kind and words of a record for the person; None for ticks and crashes: the state has them."""
    if not isinstance(record, Note):
        return None
    if record.detail == ELSEWHERE:
        return "note", "No place before the crash is free. You start somewhere else."
    if record.kind == EventKind.HELP:
        return "note", record.detail
    if record.kind == EventKind.POLICY_FAILED:
        return "bad", f"The assistance failed and is off: {record.detail}"
    return _NOTICES.get(record.kind)
