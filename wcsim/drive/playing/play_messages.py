"""What the pages of a film say and hear, beside what those of a drive do: typed JSON with bounds."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

import msgspec

from wcsim.drive import messages as m
from wcsim.drive.messages import Count, Name, PageMessage

Jump = Annotated[int, msgspec.Meta(ge=-100_000, le=100_000)]


class Seek(PageMessage, frozen=True):
    """Show this frame."""

    to: Count


class StepBy(PageMessage, frozen=True):
    """Stand still, so many ticks farther on."""

    ticks: Jump


class FollowSeat(PageMessage, frozen=True):
    """Show this chair."""

    seat: Count


class GoLive(PageMessage, frozen=True):
    """Show the newest tick from now on."""


class OpenEpisode(PageMessage, frozen=True):
    """Drive another episode of the result."""

    slow: ClassVar[bool] = True
    policy: Name
    block: Count
    seat: Count


_FromPage = m.Shown | m.SetView | m.Pause | m.Pace | m.TakeOver | Seek | StepBy | FollowSeat | GoLive | OpenEpisode
_PAGE: Final = msgspec.json.Decoder(_FromPage)
_RUNNER: Final = msgspec.json.Decoder(_FromPage | m.Gone | m.Ready | m.End)


def of_play_page(data: str | bytes) -> PageMessage:
    """What a page says. Raises ProtocolError for what is no message, in a line."""
    return m.decoded(_PAGE, data)


def of_play_server(data: bytes) -> PageMessage:
    """What the server says to the runner. Raises ProtocolError."""
    return m.passed_on(_RUNNER, data)


class FailedLine(msgspec.Struct, frozen=True):
    """An episode of a result that went wrong."""

    policy: str
    block: int
    seat: int
    told: str


class PlayAbout(msgspec.Struct, tag_field="say", tag="about", frozen=True, kw_only=True):
    """What is shown."""

    title: str
    tick_s: float
    points: list[tuple[float, float]]
    unknown: list[str]
    camera: bool
    tells_unsafe: bool
    warns: bool
    tells_who: bool  # decides
    live: bool
    ticks: int  # that are to come, 0 where that is not known
    failed: list[FailedLine]
    policy: str = ""  # of the episode that is open, as the next
    block: int = -1


class PlayMarks(msgspec.Struct, tag_field="say", tag="marks", frozen=True, kw_only=True):
    """All marks of the time line: frame, seat or -1, kind, words."""

    marks: list[tuple[int, int, str, str]]
    left_out: int  # older ones


class PlayKpis(msgspec.Struct, frozen=True, kw_only=True):
    """The numbers of a chair up to here; None is what is not known."""

    kpi1: float | None
    kpi2: float | None
    ticks: int
    way_m: float
    crashes: int | None
    drops: int | None
    arrivals: int | None
    warnings: int | None
    interventions: int | None
    helps: int


class ChairLine(msgspec.Struct, frozen=True, kw_only=True):
    """A chair among others."""

    seat: int
    name: str
    here: bool
    warning: bool
    intervening: bool
    crashed: bool
    speed_mps: float
    step: int
    kpis: PlayKpis


class PlayState(msgspec.Struct, tag_field="say", tag="state", frozen=True, kw_only=True):
    """The film as it stands."""

    at: int
    first: int
    count: int
    reading: bool  # more is to come
    told: str  # what goes on
    ended: str  # how the film ended
    paused: bool
    pace: float
    live: bool
    epoch: int
    tick: int
    seat: int
    here: bool  # the chair that is followed is in the street
    stick: tuple[float, float] | None
    commanded: tuple[float, float] | None
    unsafe: list[int]
    warning: bool
    intervening: bool
    overruled: bool
    alone: bool
    unaided: bool
    crash: str
    left_m: float | None
    chairs: list[ChairLine]
    size_mb: float
