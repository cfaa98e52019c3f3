"""What the pages of a drive and of a film say and hear: typed JSON with a bound on every field, read at one door."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

import msgspec

from wcsim.config.study import MOST_QUESTIONS, MOST_STEPS
from wcsim.core.reading import escaped
from wcsim.drive.driven import DriverKind
from wcsim.drive.pictures import LARGEST_PX, SMALLEST_PX, CameraKind
from wcsim.drive.recording.study_plan import StudyView
from wcsim.errors import ProtocolError
from wcsim.supervisor.kpi import KpiTotals

MOST_BYTES: Final = 2048  # of a page's message
Part = Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]
Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 31)]
Name = Annotated[str, msgspec.Meta(max_length=400)]
Turn = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]
Metres = Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]
Pixels = Annotated[int, msgspec.Meta(ge=SMALLEST_PX, le=LARGEST_PX)]
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
    """What the page shows."""

    turn_rad: Turn
    tilt_rad: Turn
    distance_m: Metres
    width_px: Pixels
    height_px: Pixels
    camera: CameraKind
    chart: bool


class Assist(PageMessage, frozen=True):
    """The assistance is to be on or off."""

    on: bool


class SetLevel(PageMessage, frozen=True):
    """How much it assists."""

    level: Level


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


_OfDrive = Stick | Help | Assist | SetLevel | DriveBy | NewPlace | Again | SetUser | Open | GoOn | AnswerAll
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
            f"got a message that this server does not know: {escaped(str(error), 200)}; reload the page"
        ) from None
    return message


class Shows(msgspec.Struct, tag_field="say", tag=str.lower, frozen=True):
    """Base of what a page hears."""


class Notice(Shows, frozen=True):
    """A line for the person."""

    kind: str  # "good", "note", "bad", "refused"
    told: str


class PageRole(Shows, frozen=True, tag="role"):
    """What this page may do."""

    drives: bool
    taken: bool  # another page drives
    told: str = ""


class Keeping(Shows, frozen=True):
    """Whether the drive is kept in a file."""

    on: bool
    file: str
    told: str


class Study(Shows, frozen=True):
    """A step of a study, and how it stands."""

    view: StudyView


class Busy(Shows, frozen=True):
    """The street is not there yet, or will not be."""

    told: str
    waits: bool = True  # it is on its way; False when nothing is waited for any more


class About(Shows, frozen=True):
    """What is driven; said when a place has been opened, and to each page that comes."""

    place: str
    town: str
    seed: int
    policy: str
    profile: str
    points: list[tuple[float, float]]
    towns: list[str]
    profiles: list[str]
    suites: dict[str, list[tuple[str, int]]]  # by set: part and town of each block, and its seats
    levels: tuple[float, float] | None  # that which assists least, and most
    own_level: float | None  # the one that the policy came with
    tells_unsafe: bool
    tick_s: float


class Kpis(msgspec.Struct, frozen=True, kw_only=True):
    """The numbers of a chair up to now; None is what a film does not know."""

    kpi1: float | None
    kpi2: float | None
    ticks: int
    way_m: float
    crashes: int | None
    drops: int | None
    arrivals: int | None
    helps: int
    overrules: int | None
    warnings: int | None
    interventions: int | None


def kpis_of(totals: KpiTotals, tick_s: float, *, knows: bool = True, warns: bool = True) -> Kpis:
    """Totals as pages show them; a film may not know what happened, and may be of a policy that never warns."""
    named = ("crashes", "drops", "arrivals", "overrules", "interventions")
    return Kpis(
        kpi1=None if totals.kpi1 is None else round(totals.kpi1, 4),
        kpi2=round(totals.kpi2, 1) if knows else None,
        ticks=totals.ticks,
        way_m=round(totals.speed_sum * tick_s, 1),
        helps=totals.helps,
        warnings=totals.warnings if warns else None,
        **{name: getattr(totals, name) if knows else None for name in named},
    )


class DriveState(Shows, frozen=True, tag="state"):
    """The drive as it is, once a tick."""

    tick: int
    time_s: float
    driver: DriverKind
    paused: bool
    waiting: str  # why nobody drives, "" while somebody does
    let_go: bool  # the stick counts only once it has been at rest
    alone: bool  # the simulated user still has the chair, before a handover
    pace: float
    stick: tuple[float, float]
    commanded: tuple[float, float]
    unsafe: list[int]
    assisted: bool
    level: float | None
    help_s: float  # for which help is still on, 0 while it is not
    warning: bool
    intervening: bool
    overruled: bool
    on_road: bool  # the chair's middle is on a carriageway, a crossing too
    speed_mps: float
    left_m: float
    bearing_deg: float  # of the way ahead, from the chair's heading to the left
    crash: str
    profile: str
    kpis: Kpis
    rate: float  # ticks a second, a mean


def spoken(message: Shows) -> bytes:
    """What a page hears, as JSON."""
    return msgspec.json.encode(message)
