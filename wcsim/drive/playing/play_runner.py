"""The process that plays a film: takes it from a source, obeys the page, and reports to it."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, ClassVar, Final

import msgspec

from wcsim.config import CameraConfig, parse_json
from wcsim.core.processes import start_piped_process
from wcsim.drive import messages as m
from wcsim.drive.playing.film_states import FilmAbout, FilmFrame, FilmLine, FilmNames, Said
from wcsim.drive.playing.sources.source_process import FilmSource, run_at_low_priority, run_source
from wcsim.drive.playing.tick_film import TickFilm
from wcsim.drive.runner import Does, PageRunner
from wcsim.errors import WcsimError
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.kpi import KpiTotals
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street

_IDLE_S: Final = 0.2
_TAKE_S: Final = 0.02  # of a turn, for what the source says
_TOLD_S: Final = 0.25  # between two states while nothing moves but the source
_MARKS_S: Final = 1.0
_END_S: Final = 10.0
SLOWEST, FASTEST = 0.25, 8.0
_LATE_S: Final = 0.5  # a player that was kept from its turn for longer does not make up for it
CRASH_TICKS: Final = 15  # so long a crash is shown


class FailedLine(msgspec.Struct, frozen=True):
    """An episode of a result that went wrong."""

    policy: str
    block: int
    seat: int
    told: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PlayStart:
    """What to play."""

    source: FilmSource
    seat: int | None = None  # whom to follow, None for the first
    failed: tuple[FailedLine, ...] = ()

    word: ClassVar = "film"  # as of `DriveOrder`, as the next
    page: ClassVar = "play.html"
    begins: ClassVar = "starting the player, then loading the recording"
    over: ClassVar = "The player has ended. Start the command again."

    def run(self, pipe: Connection) -> None:
        """What the player's process does."""
        if self.source.gives_way:
            run_at_low_priority()
        _PlayRunner(pipe, self).run_process()


class _Player:
    """The number of the frame that is shown.

    >>> player = _Player()
    >>> player.advance(0.0, range(100), 0.1), player.advance(0.25, range(100), 0.1)
    (False, True)
    >>> player.at
    2
    """

    def __init__(self, *, live: bool = False) -> None:
        """Begin with the first frame, or with whatever is the newest."""
        self.at, self.paused, self.pace, self.live = 0, False, 1.0, live
        self.jumped = True  # since the picture before
        self._now_s: float | None = None
        self._owed_s = 0.0  # of the film

    def advance(self, now_s: float, span: range, tick_s: float) -> bool:
        """Let time go to `now_s`; whether another frame is shown. Those of `span` are there."""
        gone_s = 0.0 if self._now_s is None else min(max(0.0, now_s - self._now_s), _LATE_S)
        self._now_s, before = now_s, self.at
        if not span:
            return False
        if self.live:
            self.at = span.stop - 1
        elif not self.paused:
            self._owed_s += gone_s * self.pace
            ticks = int(self._owed_s / tick_s + 1e-9)
            self._owed_s = self._owed_s - ticks * tick_s if self.at + ticks < span.stop else 0.0
            self.at += ticks
        self.at = min(max(self.at, span.start), span.stop - 1)
        return self.at != before

    def seek(self, to: int, span: range) -> None:
        """Show this frame, or the nearest that is there."""
        self.live, self._owed_s, self.jumped = False, 0.0, True
        self.at = min(max(to, span.start), max(span.start, span.stop - 1))

    def step(self, by: int, span: range) -> None:
        """Stand still, so many frames farther on, or back."""
        self.paused = True
        self.seek(self.at + by, span)

    def go_live(self) -> None:
        """Show the newest frame from now on, as it comes."""
        self.live, self.paused, self.jumped = True, False, True

    def pause(self, on: bool) -> None:
        """Stand still, or go on from here."""
        self.paused, self._owed_s = on, 0.0
        self.live = False

    def set_pace(self, times: float) -> None:
        """Go so much faster than it was."""
        self.pace = min(max(times, SLOWEST), FASTEST)


class _PlayRunner(PageRunner):
    """Plays films one after another, until the pipe to the server ends.

    Args:
        pipe: To the server.
        start: The first film.
        clock: Monotonic seconds.
    """

    def __init__(
        self, pipe: Connection, start: PlayStart, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(pipe, clock)
        self._start, self._opened = start, start.source
        self._film: TickFilm | None = None
        self._player = _Player()
        self._names: dict[int, str] = {}
        self._seat, self._told, self._ended = -1 if start.seat is None else start.seat, "", ""
        self._changed = True
        self._said_s = self._marked_s = 0.0
        self._marked = 0
        self._source: Connection | None = None
        self._process: BaseProcess | None = None
        does: Does = {
            m.Pause: self._pause,
            m.Pace: lambda said: self._player.set_pace(said.times),
            m.Seek: lambda said: self._player.seek(said.to, self._span),
            m.StepBy: lambda said: self._player.step(said.ticks, self._span),
            m.FollowSeat: self._follow,
            m.GoLive: lambda _: self._player.go_live(),
            m.OpenEpisode: self._open_episode,
        }
        self._does |= does

    def close(self) -> None:
        """End the source; one that does not end is killed."""
        if self._source is not None:
            self._source.close()
            self._source = None
        if self._process is not None:
            try:
                self._process.join(_END_S)
            finally:  # a signal ends the wait
                self._process.kill()
                self._process.join()
            self._process = None

    # --- one turn of the loop ---

    def _turn(self) -> None:
        pipes = [self._pipe] if self._source is None else [self._pipe, self._source]
        wait(pipes, self._wait_s())
        self._hear()
        self._take()
        film, now_s = self._film, self._now_s()
        if film is None or not film.count:
            return
        player = self._player
        if player.advance(now_s, film.span, film.about.tick_s):
            self._stale = self._changed = True
        if self._source is None and player.at == film.count - 1 and not player.paused:  # the end
            player.pause(True)
            self._changed = True
        if self._changed or now_s - self._said_s > _TOLD_S:
            self._state(film, now_s)
        if self._ready and self._stale:
            moment = film.moment(player.at, self._seat, player.jumped)
            if self._feed is not None and moment is not None:
                self._draw(moment, self._feed)
                player.jumped = False

    def _wait_s(self) -> float:
        film, player = self._film, self._player
        if film is None or player.paused or player.live or player.at >= film.count - 1:
            return _IDLE_S
        return min(_IDLE_S, 0.5 * film.about.tick_s / player.pace)

    def _take(self) -> None:
        """Receive what the source sends, for a while, and note its end."""
        source, until_s = self._source, self._now_s() + _TAKE_S
        if source is None:
            return
        try:
            while source.poll():
                self._said(source.recv())
                if self._now_s() > until_s:
                    return
        except (EOFError, ConnectionResetError):
            # It has sent all, or died.
            source.close()
            self._source = None
            if not self._ended:
                self._ended = "The process that loads this film has ended; the terminal shows why."
                self._say("notice", kind="bad", told=self._ended)
            self._changed = True
            if self._film is None or not self._film.count:
                self._say("busy", told=self._ended, waits=False)

    def _said(self, said: Said) -> None:
        match said:
            case FilmFrame() if self._film is not None:
                if self._seat < 0 and said.chairs:
                    self._seat = said.chairs[0].seat
                self._film.add(said)
            case FilmAbout():
                self._show_first(said)
            case FilmNames():
                self._names = said.names
            case FilmLine():
                self._line(said)

    def _line(self, said: FilmLine) -> None:
        self._changed = True
        if said.kind == "mark" and self._film is not None:
            self._film.mark("gap", said.told)
        elif said.kind == "bad":
            self._say("notice", kind="bad", told=said.told)
            self._log(said.told)
        elif said.kind == "end":
            self._ended, self._told = said.told, ""
        else:
            self._told = said.told

    def _state(self, film: TickFilm, now_s: float) -> None:
        words = (self._told, self._ended, self._source is not None)
        self._say("state", **_film_state(film, self._player, self._seat, self._names, words))
        self._said_s, self._changed = now_s, False
        if film.marked != self._marked and now_s - self._marked_s > _MARKS_S:
            self._marked, self._marked_s = film.marked, now_s
            self._say("marks", marks=film.there)

    # --- requests of the page ---

    def _heard(self) -> None:
        self._changed = True

    @property
    def _span(self) -> range:
        return range(0) if self._film is None else self._film.span

    def _pause(self, said: m.Pause) -> None:
        """Stand still or go on. At the end of the film, going on starts it again."""
        film, player = self._film, self._player
        if (
            not said.on
            and self._source is None
            and film is not None
            and player.at == film.count - 1
        ):
            player.seek(film.first, film.span)
        player.pause(said.on)

    def _follow(self, said: m.FollowSeat) -> None:
        self._seat, self._player.jumped = said.seat, True

    def _open_episode(self, said: m.OpenEpisode) -> None:
        source = self._start.source
        if source.kind != "episode":
            raise WcsimError("this film is not of a suite; expected a result of wcsim test --suite")
        episode = said.policy, said.block
        if episode not in [(one.policy, one.block) for one in self._start.failed]:
            raise WcsimError(
                f"{said.policy} has no failed episode in block {said.block}; "
                "expected one of the list"
            )
        self.close()
        self._seat = said.seat
        self._open(replace(source, policy=said.policy, block=said.block))

    # --- films ---

    def _begin(self) -> None:
        self._open(self._start.source)

    def _open(self, source: FilmSource) -> None:
        """Start the process of a source."""
        waits = "; it takes longer while the training uses the CPU" if source.gives_way else ""
        self._busy(f"Opening the street{waits} ...")
        self._film, self._told, self._ended = None, "", ""
        self._names, self._marked, self._opened = {}, 0, source
        self._source, self._process = start_piped_process(
            run_source, source, name="wcsim-film", daemon=True
        )

    def _show_first(self, about: FilmAbout) -> None:
        """Begin a film, and load its street here too. If it cannot be drawn, the page shows why."""
        try:
            street = load_street(find_town(about.town))
            front = None
            if about.camera:
                front = parse_json(CameraConfig, about.camera, "the camera of the film")
        except WcsimError as error:
            self._line(FilmLine(kind="bad", told=str(error)))
            return
        self._open_feed(street, front)
        self._film = TickFilm(about)
        self._player = _Player(live=about.live)
        self._say(
            "about",
            **_film_about(about, self._start.failed, self._opened.policy, self._opened.block),
        )
        self._say("marks", marks=self._film.there)  # none yet, and no more of the film before
        self._stale = self._changed = True


def _film_about(
    about: FilmAbout, failed: Sequence[FailedLine], policy: str, block: int
) -> dict[str, Any]:
    """What a film is; `policy` and `block` of an episode that was asked for."""
    points = action_set(about.actions).points.tolist() if about.actions else []
    return {"film": about, "points": points, "failed": failed, "policy": policy, "block": block}


def _film_state(
    film: TickFilm,
    player: _Player,
    seat: int,
    names: Mapping[int, str],
    words: tuple[str, str, bool],
) -> dict[str, Any]:
    """How a film stands.

    Args:
        film: With a frame at least.
        player: Where it is.
        seat: Who is followed.
        names: Of the seats.
        words: What goes on, how it ended, and whether more is to come.
    """
    shot, about = film.shot(player.at), film.about
    chairs = {chair.seat: chair for chair in shot.frame.chairs}
    told, ended, reading = words
    lines = [
        {
            "seat": each,
            "name": names.get(each, f"chair {each}"),
            "chair": chairs.get(each),  # None while it is not in the street
            "kpis": m.kpis_of(
                shot.sums.get(each, KpiTotals()),
                about.tick_s,
                knows=bool(about.actions),
                warns=about.warns,
            ),
        }
        for each in sorted({*names, *chairs})
    ]
    return {
        "at": player.at,
        "first": film.first,
        "count": film.count,
        "reading": reading,
        "told": told,
        "ended": ended,
        "paused": player.paused,
        "pace": player.pace,
        "live": player.live,
        "epoch": shot.frame.epoch,
        "tick": shot.frame.tick,
        "seat": seat,
        "crash": _crash(film, player.at, seat),
        "chairs": lines,
        "size_mb": round(film.packed_bytes / 2**20, 1),
    }


def _crash(film: TickFilm, at: int, seat: int) -> str:
    """What a chair has just crashed into, in words; shown a while, as a moment is easily missed."""
    for mark in reversed(film.marks):
        shown = 0 <= at - mark.at < CRASH_TICKS
        if shown and mark.seat == seat and mark.kind in ("crash", "drop"):
            return mark.told
    return ""
