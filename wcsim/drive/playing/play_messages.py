"""What the page of a film hears: what the film is, how it stands, its marks; and the playback position, `Player`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec

from wcsim.drive import messages as m
from wcsim.drive.playing.film_states import FilmAbout
from wcsim.drive.playing.tick_film import TickFilm
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.kpi import KpiTotals

SLOWEST, FASTEST = 0.25, 8.0
_LATE_S: Final = 0.5  # a player that was kept from its turn for longer does not make up for it
CRASH_TICKS: Final = 15  # so long a crash is shown


class FailedLine(msgspec.Struct, frozen=True):
    """An episode of a result that went wrong."""

    policy: str
    block: int
    seat: int
    told: str


class Player:
    """The number of the frame that is shown.

    >>> player = Player()
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
        """Let time go to `now_s`; whether another frame is shown, of those of `span` that are there."""
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


def film_about(about: FilmAbout, failed: Sequence[FailedLine], policy: str, block: int) -> dict[str, Any]:
    """What a film is; `policy` and `block` of an episode that was asked for."""
    points = action_set(about.actions).points.tolist() if about.actions else []
    return {"film": about, "points": points, "failed": failed, "policy": policy, "block": block}


def film_state(
    film: TickFilm, player: Player, seat: int, names: Mapping[int, str], words: tuple[str, str, bool]
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
                shot.sums.get(each, KpiTotals()), about.tick_s, knows=bool(about.actions), warns=about.warns
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
        if mark.seat == seat and mark.kind in ("crash", "drop") and at - CRASH_TICKS < mark.at <= at:
            return mark.told
    return ""
