"""`wcsim test --suite` and `--make-suite`: policies judged on a fixed list of episodes, and lists for any town."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from wcsim.agents.policies.baseline_names import NAMES, UPPER_BOUNDS
from wcsim.cli.shared.common import OutFile, OutFolder, Repeated, check_folder, in_bounds, parse, write_json
from wcsim.errors import ConfigError

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.evaluation.suite.records import EpisodeRecord

MOST_JOBS = 256
CLEAN = (
    "cameras.0.noise=none",
    "world.action_delay_ticks=0",
)
Column = tuple[str, str, str]
_SAFE: tuple[Column, ...] = (
    ("episodes", "epi-\nsodes", "{:d}"),
    ("km", "\nkm", "{:.2f}"),
    ("crashes_own", "own\ncrash", "{:d}"),
    ("crashes_per_km", "own\n/km", "{:.2f}"),
    ("crashes_per_km_ci", "\n95 %", "{0:.1f}-{1:.1f}"),
    ("crashes_other", "other\ncrash", "{:d}"),
    ("drops", "\ndrops", "{:d}"),
    ("red_entries", "at\nred", "{:d}"),
    ("missed", "\nmissed", "{:d}"),
    ("saved", "\nsaved", "{:d}"),
    ("lost", "\nlost", "{:d}"),
)
_THERE: tuple[Column, ...] = (
    ("kpi1_free_within", "\nwithin", "{:.1%}"),
    ("blocked_share", "\nblocked", "{:.1%}"),
    ("freezes", "\nfroze", "{:d}"),
    ("needed", "\nneeded", "{:d}"),
    ("needless", "need-\nless", "{:d}"),
    ("speed_mps", "\nm/s", "{:.2f}"),
    ("arrivals", "arri-\nvals", "{:d}"),
    ("road_s", "s on\nroad", "{:.0f}"),
    ("score", "\nscore", "{:.3f}"),
    ("score_ci", "\n95 %", "{0:.2f}-{1:.2f}"),
)


@dataclass
class SuiteOptions:
    """Judge policies on a fixed list of episodes: free ways, crossings, hazards, tight places."""

    policies: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[POLICY ...]")] = ()
    """Run folders, policy folders, module:Class, or baselines; the baselines are added unless --only."""
    suite: str = ""
    """The list: the name of one that comes with wcsim, or a file of --make-suite."""
    jobs: int = 1
    """Processes that drive side by side; the result is the same for any number."""
    out: OutFolder = None
    """Folder for the result and what is kept of it. (default: runs/suite-SET)"""
    resume: bool = False
    """Go on in a folder where some of it has been driven."""
    only: bool = False
    """Drive these policies and the user alone, without the other baselines."""
    clean: bool = False
    """Turn every perturbation off: no noise, no delay."""
    forks: int = 1_000_000
    """Episodes whose interventions are judged by letting the user drive alone from there, evenly spread."""
    preset: str = "quick"
    """Settings of policies that bring none."""
    set: Repeated = ()
    """section.key=value, laid over those of the list; the result says so."""
    network: str = ""
    """Your own network as module:Class, for runs that were trained with it."""
    json: OutFile = None
    """Write the result to this file, too."""


@dataclass
class MakeOptions:
    """Make a list of test episodes for towns of your own."""

    make_suite: str
    """Towns, joined by commas."""
    suite_file: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("suite.json")
    """The list to write."""
    name: str = "own-suite-v1"
    """What it is called, with its version."""
    free: int = 8
    """Blocks of free ways for each town, six ways each."""
    attempts: int = 40
    """Attempts at crossings for each town."""
    hazards: int = 30
    """Starts that end in a crash of the user alone, at most, for each town."""
    tight: int = 5
    """Generated scenes of each family of tight places."""
    tight_from: int = 0
    """Their first seed."""
    jobs: int = 1
    """Processes that drive side by side."""
    seed: int = 0
    """Seed of the list."""


def run_suites(words: list[str]) -> int:
    """Judge policies on a list; a table for each part and one for all."""
    options = parse(SuiteOptions, words, "test")
    in_bounds("--jobs", options.jobs, 1, MOST_JOBS)
    in_bounds("--forks", options.forks, 0, 1_000_000)
    from wcsim.agents.evaluation.suite.list_file import open_suite

    suite = open_suite(options.suite)
    out = options.out or Path("runs") / f"suite-{suite.file.set}"
    check_folder("--out", out / "x")
    if (out / "kept").exists() and not options.resume:
        raise ConfigError(
            f"--out {out}: something has been driven there; say --resume to go on, or name another folder"
        )
    from wcsim.agents.evaluation.suite.run import UNAIDED, SuiteOrder, run_suite

    added = () if options.only else (*NAMES, *UPPER_BOUNDS)
    names = tuple(dict.fromkeys((UNAIDED, *options.policies, *added)))
    changed = (*(CLEAN if options.clean else ()), *options.set)
    order = SuiteOrder(
        suite=suite,
        out=out,
        jobs=options.jobs,
        preset=options.preset,
        settings=changed,
        network=options.network,
        forks=options.forks,
    )
    told = Console(stderr=True, highlight=False)
    told.print(f"{suite.file.suite} {suite.file.set}, list {suite.sha256[:12]}: {suite.episodes} episodes a policy")
    records = run_suite(order, names, lambda name, done, of: told.print(f"{name}: {done} of {of} blocks", style="dim"))
    result = _result(suite.file, suite.sha256, records, changed)
    write_json(out / "result.json", result)
    write_json(out / "episodes.json", {name: [record.to_json() for record in found] for name, found in records.items()})
    _show(Console(), result, changed)
    if options.json is not None:
        write_json(options.json, result)
    return 0


def make_list(words: list[str]) -> int:
    """Make a list and write it."""
    options = parse(MakeOptions, words, "test")
    in_bounds("--jobs", options.jobs, 1, MOST_JOBS)
    in_bounds("--free", options.free, 1, 10_000)
    in_bounds("--attempts", options.attempts, 1, 10_000)
    in_bounds("--hazards", options.hazards, 0, 10_000)
    in_bounds("--tight", options.tight, 0, 10_000)
    in_bounds("--tight-from", options.tight_from, 0, 1_000_000)
    check_folder("--suite-file", options.suite_file)
    import tempfile

    from wcsim.agents.evaluation.suite.list_file import suite_of, write_list
    from wcsim.agents.evaluation.suite.make import MakeOrder, make_suite
    from wcsim.towns.scenario.town import find_town

    told = Console(stderr=True, highlight=False)
    towns = [find_town(name) for name in options.make_suite.split(",")]
    with tempfile.TemporaryDirectory(prefix="wcsim-suite-") as work:
        order = MakeOrder(
            suite=options.name,
            set=options.suite_file.stem,
            seed=options.seed,
            free_blocks=options.free,
            attempts=options.attempts,
            hazards=options.hazards,
            tight=range(options.tight_from, options.tight_from + options.tight),
            jobs=options.jobs,
            work=Path(work),
        )
        file = make_suite(order, towns, lambda text: told.print(text, style="dim"))
    write_list(file, options.suite_file)
    suite = suite_of(file)
    Console().print(
        f"{options.suite_file}: {suite.episodes} episodes in {len(file.blocks)} blocks, {suite.sha256[:12]}"
    )
    return 0


def _result(
    file: Any, sha256: str, records: Mapping[str, Sequence[EpisodeRecord]], changed: Sequence[str]
) -> dict[str, Any]:
    from wcsim.agents.evaluation.suite.rows import pooled_rows, result_of
    from wcsim.agents.evaluation.suite.run import UNAIDED

    rows, pooled = [], []
    for name, found in records.items():
        parts, whole = pooled_rows(name, found, records[UNAIDED])
        rows += parts
        pooled.append(whole)
    return {**result_of(file, sha256, rows, pooled), "changed": list(changed)}


def _show(console: Console, result: Mapping[str, Any], changed: Sequence[str]) -> None:
    version = f"{result['suite']} {result['set']}{' CHANGED by ' + ' '.join(changed) if changed else ''}"
    for part in [*dict.fromkeys(row["part"] for row in result["rows"]), ""]:
        rows = [row for row in (result["rows"] if part else result["pooled"]) if row["part"] == part]
        title = f"{version}: {part or 'all parts'}"
        console.print(_table(f"{title}, safety", _SAFE, rows), _table(f"{title}, service", _THERE, rows))
    console.print("saved, lost: own crashes that the user alone has and the policy has not, and the other way round")
    console.print("SIMULATION ONLY: these figures say nothing about a real street.", style="dim")


def _table(title: str, columns: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 0), pad_edge=False)
    table.add_column("\npolicy", no_wrap=True)
    for _, heading, _ in columns:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(str(row["policy"]), *(_cell(row.get(key), text) for key, _, text in columns))
    return table


def _cell(value: Any, text: str) -> str:
    if value is None:
        return "-"
    return text.format(*value) if isinstance(value, list) else text.format(value)
