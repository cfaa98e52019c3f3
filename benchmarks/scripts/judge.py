"""`python -m benchmarks judge`: chairs before kerbs and anywhere, what each policy makes of them, and why it fails."""

from __future__ import annotations

import statistics
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from wcsim.cli.shared.common import Bounds, OutFile, split_nonempty_list, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.core.own_folder import create_temporary_folder

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from benchmarks.judge.forks import Asked
    from benchmarks.judge.kerb_places import KerbCase
    from benchmarks.judge.starts import Start


@dataclass
class KerbOptions:
    """Hold the stick before kerbs: who crashes, how long before it is warned, and which link broke first."""

    policies: str = "follow,dwa,oracle,oracle-visible"
    """Policies, separated by commas."""
    towns: str = "helsinki,monaco,manhattan"
    """Towns that share the starts: each a town's name, its folder, or a .sumocfg file, separated by commas."""
    anywhere: int = 0
    """Instead of the list of kerbs, so many starts for each town and chair on any ground, facing anywhere."""
    forks: int = 0
    """Instead, so many drives in each of twelve kinds of states: what is said of commands, held against the physics."""
    why: bool = False
    """Also find the first link from the picture to the command that did not hold."""
    seed: int = 0
    """Seed of traffic and places."""
    json: OutFile = None
    """Write every start to this file."""


def run(options: KerbOptions) -> int:
    """Run the bench."""
    Bounds(0, 1000).check("--anywhere", options.anywhere)
    Bounds(0, 1000).check("--forks", options.forks)

    from benchmarks.judge.forks import ask_everywhere
    from benchmarks.judge.starts import drive_list

    console, found = stdout_console(), list[Any]()
    towns, policies = (
        tuple(split_nonempty_list(f"--{what}", getattr(options, what))) for what in ("towns", "policies")
    )
    if options.forks:
        found += ask_everywhere(policies, towns, options.forks, options.seed)
        console.print(_verdicts(found))
    else:
        with create_temporary_folder() as work:
            for policy in policies:
                for start in drive_list(policy, towns, options.seed, work, options.anywhere, options.why):
                    found.append(start)
                    if start.driven.own:
                        console.print(told(start), style="dim", highlight=False, markup=False, soft_wrap=True)
        console.print(_table(found))
    if options.json is not None:
        write_json(options.json, [asdict(row) for row in found])
    return 0


def _verdicts(rows: list[Asked]) -> Table:
    """By kind and judge: what the physics says of the commands, and what the judge said."""
    table = Table("kind", "judge", "unsafe", "called safe", "95 %", "safe", "called unsafe", "hang, called unsafe",
                  "others hit", "s apart", box=box.SIMPLE_HEAD)  # fmt: skip
    groups = defaultdict(list)
    for row in rows:
        groups[row.kind, "oracle"].append((row, row.oracle_s is not None))
        if row.unsafe is not None:
            groups[row.kind, row.policy].append((row, row.unsafe))
    for (kind, judge), pairs in groups.items():
        bad = [(row, said) for row, said in pairs if row.end == "own"]
        good = [said for row, said in pairs if not row.end]
        hangs = [said for row, said in pairs if row.end == "hangs"]
        missed = sum(not said for _, said in bad)
        apart = [abs(row.oracle_s - row.physics_s) for row, _ in bad if row.oracle_s and row.physics_s]
        table.add_row(
            kind,
            judge,
            str(len(bad)),
            str(missed),
            _bound(missed, len(bad)),
            str(len(good)),
            f"{sum(good)} ({sum(good) / len(good):.1%})" if good else "-",
            f"{sum(hangs)} of {len(hangs)}",
            str(sum(row.end == "other" for row, _ in pairs)),
            f"{statistics.median(apart):.2f}" if apart and judge == "oracle" else "",
        )
    return table


def _bound(count: int, of: int) -> str:
    """Upper end of Wilson's 95 % interval."""
    from scipy.stats import binomtest

    return f"to {binomtest(count, of).proportion_ci(method='wilson').high:.1%}" if of else "-"


def told(start: Start) -> str:
    """A crash in a line."""
    driven, chain = start.driven, start.chain
    broke = "" if chain is None else f"; {chain.broke} broke, held until {chain.held_until_s} s before"
    return (
        f"{start.policy}, {start.town}, {start.plant}, kerbs {start.kerb_m:g} m, {start.case or start.stick}: "
        f"{driven.reason} after {driven.crash_s:.1f} s at {driven.speed_mps:.2f} m/s, {driven.words}{broke}"
    )


def _table(starts: list[Start]) -> Table:
    table = Table("policy", "starts", "own crashes", "95 %", "others'", "warned before", "steps taken", "links broken",
                  box=box.SIMPLE_HEAD)  # fmt: skip
    groups = defaultdict(list)
    for start in starts:
        groups[start.policy].append(start)
        if start.case is not None:
            groups[f"  {_cell(start.case)}, {start.policy}"].append(start)
    for name, group in groups.items():
        own = [start for start in group if start.driven.own]
        ahead = [s.driven.ahead_s for s in own if s.driven.ahead_s is not None]
        broke = Counter(start.chain.broke for start in own if start.chain is not None)
        table.add_row(
            name,
            str(len(group)),
            str(len(own)),
            _bound(len(own), len(group)),
            str(sum(start.driven.fault == "other" for start in group)),
            f"{len(ahead)}, {sum(ahead) / len(ahead):.1f} s" if ahead else "-",
            f"{sum(s.driven.taken_steps for s in group) / sum(s.driven.steps for s in group):.0%}",
            ", ".join(f"{link} {count}" for link, count in broke.most_common()),
        )
    return table


def _cell(case: KerbCase) -> str:
    side = "up" if case.below else "off"
    return f"{side} {'backwards' if case.backwards else f'{case.angle_deg:g} deg'}"
