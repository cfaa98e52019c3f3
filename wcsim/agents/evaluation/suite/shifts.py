"""Shifts of a list: the same episodes under one change each, with certificates of their own.

What a policy loses there, and whether the order of the policies stays, says how far its figures
carry. As Fail2Drive does it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from wcsim.agents.evaluation.suite.intervals import Interval, bootstrapped
from wcsim.agents.evaluation.suite.records import CRASHED, Records, undriven
from wcsim.agents.evaluation.suite.rows import ResultRow, row_of
from wcsim.agents.evaluation.suite.run import Done, SuiteOrder, run_suite
from wcsim.agents.opening.list_file import HashedSuite, suite_from_file
from wcsim.agents.policy_api import UNAIDED
from wcsim.errors import TownError

CLEAN: Final = ("cameras.0.noise=none", "world.action_delay_ticks=0")
AS_LISTED: Final = "as listed"

Report = Callable[[str], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """What is other than in the list."""

    settings: tuple[str, ...] = ()
    profile: str = ""  # of every user
    overrules: bool = False  # users take over for a while after needless interventions


SHIFTS: Final[Mapping[str, Shift]] = {
    AS_LISTED: Shift(),
    "eyes: usual": Shift(settings=("cameras.0.noise.objects=usual",)),
    "eyes: poor": Shift(settings=("cameras.0.noise.objects=poor",)),
    "others: careless": Shift(settings=("world.street=careless",)),
    "others: JuPedSim": Shift(settings=("world.street=jupedsim",)),
    "person: measured hands": Shift(profile="recorded"),
    "person: tremor": Shift(profile="tremor"),
    "person: overrules": Shift(overrules=True),
    "chair: measured": Shift(settings=("chair.plant=whill",)),
    "chair: mid-wheel": Shift(settings=("chair.plant=mwd",)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftRow:
    """A policy's row on a shift, and what it loses there."""

    shift: str
    row: ResultRow
    left_out: int  # episodes, in which no copy of the world survived the user's crash
    loss: float | None  # of score, mean over the same episodes; None where nothing is scored
    loss_ci: Interval | None
    tau: float | None  # Kendall's, of the order of the policies by score, as listed and here

    def to_json(self) -> dict[str, Any]:
        """Plain values: the row's, and its own under the same names."""
        names = ("shift", "left_out", "loss", "loss_ci", "tau")
        return self.row.to_json() | {name: getattr(self, name) for name in names}


def drive_shifts(order: SuiteOrder, policies: Sequence[str], report: Report) -> list[ShiftRow]:
    """Drive a list and each of its shifts; a row for each policy and shift that it can have.

    Raises what `run_suite` raises.
    """
    rows: list[ShiftRow] = []
    listed: Mapping[str, Records] = {}
    for name, shift in SHIFTS.items():
        changed = replace(
            order,
            suite=_with_profile(order.suite, shift.profile),
            settings=(*order.settings, *shift.settings),
            overrules=shift.overrules,
        )
        try:
            driven = run_suite(changed, policies, _progress(report, name))
        except TownError as error:
            # In some towns JuPedSim dies: a list without that shift says more than none.
            if not listed or "world.street=jupedsim" not in shift.settings:
                raise
            report(f"{name}: left out: {error}")
            continue
        for policy, records in driven.items():
            for line in undriven(policy, records):
                report(f"{name}: {line}")
        listed = listed or driven
        rows += _rows(name, driven, listed)
    return rows


def _rows(
    shift: str, driven: Mapping[str, Records], listed: Mapping[str, Records]
) -> list[ShiftRow]:
    """A row for each policy, less the draws in which nobody could have survived."""
    from scipy.stats import kendalltau

    fair = [
        not e.judged or e.status != CRASHED or e.last_moment_s is not None
        for e in driven.get(UNAIDED, ())
    ]
    rows = []
    scores = []
    for policy, records in driven.items():
        drives = zip(records, listed[policy], fair, strict=True)
        pairs = [(now, then) for now, then, is_fair in drives if is_fair and now.counts]
        scored = [(then.score, now.score) for now, then in pairs if then.counts]
        both = np.array(scored, np.float64).reshape(-1, 2)
        # Ways have no score.
        both = both[np.isfinite(both).all(1)]
        losses = -np.diff(both).ravel()
        if both.size:
            scores.append(both.mean(0))
        rows.append(
            ShiftRow(
                shift=shift,
                row=row_of(policy, "", [now for now, _ in pairs], ()),
                left_out=fair.count(False),
                loss=losses.mean().item() if both.size else None,
                loss_ci=bootstrapped(losses),
                tau=None,
            )
        )
    # The order of the policies as listed, and here, where there is one.
    tau = None
    if scores and np.ptp(scores, axis=0).all():
        tau = kendalltau(*np.transpose(scores)).statistic.item()
    return [replace(each, tau=tau) for each in rows]


def _with_profile(suite: HashedSuite, profile: str) -> HashedSuite:
    """The list with another user in every episode."""
    if not profile:
        return suite
    blocks = [
        block.model_copy(
            update={
                "episodes": tuple(
                    each.model_copy(update={"profile": profile}) for each in block.episodes
                )
            }
        )
        for block in suite.file.blocks
    ]
    return suite_from_file(suite.file.model_copy(update={"blocks": tuple(blocks)}))


def _progress(report: Report, name: str) -> Done:
    return lambda policy, done, of: report(f"{name}: {policy}, {done} of {of} blocks")
