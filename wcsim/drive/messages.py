"""What the pages of a drive and of a film say and hear: typed JSON with a bound on every field, read at one door."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Final

import msgspec

from wcsim.config.study import MOST_QUESTIONS, MOST_STEPS
from wcsim.core.reading import escape
from wcsim.drive.driven import LEAST_SENSITIVITY, LEAST_SPEED, MOST_SENSITIVITY, DriverKind
from wcsim.errors import ProtocolError
from wcsim.supervisor.kpi import KpiTotals
from wcsim.view.street_scene import CameraKind

MOST_BYTES: Final = 2048  # of a page's message
Part = Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]
Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 31)]
Name = Annotated[str, msgspec.Meta(max_length=400)]
Speed = Annotated[float, msgspec.Meta(ge=0.0, le=8.0)]
AnswerNumber = Annotated[int, msgspec.Meta(ge=-1, lt=MOST_STEPS)]
Level = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]
Jump = Annotated[int, msgspec.Meta(ge=-100_000, le=100_000)]


class PageMessage(msgspec.Struct, tag_field="say", tag=str.lower, frozen=True, forbid_unknown_fields=True):
    """Base of what a page says: an object with its name in `say`, unknown fields refused."""

    slow: ClassVar[bool] = False  # takes seconds: the runner says when it is done, and hears the next one then


class Stick(PageMessage, frozen=True):
    """Where the person's stick is; sent 20 times a second and more, for without it the chair stops."""

    x: Part
    y: Part
    overrule: bool = False
    away: bool = False  # the page is hidden, or has lost the focus


class Help(PageMessage, frozen=True):
    """The person asks for help."""


class Shown(PageMessage, frozen=True):
    """The pictures with this number are on the page: it takes newer ones."""

    number: Count


class SetView(PageMessage, frozen=True):
    """What the page shows of the chair's own camera."""

    camera: CameraKind


class Assist(PageMessage, frozen=True):
    """The assistance is to be on or off."""

    on: bool


class SetLevel(PageMessage, frozen=True):
    """How much it assists."""

    level: Level


class ShapeStick(PageMessage, frozen=True):
    """How the person's stick is shaped."""

    speed: Annotated[float, msgspec.Meta(ge=LEAST_SPEED, le=1.0)]
    sensitivity: Annotated[float, msgspec.Meta(ge=LEAST_SENSITIVITY, le=MOST_SENSITIVITY)]


class DriveBy(PageMessage, frozen=True):
    """Who drives."""

    who: DriverKind


class Pace(PageMessage, frozen=True):
    """How fast time goes: 1 is real time, 0 as fast as it can."""

    times: Speed


class Pause(PageMessage, frozen=True):
    """Time is to stand still, or to go on."""

    on: bool


class NewPlace(PageMessage, frozen=True):
    """Another start in the same street."""

    slow: ClassVar[bool] = True


class Again(PageMessage, frozen=True):
    """The same street from its beginning."""

    slow: ClassVar[bool] = True


class SetUser(PageMessage, frozen=True):
    """Another simulated user."""

    slow: ClassVar[bool] = True
    profile: Name


class Open(PageMessage, frozen=True):
    """Another place: a town, or an episode of a suite."""

    slow: ClassVar[bool] = True
    town: Name = ""
    seed: Count = 0
    suite: Name = ""
    block: Count = 0
    seat: Count = 0


class GoOn(PageMessage, frozen=True):
    """In a study: the button of this step is pressed; of a drive, that it is to end here."""

    step: Count


class AnswerAll(PageMessage, frozen=True):
    """In a study: the answers to this step's questions, in their order, -1 for one that is left out."""

    step: Count
    answers: Annotated[list[AnswerNumber], msgspec.Meta(max_length=MOST_QUESTIONS)]


class Seek(PageMessage, frozen=True):
    """Of a film: show this frame."""

    to: Count


class StepBy(PageMessage, frozen=True):
    """Of a film: stand still, so many ticks farther on."""

    ticks: Jump


class FollowSeat(PageMessage, frozen=True):
    """Of a film: show this chair."""

    seat: Count


class GoLive(PageMessage, frozen=True):
    """Of a film: show the newest tick from now on."""


class OpenEpisode(PageMessage, frozen=True):
    """Of a film: drive another episode of the result."""

    slow: ClassVar[bool] = True
    policy: Name
    block: Count
    seat: Count


class TakeOver(PageMessage, frozen=True):
    """This page wants to drive; the one that did looks on from now on."""


class Gone(PageMessage, frozen=True):
    """Of the server: no page drives."""


class Ready(PageMessage, frozen=True):
    """Of the server: a page takes pictures."""


class End(PageMessage, frozen=True):
    """Of the server: the drive is over."""


_OfDrive = (
    Stick | Help | Assist | SetLevel | ShapeStick | DriveBy | NewPlace | Again | SetUser | Open | GoOn | AnswerAll
)
_OfFilm = Seek | StepBy | FollowSeat | GoLive | OpenEpisode
_PAGE: Final = msgspec.json.Decoder(_OfDrive | _OfFilm | Shown | SetView | Pace | Pause | TakeOver)


def of_page(data: str | bytes) -> PageMessage:
    """What a page says. Raises ProtocolError for what is no message, in a line."""
    if len(data) > MOST_BYTES:
        raise ProtocolError(f"a message has {len(data)} bytes; expected at most {MOST_BYTES}")
    try:
        message: PageMessage = _PAGE.decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ProtocolError(
            f"got a message that this server does not know: {escape(str(error), 200)}; reload the page"
        ) from None
    return message


def kpis_of(totals: KpiTotals, tick_s: float, *, knows: bool = True, warns: bool = True) -> dict[str, float | None]:
    """Totals as pages show them; a film may not know what happened, and may be of a policy that never warns.

    What is not known is None.
    """
    named = ("crashes", "drops", "arrivals", "overrules", "interventions")
    return {
        "kpi1": None if totals.kpi1 is None else round(totals.kpi1, 4),
        "kpi2": round(totals.kpi2, 1) if knows else None,
        "ticks": totals.ticks,
        "way_m": round(totals.speed_sum * tick_s, 1),
        "helps": totals.helps,
        "warnings": totals.warnings if warns else None,
        **{name: getattr(totals, name) if knows else None for name in named},
    }


def spoken(say: str, told: Mapping[str, object]) -> bytes:
    """What a page hears, as JSON: an object whose `say` names the kind of the message.

    - `notice`: a line for the person, `told`, of a `kind`: good, note, bad or refused.
    - `role`: whether this page `drives`, whether another one has `taken` that, and a line.
    - `keeping`: whether the drive is kept in a `file`, and a line.
    - `study`: the `view` of a step, see `step_view`.
    - `busy`: the street is not there yet, in a line; with `waits` False nothing is waited for any more.
    - `about`, `state`: see `_drive_about`, `_drive_state`, and of a film `_film_about`, `_film_state`.
    - `street`, `way`: what there is to load around the chair, see `StreetFeed`, and its route.
    - `marks`: all marks of a film's time line, see `_FilmMark`.
    """
    return msgspec.json.encode({"say": say, **told})
