"""The columns of a test's tables, on a console and on a page: what each is called, and what it says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:  # loads much, which --help must not
    from wcsim.agents.evaluation.suite.rows import ResultRow


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of a result's table."""

    heading: str
    key: str  # of `ResultRow`
    says: str
    form: str = "{:d}"
    interval: str = ""  # key of the interval that stands beside the figure
    short: str = ""  # the heading on a console, whose tables have 80 characters; "" where it is on pages alone

    def value(self, row: ResultRow) -> Any:
        """The figure of a row; None where nothing was measured, or no episode counts as an attempt to arrive."""
        return None if self.key == "arrivals" and not row.attempts else getattr(row, self.key)


SAFETY: Final = (
    Column(heading="episodes", key="episodes", says="all count, however they ended", short="episodes"),
    Column(heading="km", key="km", says="distance driven", form="{:.2f}", short="km"),
    Column(heading="own crashes", key="crashes_own", says="crashes and falls by the chair's fault", short="own\ncrash"),
    Column(
        heading="own crashes per km",
        key="crashes_per_km",
        interval="crashes_per_km_ci",
        says="with Garwood's interval",
        form="{:.2f}",
        short="own\nper km",
    ),
    Column(heading="crashes by others", key="crashes_other", says="crashes by another's fault", short="other\ncrash"),
    Column(heading="falls off kerbs", key="drops", says="also counted as own crashes", short="drops"),
    Column(
        heading="red lights",
        key="red_entries",
        says="times that the chair entered a crossing at red",
        short="at\nred",
    ),
    Column(
        heading="without a crash",
        key="alive_at_end",
        interval="alive_at_end_ci",
        says="share of episodes that were driven to their end without any crash",
        form="{:.0%}",
    ),
    Column(
        heading="saved",
        key="saved",
        says="episodes with an own crash of the user alone, and none with the policy",
        short="saved",
    ),
    Column(
        heading="lost",
        key="lost",
        says="episodes with an own crash with the policy, and none of the user alone",
        short="lost",
    ),
    Column(heading="p", key="mcnemar_p", says="McNemar's exact p-value of saved against lost", form="{:.2g}"),
)
FOLLOWING: Final = (
    Column(
        heading="KPI 1",
        key="kpi1",
        says="mean distance between the driven and the user's stick, over all steps",
        form="{:.3f}",
        short="KPI 1",
    ),
    Column(
        heading="within 0.1768",
        key="kpi1_within",
        says="share of all steps within 0.1768 of the user's command",
        form="{:.0%}",
        short="close\nto\nuser",
    ),
    Column(
        heading="KPI 1, free steps",
        key="kpi1_free",
        says="over steps without danger",
        form="{:.3f}",
        short="KPI 1\nfree\nsteps",
    ),
    Column(
        heading="KPI 1, moving free steps",
        key="kpi1_moving",
        says="over steps without danger in which the user's stick is out",
        form="{:.3f}",
        short="KPI 1\nfree,\nmoving",
    ),
    Column(
        heading="close to user",
        key="kpi1_free_within",
        interval="kpi1_free_within_ci",
        says="obedience: share of moving steps without danger within 0.1768 of the user's command",
        form="{:.1%}",
        short="close,\nfree,\nmoving",
    ),
    Column(
        heading="free steps",
        key="free_share",
        says="share of steps without danger",
        form="{:.0%}",
        short="free\nsteps",
    ),
    Column(
        heading="blocked",
        key="blocked_share",
        says="share of steps without danger that give less than half of the user's push ahead",
        form="{:.1%}",
        short="blocked",
    ),
    Column(
        heading="times frozen",
        key="freezes",
        says="stood for 3 s or more while the user's stick was out",
        short="times\nfrozen",
    ),
    Column(heading="KPI 2, mean", key="kpi2", says="steps of an episode, mean", form="{:.0f}", short="KPI 2\nsteps"),
    Column(heading="KPI 2, median", key="kpi2_median", says="steps of an episode, median", form="{:.0f}"),
)
SERVICE: Final = (
    Column(
        heading="score",
        key="score",
        interval="score_ci",
        says="0 after an own crash or a red light, else share of the route x pace x obedience, without a route "
        "obedience alone; mean over episodes",
        form="{:.3f}",
        short="score",
    ),
    Column(
        heading="arrivals",
        key="arrivals",
        says="episodes of the parts free and crossing that reached their destination; not counted in other parts",
        short="arrivals",
    ),
    Column(
        heading="goals",
        key="goals",
        says="destinations reached, also of episodes that go on to another",
        short="goals\ndone",
    ),
    Column(heading="given up", key="given_up", says="destinations that the user gave up", short="given\nup"),
    Column(heading="crossings", key="crossings", says="crossings completed", short="cross-\nings"),
    Column(heading="speed, m/s", key="speed_mps", says="mean", form="{:.2f}", short="m/s"),
    Column(
        heading="seconds on road",
        key="road_s",
        says="time of standing on a carriageway",
        form="{:.0f}",
        short="s on\nroad",
    ),
    Column(heading="help", key="helps", says="times that the user asked for help", short="help"),
)
JUDGED: Final = (
    Column(
        heading="interventions",
        key="interventions",
        says="stretches in which the policy did not do what was requested, in all episodes",
        short="interventions",
    ),
    Column(
        heading="missed crashes",
        key="missed",
        says="own crashes without an intervention in the last 5 s",
        short="missed\ncrashes",
    ),
    Column(
        heading="judged episodes",
        key="judged_episodes",
        says="their interventions were judged in copies of the world in which the user drives on alone",
        short="judged\nepisodes",
    ),
    Column(
        heading="needed",
        key="needed",
        says="judged interventions without which the user crashes within 5 s",
        short="needed",
    ),
    Column(
        heading="unneeded",
        key="needless",
        says="judged interventions without which nothing happens within 5 s",
        short="unneeded",
    ),
    Column(
        heading="warned in time",
        key="warned_share",
        says="share of dangers with a warning at least 1 s ahead; 0 % if the policy cannot warn",
        form="{:.0%}",
        short="warned\nin time",
    ),
    Column(
        heading="false warnings per km",
        key="false_warnings_per_km",
        says="warnings that no danger follows",
        form="{:.0f}",
        short="false\nwarnings\nper km",
    ),
)
GROUPS: Final = {
    "safety": SAFETY,
    "following": FOLLOWING,
    "service": SERVICE,
    "interventions and warnings": JUDGED,
}
COLUMNS: Final = tuple(column for columns in GROUPS.values() for column in columns)
