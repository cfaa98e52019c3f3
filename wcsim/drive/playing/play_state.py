"""The view model of a film: what it is, its playback position, its state, and the marks on its time line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from wcsim.drive.playing.film_states import FilmAbout, FilmChair, Flag
from wcsim.drive.playing.play_messages import (
    ChairLine,
    FailedLine,
    PlayAbout,
    PlayKpis,
    PlayMarks,
    PlayState,
)
from wcsim.drive.playing.tick_film import ChairSums, TickFilm
from wcsim.supervisor.actions import action_set

SLOWEST, FASTEST = 0.25, 8.0
_LATE_S: Final = 0.5  # a player that was kept from its turn for longer does not make up for it
CRASH_TICKS: Final = 15  # so long a crash is shown


class Player:
    """The number of the frame that is shown.

    >>> player = Player()
    >>> player.advance(0.0, first=0, count=100, tick_s=0.1), player.advance(0.25, first=0, count=100, tick_s=0.1)
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

    def advance(self, now_s: float, *, first: int, count: int, tick_s: float) -> bool:
        """Let time go to `now_s`; whether another frame is shown. Frames are there from `first` to `count` - 1."""
        gone_s = 0.0 if self._now_s is None else min(max(0.0, now_s - self._now_s), _LATE_S)
        self._now_s, before = now_s, self.at
        if count <= first:
            return False
        if self.live:
            self.at = count - 1
        elif not self.paused:
            self._owed_s += gone_s * self.pace
            ticks = int(self._owed_s / tick_s + 1e-9)
            self._owed_s = self._owed_s - ticks * tick_s if self.at + ticks < count else 0.0
            self.at += ticks
        self.at = min(max(self.at, first), count - 1)
        return self.at != before

    def seek(self, to: int, *, first: int, count: int) -> None:
        """Show this frame, or the nearest that is there."""
        self.live, self._owed_s, self.jumped = False, 0.0, True
        self.at = min(max(to, first), max(first, count - 1))

    def step(self, by: int, *, first: int, count: int) -> None:
        """Stand still, so many frames farther on, or back."""
        self.paused = True
        self.seek(self.at + by, first=first, count=count)

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


def film_about(about: FilmAbout, failed: Sequence[FailedLine], policy: str, block: int) -> PlayAbout:
    """What a film is; `policy` and `block` of an episode that was asked for."""
    points = action_set(about.actions).points.tolist() if about.actions else []
    return PlayAbout(
        title=about.title,
        tick_s=about.tick_s,
        points=[(x, y) for x, y in points],
        unknown=about.unknown,
        camera=bool(about.camera),
        tells_unsafe=about.tells_unsafe,
        warns=about.warns,
        tells_who=about.tells_who,
        live=about.live,
        ticks=about.ticks,
        failed=list(failed),
        policy=policy,
        block=block,
    )


def film_marks(film: TickFilm) -> PlayMarks:
    """The marks of a film."""
    marks = [(mark.at, mark.seat, mark.kind, mark.told) for mark in film.marks if mark.at >= film.first]
    return PlayMarks(marks=marks, left_out=film.marked - len(film.marks))


def film_state(
    film: TickFilm, player: Player, seat: int, names: Mapping[int, str], words: tuple[str, str, bool]
) -> PlayState:
    """How a film stands.

    Args:
        film: With a frame at least.
        player: Where it is.
        seat: Who is followed.
        names: Of the seats.
        words: What goes on, how it ended, and whether more is to come.
    """
    shot = film.shot(player.at)
    chairs = {chair.seat: chair for chair in shot.frame.chairs}
    own = chairs.get(seat)
    flags = Flag(0) if own is None else Flag(own.flags)
    told, ended, reading = words
    return PlayState(
        at=player.at,
        first=film.first,
        count=film.count,
        reading=reading,
        told=told,
        ended=ended,
        paused=player.paused,
        pace=player.pace,
        live=player.live,
        epoch=shot.frame.epoch,
        tick=shot.frame.tick,
        seat=seat,
        here=own is not None,
        stick=None if own is None else own.stick,
        commanded=None if own is None else own.commanded,
        unsafe=[] if own is None else own.unsafe or [],
        warning=Flag.WARNING in flags,
        intervening=Flag.INTERVENING in flags,
        overruled=Flag.OVERRULED in flags,
        alone=Flag.ALONE in flags,
        unaided=Flag.UNAIDED in flags,
        crash=_crash(film, player.at, seat),
        left_m=None if own is None or own.left_m < 0 else round(own.left_m, 1),
        chairs=[
            _line(each, chairs.get(each), names, shot.sums.get(each), film.about) for each in sorted({*names, *chairs})
        ],
        size_mb=round(film.packed_bytes / 2**20, 1),
    )


def _line(
    seat: int, chair: FilmChair | None, names: Mapping[int, str], sums: ChairSums | None, about: FilmAbout
) -> ChairLine:
    flags = Flag(0) if chair is None else Flag(chair.flags)
    return ChairLine(
        seat=seat,
        name=names.get(seat, f"chair {seat}"),
        here=chair is not None,
        warning=Flag.WARNING in flags,
        intervening=Flag.INTERVENING in flags,
        crashed=Flag.CRASHED in flags,
        speed_mps=0.0 if chair is None else round(chair.speed_mps, 2),
        step=-1 if chair is None else chair.step,
        kpis=_kpis(sums or ChairSums(), about),
    )


def _kpis(sums: ChairSums, about: FilmAbout) -> PlayKpis:
    """What a trace does not know is None: it has neither actions nor events."""
    knows = bool(about.actions)
    return PlayKpis(
        kpi1=None if sums.kpi1 is None else round(sums.kpi1, 4),
        kpi2=round(sums.kpi2, 1) if knows else None,
        ticks=sums.ticks,
        way_m=round(sums.way_m, 1),
        crashes=sums.crashes if knows else None,
        drops=sums.drops if knows else None,
        arrivals=sums.arrivals if knows else None,
        warnings=sums.warnings if about.warns else None,
        interventions=sums.interventions if knows else None,
        helps=sums.helps,
    )


def _crash(film: TickFilm, at: int, seat: int) -> str:
    """What a chair has just crashed into, in words; shown a while, as a moment is easily missed."""
    for mark in reversed(film.marks):
        if mark.seat == seat and mark.kind in ("crash", "drop") and at - CRASH_TICKS < mark.at <= at:
            return mark.told
    return ""
