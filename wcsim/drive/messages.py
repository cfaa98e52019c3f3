"""The messages of drive and film pages: typed JSON, a bound on every field, read in `of_page`."""

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


class PageMessage(
    msgspec.Struct, tag_field="say", tag=str.lower, frozen=True, forbid_unknown_fields=True
):
    """Base of what a page says: an object with its name in `say`; unknown fields are refused."""

    # Takes seconds: the runner says when it is done, and then hears the next slow one.
    slow: ClassVar[bool] = False


class Stick(PageMessage, frozen=True):
    """The person's stick, sent at least 20 times a second; without it the chair stops."""

    x: Part
    y: Part
    overrule: bool = False
    away: bool = False  # the page is hidden, or has lost the focus


class Help(PageMessage, frozen=True):
    """The person asks for help."""


class Shown(PageMessage, frozen=True):
    """The page shows the pictures with this number and takes newer ones."""

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
    """How fast time goes: 1 is real time, 0 is as fast as possible."""

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
    """In a study: the button of this step is pressed; in a driving part it ends the part."""

    step: Count


class AnswerAll(PageMessage, frozen=True):
    """In a study: the answers to this step's questions, in order; -1 is no answer."""

    step: Count
    answers: Annotated[list[AnswerNumber], msgspec.Meta(max_length=MOST_QUESTIONS)]


class Seek(PageMessage, frozen=True):
    """Of a film: show this frame."""

    to: Count


class StepBy(PageMessage, frozen=True):
    """Of a film: stop, and move by this many ticks."""

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
    """This page wants to drive; the page that drove watches from now on."""


class Gone(PageMessage, frozen=True):
    """Of the server: no page drives."""


class Ready(PageMessage, frozen=True):
    """Of the server: a page takes pictures."""


class End(PageMessage, frozen=True):
    """Of the server: the drive is over."""


_OfDrive = (
    Stick
    | Help
    | Assist
    | SetLevel
    | ShapeStick
    | DriveBy
    | NewPlace
    | Again
    | SetUser
    | Open
    | GoOn
    | AnswerAll
)
_OfFilm = Seek | StepBy | FollowSeat | GoLive | OpenEpisode
_PAGE: Final = msgspec.json.Decoder(_OfDrive | _OfFilm | Shown | SetView | Pace | Pause | TakeOver)


def of_page(data: str | bytes) -> PageMessage:
    """Read what a page says. Raises ProtocolError, in one line, for anything else."""
    if len(data) > MOST_BYTES:
        raise ProtocolError(f"a message has {len(data)} bytes; expected at most {MOST_BYTES}")
    try:
        message: PageMessage = _PAGE.decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ProtocolError(
            f"got a message that this server does not know: {escape(str(error), 200)}; "
            "reload the page"
        ) from None
    return message


def kpis_of(
    totals: KpiTotals, tick_s: float, *, knows: bool = True, warns: bool = True
) -> dict[str, float | None]:
    """Totals as pages show them; None for what is not known.

    Args:
        totals: Of the drive or the film.
        tick_s: Seconds of a tick.
        knows: False for a film that does not know what happened.
        warns: False for a film of a policy that never warns.
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
    """What a page hears, as JSON: an object with the kind of the message in `say`.

    - `notice`: a line for the person, `told`, of a `kind`: good, note, bad or refused.
    - `role`: whether this page `drives`, whether another one has `taken` that, and a line.
    - `keeping`: whether the drive is kept in a `file`, and a line.
    - `study`: the `view` of a step, see `step_view`.
    - `busy`: a line on why the street is not there yet; with `waits` False the wait is over.
    - `about`, `state`: see `_drive_about`, `_drive_state`; of a film `_film_about`, `_film_state`.
    - `street`, `way`: what to load around the chair, see `StreetFeed`, and the chair's route.
    - `marks`: all marks of a film's time line, see `_FilmMark`.
    """
    return msgspec.json.encode({"say": say, **told})
