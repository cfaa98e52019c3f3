"""What became of one test episode, in plain numbers that can be added up over episodes."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, get_type_hints

from wcsim.core.reading import JsonObject, escape, escape_repr, pluralize
from wcsim.errors import ConfigError

FINISHED: Final = "finished"
CRASHED: Final = "chair_crashed"
GAVE_UP: Final = "gave_up"
TIMED_OUT: Final = "timed_out"
POLICY_FAILED: Final = "policy_failed"
REFUSED: Final = "refused"
NOT_REACHED: Final = "not_reached"  # it ended before the policy took over
STATUSES: Final = (FINISHED, CRASHED, GAVE_UP, TIMED_OUT, POLICY_FAILED, REFUSED, NOT_REACHED)

SCORE_VERSION: Final = 4  # of what a row counts and of its score

# parts to be driven to the end; in others it is enough to come through
ON_THE_WAY: Final = (
    "free",
    "crossing",
)

NEEDED: Final = "needed"
NEEDLESS: Final = "needless"
NOT_JUDGED: Final = "not_judged"

_AGAIN: Final = "run the test again with this version"
_LARGEST: Final = 1e12  # of a number, so that sums and squares of any are finite
_PLAIN: Final[Mapping[type, tuple[type, ...]]] = {
    int: (int,),
    float: (int, float),
    str: (str,),
    bool: (bool,),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Intervention:
    """A run of steps with a joystick distance above 0.1768, and what its forks said.

    Gaps under 0.5 s are joined.
    """

    first: int  # step of the episode, of the policy's part
    last: int
    verdict: str  # needed, needless or not_judged
    crash_after_s: float | None = None  # of the user alone, from `first` on
    needless_steps: int = 0  # of a long one some may be


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeRecord:
    """One episode of a policy; sums where there can be sums."""

    block: int
    seat: int
    part: str
    town: str
    profile: str
    status: str
    reason: str = ""  # of a crash as in `Events.crash_reason`, of a failure what went wrong
    fault: str = ""  # own or other, of a crash
    partner: str = ""  # kind of what was hit
    crash: str = ""  # as `Events.crash`: with whom, and where in SUMO's net
    steps: int = 0  # that the policy drove
    time_s: float = 0.0
    m: float = 0.0
    route_m: float = 0.0  # that was left when the policy took over
    done_m: float = 0.0  # of it
    distance_sum: float = 0.0  # of joystick distances, KPI 1's
    within: int = 0  # steps with one of at most 0.1768
    freezes: int = 0
    goals: int = 0  # destinations reached
    given_up: int = 0
    road_s: float = 0.0
    red_entries: int = 0
    crossings: int = 0
    missed: bool = False  # an own crash without an intervention in the 5 s before
    warned: int = 0  # crashes and needed interventions with a warning at least 1 s ahead
    to_warn: int = 0  # all of those
    false_warnings: int = 0
    interventions: tuple[Intervention, ...] = ()
    judged: bool = True  # whether forks said what its interventions and warnings were worth
    end_m: tuple[float, float] = (0.0, 0.0)  # where it ended, W
    accel_sq_sum: float = 0.0  # of the squared change of speed from step to step, (m/s2)^2
    stick_travel: float = 0.0  # way of the stick's tip that the chair was given, in stick's lengths
    asked_travel: float = 0.0  # and of the user's own
    helps: int = 0  # times that the user asked for help
    path_m: tuple[tuple[float, float], ...] = ()  # once a second, and at the end, W
    # before its crash, at which a copy of the world still survived
    last_moment_s: float | None = None
    cause: str = ""  # of its crash: unseen, missed, late, given_back or in_vain

    @property
    def counts(self) -> bool:
        """Whether it says something of the policy that no other episode of the list says."""
        return self.status != NOT_REACHED

    @property
    def own(self) -> bool:
        """Whether it ended with a crash that is the chair's own."""
        return self.status == CRASHED and self.fault == "own"

    @property
    def score(self) -> float | None:
        """0 after any crash, else the share of steps in no needless intervention.

        Without forks: the share of steps within 0.1768. None on a way, where one is to arrive.
        """
        if self.part in ON_THE_WAY:
            return None
        if self.status == CRASHED or not self.held or not self.steps:
            return 0.0
        if not self.judged:
            return self.within / self.steps
        return 1.0 - sum(item.needless_steps for item in self.interventions) / self.steps

    @property
    def held(self) -> bool:
        """Whether the policy could be used to the end, however that was."""
        return self.status not in (POLICY_FAILED, REFUSED, NOT_REACHED)

    def to_json(self) -> JsonObject:
        """Plain values under the same names."""
        return asdict(self)


Records = tuple[EpisodeRecord, ...]


def both_counted(
    records: Iterable[EpisodeRecord], others: Iterable[EpisodeRecord]
) -> list[tuple[EpisodeRecord, EpisodeRecord]]:
    """The pairs of the same episodes that count for both."""
    return [
        (own, other)
        for own, other in zip(records, others, strict=True)
        if own.counts and other.counts
    ]


def saved_and_lost(
    records: Iterable[EpisodeRecord], others: Iterable[EpisodeRecord]
) -> tuple[int, int]:
    """Crashes that the others have in the same episodes and these have not, and the reverse.

    Where a policy failed or was refused nobody drove to the end, and nothing was saved.
    """
    pairs = [
        (own, other)
        for own, other in both_counted(records, others)
        if own.held and other.held and (own.status == CRASHED) is not (other.status == CRASHED)
    ]
    lost = sum(own.status == CRASHED for own, _ in pairs)
    return len(pairs) - lost, lost


def undriven(policy: str, records: Sequence[EpisodeRecord]) -> list[str]:
    """A line for each way in which a policy was of no use, with its most frequent reason.

    None where it always was.

    >>> place = {"block": 0, "seat": 0, "part": "free", "town": "helsinki", "profile": "ataxic"}
    >>> undriven("mine", [EpisodeRecord(**place, status=REFUSED, reason="it has no weights")])
    ['mine: refused in 1 of 1 episode: it has no weights']
    """
    lines = []
    for status, word in ((REFUSED, "refused"), (POLICY_FAILED, "failed")):
        reasons = Counter(record.reason for record in records if record.status == status)
        if reasons:
            other = pluralize(len(reasons) - 1, "other reason")
            more = f" (and {other}, see episodes.json)" if len(reasons) > 1 else ""
            reason = " ".join(reasons.most_common(1)[0][0].split())
            of = pluralize(len(records), "episode")
            lines.append(
                f"{policy}: {word} in {reasons.total()} of {of}: {escape(reason, 400)}{more}"
            )
    return lines


def record_of(data: object) -> EpisodeRecord:
    """A record from `to_json`, whoever wrote it. Raises ConfigError for anything else."""
    if not isinstance(data, Mapping):
        raise ConfigError(f"got {escape_repr(data)}, expected an episode: {_AGAIN}")
    kinds = get_type_hints(EpisodeRecord)
    other = sorted(set(data) ^ set(kinds))
    if other:
        raise ConfigError(
            f"an episode without, or with an unknown, {escape(str(other[0]))}: {_AGAIN}"
        )
    for name, kind in kinds.items():
        if kind in _PLAIN and not _is(data[name], _PLAIN[kind]):
            raise ConfigError(
                f"{name} of an episode is {escape_repr(data[name])}, expected {kind.__name__}: "
                f"{_AGAIN}"
            )
    try:
        found = [Intervention(**item) for item in data["interventions"]]
        places = _points(data["path_m"]), _points([data["end_m"]])[0]
    except (TypeError, ValueError) as error:
        raise ConfigError(f"a part of an episode is damaged ({error}): {_AGAIN}") from None
    if data["status"] not in STATUSES:
        raise ConfigError(
            f"status {escape(data['status'])!r}; expected one of {', '.join(STATUSES)}: {_AGAIN}"
        )
    return EpisodeRecord(
        **{**data, "interventions": tuple(found), "path_m": places[0], "end_m": places[1]}
    )


def _is(value: object, expected: tuple[type, ...]) -> bool:
    if isinstance(value, bool) and bool not in expected:
        return False
    return isinstance(value, expected) and (
        not isinstance(value, int | float) or abs(value) <= _LARGEST
    )


def _points(items: Any) -> tuple[tuple[float, float], ...]:
    points = tuple((x, y) for x, y in items)
    if not all(_is(value, (int, float)) for point in points for value in point):
        raise ValueError("a place that is not two numbers")
    return points
