"""The columns of a test's tables, on a console and on a page: what each is called, and what it says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:  # loads much, which --help must not
    from wcsim.agents.evaluation.suite.rows import ResultRow


@dataclass(frozen=True, slots=True)
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
    Column("episodes", "episodes", "all count, however they ended", short="episodes"),
    Column("km", "km", "distance driven", form="{:.2f}", short="km"),
    Column("own crashes", "crashes_own", "crashes and falls by the chair's fault", short="own\ncrash"),
    Column(
        "own crashes per km",
        "crashes_per_km",
        "with Garwood's interval",
        interval="crashes_per_km_ci",
        form="{:.2f}",
        short="own\nper km",
    ),
    Column("crashes by others", "crashes_other", "crashes by another's fault", short="other\ncrash"),
    Column("falls off kerbs", "drops", "also counted as own crashes", short="drops"),
    Column("red lights", "red_entries", "times that the chair entered a crossing at red", short="at\nred"),
    Column(
        "without a crash",
        "alive_at_end",
        "share of episodes that were driven to their end without any crash",
        interval="alive_at_end_ci",
        form="{:.0%}",
    ),
    Column("saved", "saved", "episodes with an own crash of the user alone, and none with the policy", short="saved"),
    Column("lost", "lost", "episodes with an own crash with the policy, and none of the user alone", short="lost"),
    Column("p", "mcnemar_p", "McNemar's exact p-value of saved against lost", form="{:.2g}"),
)
FOLLOWING: Final = (
    Column(
        "KPI 1",
        "kpi1",
        "mean distance between the driven and the user's stick, over all steps",
        form="{:.3f}",
        short="KPI 1",
    ),
    Column(
        "within 0.1768",
        "kpi1_within",
        "share of all steps within 0.1768 of the user's command",
        form="{:.0%}",
        short="close\nto\nuser",
    ),
    Column("KPI 1, free steps", "kpi1_free", "over steps without danger", form="{:.3f}", short="KPI 1\nfree\nsteps"),
    Column(
        "KPI 1, moving free steps",
        "kpi1_moving",
        "over steps without danger in which the user's stick is out",
        form="{:.3f}",
        short="KPI 1\nfree,\nmoving",
    ),
    Column(
        "close to user",
        "kpi1_free_within",
        "obedience: share of moving steps without danger within 0.1768 of the user's command",
        interval="kpi1_free_within_ci",
        form="{:.1%}",
        short="close,\nfree,\nmoving",
    ),
    Column("free steps", "free_share", "share of steps without danger", form="{:.0%}", short="free\nsteps"),
    Column(
        "blocked",
        "blocked_share",
        "share of steps without danger that give less than half of the user's push ahead",
        form="{:.1%}",
        short="blocked",
    ),
    Column("times frozen", "freezes", "stood for 3 s or more while the user's stick was out", short="times\nfrozen"),
    Column("KPI 2, mean", "kpi2", "steps of an episode, mean", form="{:.0f}", short="KPI 2\nsteps"),
    Column("KPI 2, median", "kpi2_median", "steps of an episode, median", form="{:.0f}"),
)
SERVICE: Final = (
    Column(
        "score",
        "score",
        "0 after an own crash or a red light, else share of the route x pace x obedience, without a route "
        "obedience alone; mean over episodes",
        interval="score_ci",
        form="{:.3f}",
        short="score",
    ),
    Column(
        "arrivals",
        "arrivals",
        "episodes of the parts free and crossing that reached their destination; not counted in other parts",
        short="arrivals",
    ),
    Column("goals", "goals", "destinations reached, also of episodes that go on to another", short="goals\ndone"),
    Column("given up", "given_up", "destinations that the user gave up", short="given\nup"),
    Column("crossings", "crossings", "crossings completed", short="cross-\nings"),
    Column("speed, m/s", "speed_mps", "mean", form="{:.2f}", short="m/s"),
    Column("seconds on road", "road_s", "time of standing on a carriageway", form="{:.0f}", short="s on\nroad"),
    Column("help", "helps", "times that the user asked for help", short="help"),
)
JUDGED: Final = (
    Column(
        "interventions",
        "interventions",
        "stretches in which the policy did not do what was requested, in all episodes",
        short="interventions",
    ),
    Column("missed crashes", "missed", "own crashes without an intervention in the last 5 s", short="missed\ncrashes"),
    Column(
        "judged episodes",
        "judged_episodes",
        "their interventions were judged in copies of the world in which the user drives on alone",
        short="judged\nepisodes",
    ),
    Column("needed", "needed", "judged interventions without which the user crashes within 5 s", short="needed"),
    Column("unneeded", "needless", "judged interventions without which nothing happens within 5 s", short="unneeded"),
    Column(
        "warned in time",
        "warned_share",
        "share of dangers with a warning at least 1 s ahead; 0 % if the policy cannot warn",
        form="{:.0%}",
        short="warned\nin time",
    ),
    Column(
        "false warnings per km",
        "false_warnings_per_km",
        "warnings that no danger follows",
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
