"""Policies judged on a list of episodes: `wcsim test --suite`, and lists: `--make-suite`.

`run_suite_and_report`, `run_suite_and_save`, `make_suite_order` and `save_test_result` also serve
`wcsim test --town`, `demo` and `train-clients`.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from rich.table import Column
from tyro.conf import Positional, arg

from wcsim.agents.opening.named_policy import resolve_policy_config
from wcsim.agents.policy_api import BASELINES, UNAIDED, UPPER_BOUNDS
from wcsim.cli.evaluation.result_tables import print_shifts, print_test_result
from wcsim.cli.shared import common
from wcsim.cli.shared.consoles import (
    StageBar,
    print_note,
    show_table,
    stderr_console,
    stdout_console,
)
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.config.suite import MOST_SET, make_suite_name_pattern
from wcsim.core import seeding
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import escape, is_file, pluralize
from wcsim.errors import ConfigError, InterruptedRunError
from wcsim.server.workers.scheduler import WorkerStatus

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.evaluation.suite.records import EpisodeRecord
    from wcsim.agents.evaluation.suite.result_files import TestResult
    from wcsim.agents.evaluation.suite.rows import ResultRow
    from wcsim.agents.evaluation.suite.run import SuiteOrder
    from wcsim.agents.opening.list_file import HashedSuite


# These drive beside the policies, unless --only.
_OTHERS: Final = (*BASELINES, *UPPER_BOUNDS)
_LISTED: Final = {
    "env.profile": (
        "each episode of a list has its own user; choose it with --town and --profile, no --suite"
    ),
    "env.max_steps": (
        "each episode of a list has its own step limit; set it with --town and --max-steps, "
        "no --suite"
    ),
}
# A line about the workers of other machines, each with what it drives.
_WORKERS_EVERY_S: Final = 20.0
# Blocks, until it is looked at again whether a test is decided.
_DECIDED_EVERY: Final = 10
# Of an episode that is played again: its end is filmed, and every so often a row is printed.
_PLACE: Final = re.compile(r"([0-9]{1,6})\.([0-9]{1,3})")
_FILMED_S: Final = 10.0
_ROW_EVERY_S: Final = 0.5
_MAP_PX: Final = 480
_MAP_SPAN_M: Final = 30.0


@dataclass
class _DriveOptions:
    """What drives a list, whether it comes with wcsim, lies in a file or is drawn for a town."""

    policies: Annotated[tuple[str, ...], Positional, arg(metavar="[POLICY ...]")] = ()
    """Runs (RUN, RUN:phase1), policy folders, module:Class, or baselines. All baselines are added unless --only."""  # noqa: E501
    jobs: common.Jobs = 1
    """Parallel processes; the result is the same for any number."""
    cluster: common.Cluster = ""
    """HOST:PORT of a Ray cluster whose nodes drive, or `local`; the result is the same (docs/cluster.md)."""  # noqa: E501
    out: common.OutFolder = None
    """Folder for the result and for finished blocks. (default: runs/suite-SET; none with --town)"""
    resume: bool = False
    """Continue in a folder that holds finished blocks of this test."""
    preset: str = "quick"
    """Settings of policies that have none. Its rules for street, chair and crashes apply to all policies."""  # noqa: E501
    set: common.Repeated = ()
    """section.key=value, over the settings of the list; the result names it."""
    network: str = ""
    """Your own network as module:Class, for runs that were trained with it."""


@dataclass
class SuiteTestOptions(_DriveOptions):
    """Who is judged on a list, and how."""

    only: common.Flag = False
    """Drive only these policies and the user alone, no other baselines."""
    together: common.Flag = False
    """Drive these policies in one street at a time: they take turns in its chairs. As with --only, no baselines."""  # noqa: E501
    forks: Annotated[int | None, common.Bounds(0, 1_000_000)] = None
    """Episodes whose interventions are judged: the user drives on alone in a copy.
    (default: as in the list; 0 with --town)"""
    until_decided: common.Flag = False
    """Drive blocks in a random order, until crashes tell the first policy from the second or the user alone."""  # noqa: E501
    json: common.OutFile = None
    """Also write the result to this file."""


@dataclass
class _OfSuite(_DriveOptions):
    """A fixed list."""

    set: Annotated[common.Repeated, common.AllowedSettingKeys(_LISTED)] = ()
    """section.key=value, over the settings of the list; the result names it."""
    suite: str = ""
    """The list: one that comes with wcsim (guard, hard, dev2, validation2, demo, v1), or a file of --make-suite."""  # noqa: E501


@dataclass
class _SuiteOptions(_OfSuite, SuiteTestOptions):
    """Test policies on a fixed list of routes, crossings, hazards and tight places.

    With `--sensitivity` they drive its shifts, too: what does each change cost?
    With `--play BLOCK.SEAT` one policy drives that episode again.
    """

    clean: bool = False
    """Turn off camera noise and delay; IMU and odometry keep their errors."""


@dataclass
class _SensitivityOptions(_OfSuite):
    """Drive a list and its shifts with these policies and the user alone."""

    sensitivity: common.Flag = False
    """Other eyes, other road users, other persons, other chairs: what does each cost?"""
    json: common.OutFile = None
    """Also write the rows to this file."""


@dataclass
class _PlayedEpisodeOptions(_OfSuite):
    """Drive an episode of one policy again, film its last 10 s into --out, and print what happened."""  # noqa: E501

    play: Annotated[str, arg(metavar="BLOCK.SEAT")] = ""
    """The episode."""
    clean: bool = False
    """Turn off camera noise and delay; IMU and odometry keep their errors."""


def run_suites(words: list[str]) -> int:
    """Judge policies on a list; tables for each part and for all."""
    if common.has_option(words, "--play"):
        play = common.parse_options(_PlayedEpisodeOptions, words, "test")
        return _play_episode(_suite_order(play, clean=play.clean), play.policies, play.play)
    if common.has_option(words, "--sensitivity"):
        return _compare_shifts(common.parse_options(_SensitivityOptions, words, "test"))
    options = common.parse_options(_SuiteOptions, words, "test")
    return run_suite_and_report(
        _suite_order(options, options.forks, clean=options.clean), options, options.suite
    )


def run_suite_and_report(order: SuiteOrder, options: SuiteTestOptions, name: str) -> int:
    """Drive a list with the user alone, the policies and, unless `--only`, all baselines; print it.

    Args:
        order: How.
        options: As typed.
        name: The list, as it was typed.
    """
    result = run_suite_and_save(order, options, name)
    from wcsim.agents.evaluation.suite.records import undriven
    from wcsim.view.report.comparisons import verdict

    without = [
        line for policy, found in result.episodes.items() for line in undriven(policy, found)
    ]
    print_test_result(stdout_console(), result, without, verdict(result))
    common.write_json(options.json, result.to_json())
    return _exit_of(result.pooled)


def run_suite_and_save(order: SuiteOrder, options: SuiteTestOptions, name: str) -> TestResult:
    """The result of a list that `run_suite_and_report` drives; it is written into its folder."""
    from wcsim.agents.evaluation.suite.intervals import is_decided
    from wcsim.agents.evaluation.suite.records import saved_and_lost
    from wcsim.agents.evaluation.suite.run import run_suite

    if options.together:
        order = replace(order, together=tuple(dict.fromkeys(options.policies)))
        if len(order.together) < 2 or options.cluster or options.until_decided:
            raise ConfigError(
                f"--together with {pluralize(len(order.together), 'name')}; expected two or more "
                "policies, no --cluster and no --until-decided"
            )
    _require_usable(order, options)
    others = () if options.only or options.together else _OTHERS
    policies = tuple(dict.fromkeys((UNAIDED, *options.policies, *others)))
    pair = (*dict.fromkeys((*options.policies, UNAIDED)), UNAIDED)[:2]
    done = 0
    with StageBar("testing") as bar, _resumable(order, options):

        def show(policy: str, blocks: int, of: int) -> None:
            nonlocal done
            done += 1
            bar.show(
                min(1.0, done / (of * (len(policies) - len(order.together[1:])))),
                f"{policy}: {blocks} of {of} blocks",
            )
            if not bar.console.is_terminal:
                bar.print_line(f"{policy}: {blocks} of {of} blocks")

        blocks = len(order.suite.file.blocks)
        mixed = seeding.make_rng(0, "decided", order.suite.sha256).permutation(blocks).tolist()
        step = _DECIDED_EVERY if options.until_decided else blocks
        for many in range(step, blocks + step, step):
            # Blocks of the last turn are read from its folder.
            records = run_suite(order, policies, show, mixed[:many])
            if options.until_decided and is_decided(
                *saved_and_lost(*(records[each] for each in pair))
            ):
                # Ranges and p-values of a test that stopped so are too narrow: its result says it.
                stopped = f"{order.suite.file.set}, {min(many, blocks)} of {blocks} blocks"
                file = order.suite.file.model_copy(update={"set": stopped})
                order = replace(order, suite=replace(order.suite, file=file))
                break
        return save_test_result(order, name, records)


def make_suite_order(
    options: _DriveOptions, suite: HashedSuite, out: Path, forks: int | None = None
) -> SuiteOrder:
    """How these options drive a list into a folder."""
    from wcsim.agents.evaluation.suite.run import SuiteOrder

    shown_s = time.monotonic()

    def show_workers(workers: tuple[WorkerStatus, ...]) -> None:
        nonlocal shown_s
        if options.cluster and time.monotonic() - shown_s > _WORKERS_EVERY_S:
            shown_s = time.monotonic()
            busy = (
                (each.name, f"{each.key} for {each.for_s:.0f} s" if each.key else "free")
                for each in workers
            )
            print_note(", ".join(f"{worker} {what}" for worker, what in busy))

    machines = common.workers_from_options(options.cluster, options.jobs, "--jobs")
    return SuiteOrder(
        suite=suite,
        out=out,
        jobs=options.jobs,
        machines=replace(machines, report=print_note),
        look=show_workers,
        preset=options.preset,
        settings=options.set,
        network=options.network,
        forks=suite.file.forks if forks is None else forks,
        shared=True,
    )


def save_test_result(
    order: SuiteOrder, name: str, records: Mapping[str, Sequence[EpisodeRecord]]
) -> TestResult:
    """Write what a test leaves in its folder; the result.

    Args:
        order: What was driven.
        name: The list, as it was typed.
        records: Of the user alone and of the policies.

    Raises:
        DiskFullError: There is no room.
    """
    from wcsim.agents.evaluation.suite.result_files import ASKED, EPISODES, RESULT, result_of

    typed = {"preset": order.preset, "network": order.network, "out": str(order.out)}
    result = result_of(
        records,
        suite=order.suite.file.suite,
        set=order.suite.file.set,
        list_sha256=order.suite.sha256,
        changed=order.settings,
        list_name=name,
        **typed,
    )
    contents = {
        RESULT: result.to_json(),
        EPISODES: {
            policy: [record.to_json() for record in found] for policy, found in records.items()
        },
        ASKED: {"suite": name, **typed},
    }
    # All files are written before one is replaced: a full disk leaves an earlier test as it was.
    with ExitStack() as opened:
        for file, content in contents.items():
            part = opened.enter_context(common.write_result_atomically(order.out / file))
            # Of many records half of the file would be blanks.
            indent = None if file == EPISODES else 2
            part.write_text(common.format_json(order.out / file, content, indent), encoding="utf-8")
    return result


def _suite_order(options: _OfSuite, forks: int | None = None, *, clean: bool = False) -> SuiteOrder:
    """How a fixed list is driven."""
    from wcsim.agents.evaluation.suite.shifts import CLEAN
    from wcsim.agents.opening.list_file import open_suite

    suite = open_suite(options.suite)
    out = options.out or Path("runs") / f"suite-{suite.file.set}"
    common.require_writable_folder("--out", out / "x")
    order = make_suite_order(options, suite, out, forks)
    return replace(order, settings=(*CLEAN, *order.settings)) if clean else order


def _require_usable(order: SuiteOrder, options: _DriveOptions) -> None:
    """Print what will be driven; raise a WcsimError for what can be used in no episode."""
    from wcsim.agents.evaluation.suite.run import KEPT, require_usable
    from wcsim.agents.opening.named_policy import describe_rule_differences

    if (order.out / KEPT).exists() and not options.resume:
        raise ConfigError(
            f"--out {order.out}: it holds blocks of an earlier test; continue them with --resume, "
            "or choose another folder"
        )
    suite, console = order.suite, stderr_console()
    listed = f"{suite.file.suite} {suite.file.set}, list {suite.sha256[:12]}"
    console.print(
        f"{listed}: {pluralize(suite.episodes, 'episode')} "
        f"{'all' if order.together else 'a policy'}"
    )
    for line in describe_rule_differences(
        options.policies, order.preset, (*suite.file.settings, *order.settings)
    ):
        console.print(line)
    require_usable(order, options.policies)


@contextmanager
def _resumable(order: SuiteOrder, options: _DriveOptions) -> Iterator[None]:
    """On Ctrl-C say how the test goes on, if it has saved a block in a folder that stays."""
    from wcsim.agents.evaluation.suite.run import KEPT

    def saved() -> set[Path]:
        return set(order.out.rglob(f"{KEPT}/*.json"))

    # Blocks of another test may lie in the same folder.
    before = set() if options.resume else saved()
    try:
        yield
    except KeyboardInterrupt:
        # The folder of --town is temporary.
        stays = options.out is not None or isinstance(options, _OfSuite)
        if not stays or not saved() - before:
            raise
        message = f"stopped; finished blocks are saved in {order.out}; continue with --resume"
        raise InterruptedRunError(message) from None


def _compare_shifts(options: _SensitivityOptions) -> int:
    """Drive the list and its shifts; how the command ends."""
    from wcsim.agents.evaluation.suite.shifts import drive_shifts

    order = _suite_order(options)
    file = order.suite.file
    _require_usable(order, options)
    policies = tuple(dict.fromkeys((UNAIDED, *options.policies)))
    with _resumable(order, options):
        shifts = drive_shifts(order, policies, print_note)
    rows = [each.to_json() for each in shifts]
    common.write_json(order.out / "sensitivity.json", rows)
    print_shifts(stdout_console(), f"{file.suite} {file.set}", shifts)
    common.write_json(options.json, {"suite": file.suite, "set": file.set, "rows": rows})
    return _exit_of([each.row for each in shifts])


def _exit_of(rows: Iterable[ResultRow]) -> ExitCode:
    return ExitCode.FAILED if any(row.without_result for row in rows) else ExitCode.DONE


def _play_episode(order: SuiteOrder, policies: Sequence[str], place: str) -> int:
    """Drive one episode again, film its end, print what happened.

    An episode that `order.out` holds must come out as it did there.

    Raises:
        ConfigError: The place is none, the policies are not one, or the episode went another way.
        PolicyError: The policy cannot be used.
    """
    index, seat = _place_of_play(place, len(order.suite.file.blocks))
    if len(policies) != 1:
        raise ConfigError(
            f"--play takes one policy, got {len(policies)}: name the policy whose episode to drive"
        )
    from wcsim.agents.evaluation.suite.playback import play, require_same
    from wcsim.agents.evaluation.suite.result_files import EPISODES, read_episodes
    from wcsim.agents.evaluation.suite.run import piece_of, require_usable, town_addresses
    from wcsim.view.filming import film_steps, near, sticks
    from wcsim.view.map import MapView

    # 1. Drive it, and film its end.
    require_usable(order, policies)
    piece = piece_of(order, index, policies[0], town_addresses(order), judged=False)
    config = resolve_policy_config(piece.policy, piece.preset, piece.settings, in_list=True)
    saved = read_episodes(order.out).get(policies[0], ()) if is_file(order.out / EPISODES) else ()
    film = (
        order.out / "play" / f"{re.sub(r'[^A-Za-z0-9_.-]+', '-', policies[0])}-{index}.{seat}.webm"
    )
    film.parent.mkdir(parents=True, exist_ok=True)
    (played,) = play(
        piece,
        (seat,),
        round(_FILMED_S / config.world.tick_s),
        lambda world, steps: film_steps(
            film, MapView(world.street.mesh, _MAP_PX, _MAP_SPAN_M), steps, config
        ),
    )

    # 2. Print a row every so often, counted back from the end.
    record = played.record
    every = max(1, round(_ROW_EVERY_S / config.world.tick_s))
    rows = []
    for before, step in enumerate(reversed(played.steps)):
        if before % every == 0:
            nearest = [*near(step), "-"][0]
            time_s = f"-{before * config.world.tick_s:.1f}"
            rows.append((time_s, f"{step.speed_mps:.2f}", *sticks(step), nearest))
    how = " ".join(
        word for word in (record.status, record.reason, record.fault, record.crash) if word
    )
    show_table(
        [
            Column(heading, justify="right", no_wrap=True)
            for heading in ("s", "m/s", "user", "driven", "nearest")
        ],
        rows[::-1],
        title=f"{record.part} {record.block}.{record.seat}, {record.town}, {record.profile}: {how}",
    )

    # 3. Compare it with the one that was saved.
    compared = f"not compared: none is saved in {order.out}"
    for earlier in saved:
        if (earlier.block, earlier.seat) == (index, seat):
            require_same(record, earlier)
            compared = "the same as the saved one"
            break
    stdout_console().print(
        f"{film if played.steps else 'no video: nothing was driven'}; the episode is {compared}",
        style="dim",
    )
    return 0


def _place_of_play(text: str, blocks: int) -> tuple[int, int]:
    """Block and seat. Raises ConfigError.

    >>> _place_of_play("12.3", 20)
    (12, 3)
    """
    found = _PLACE.fullmatch(text)
    if found is None or int(found[1]) >= blocks:
        most = blocks - 1
        raise ConfigError(
            f"--play {escape(text)!r}: expected BLOCK.SEAT, such as 0.1, with a block from 0 to "
            f"{most}"
        )
    return int(found[1]), int(found[2])


@dataclass
class _SuiteMakeOptions:
    """Make a list of test episodes for your own towns."""

    make_suite: str
    """A town's name, its folder, or a .sumocfg file; several are separated by commas.
    made:SEED is a generated town (`wcsim town make`)."""
    suite_file: Annotated[Path, arg(metavar="FILE"), common.WritableFile()] = Path("suite.json")
    """The list to write. Its set is named after the file: lower-case letters, digits and - only."""
    recipe: str = "own"
    """Its recipe: own, guard, hard, dev2, validation2, or a file (docs/suites.md)."""
    jobs: common.Jobs = 1
    """Parallel processes."""
    seed: int = 0
    """Seed of the list."""


def run_make_suite_command(words: list[str]) -> int:
    """Make a list and write it."""
    options = common.parse_options(_SuiteMakeOptions, words, "test")
    name = options.suite_file.stem
    if not re.fullmatch(make_suite_name_pattern(MOST_SET), name):
        proposed = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:MOST_SET]
        raise ConfigError(
            f"--suite-file: got the name {escape(name, 80)!r}; expected at most {MOST_SET} "
            f"lower-case letters, digits and -{f', such as {proposed}' * bool(proposed)}"
        )

    from wcsim.agents.evaluation.suite.make import make_suite
    from wcsim.agents.evaluation.suite.result_files import TOWNS
    from wcsim.agents.opening import list_file

    with create_temporary_folder() as work:
        towns = list_file.parse_suite_towns(options.make_suite, work / TOWNS)
        with StageBar("making the list") as bar:

            def show(text: str, share: float) -> None:
                bar.show(share, "")
                bar.print_line(text)

            file = make_suite(
                list_file.open_recipe(options.recipe),
                towns,
                show,
                named=name,
                seed=options.seed,
                work=work,
                jobs=options.jobs,
            )
    list_file.write_list(file, options.suite_file)
    suite = list_file.suite_from_file(file)
    size = f"{pluralize(suite.episodes, 'episode')} in {pluralize(len(file.blocks), 'block')}"
    stdout_console().print(f"{options.suite_file}: {size}, {suite.sha256[:12]}")
    return 0
