"""`wcsim replay`: what a run recorded, for other programs; made again and compared; two runs side by side."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import tyro

from wcsim.cli.shared.common import OutFile, check_output, in_bounds, parse, write_json, write_whole
from wcsim.core.reading import is_file, is_folder, shown
from wcsim.errors import ConfigError, WcsimError

TRACE: Final = "trace"
JOURNAL: Final = "journal"
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Kind = Literal["trace", "journal"]
_SHOW_EVERY = 1000  # ticks


@dataclass
class Options:
    """Work with recorded runs: write one for other programs, make it again and compare, or compare two."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN]")] = ()
    """A run folder that holds a trace (`wcsim town run`) or a journal (a server), or one of these files."""
    fcd: Annotated[Path | None, tyro.conf.arg(metavar="FILE.xml")] = None
    """Write traffic and wheelchairs as SUMO's floating car data, which SUMO's tools and sumo-gui read."""
    verify: Flag = False
    """Make the world of a journal again and compare it with the journal tick by tick."""
    first_difference: Flag = False
    """Say where two traces, or two journals, begin to differ."""
    epoch: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Which epoch of the world; default 0 for --fcd, all of them for --verify."""
    first: Annotated[int | None, tyro.conf.arg(name="from", metavar="TICK")] = None
    """The first tick of each epoch that --verify compares."""
    last: Annotated[int | None, tyro.conf.arg(name="to", metavar="TICK")] = None
    """The last one."""
    hook: str = ""
    """Your own step hook, module:Class, that a journal was made with: code, which the journal alone does not load."""
    json: OutFile = None
    """Write the result to this file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A file that a run left."""

    path: Path
    kind: Kind


def run(words: list[str]) -> int:
    """Do what was asked for; 1 when something differs."""
    options = parse(Options, words, "replay")
    _check(options)
    if options.first_difference:
        return _first_difference(options)
    return _verify(options) if options.verify else _fcd(options)


def _check(options: Options) -> None:
    for path in options.runs:
        if not is_folder(path) and not is_file(path):
            raise ConfigError(f"{shown(path)}: is not there; expected a run folder, a trace or a journal")
    task = _task(options)
    runs = 2 if options.first_difference else 1
    if len(options.runs) != runs:
        raise ConfigError(f"{task} got {len(options.runs)} runs; expected {runs}: a run folder, trace or journal")
    _check_ticks(options, task)
    check_output("--fcd", options.fcd)


def _task(options: Options) -> str:
    """The one option that says what to do."""
    given = (options.fcd is not None, options.verify, options.first_difference)
    tasks = [name for name, is_so in zip(("--fcd", "--verify", "--first-difference"), given, strict=True) if is_so]
    if len(tasks) != 1:
        got = " and ".join(tasks) or "none"
        raise ConfigError(f"replay got {got}; expected exactly one of --fcd FILE.xml, --verify, --first-difference")
    return tasks[0]


def _check_ticks(options: Options, task: str) -> None:
    if not options.verify and (options.first is not None or options.last is not None):
        raise ConfigError(f"--from and --to say what --verify compares; expected no such option with {task}")
    if options.first_difference and options.epoch is not None:
        raise ConfigError("--epoch says what --verify or --fcd works on; expected no such option")
    for option, number in (("--epoch", options.epoch), ("--from", options.first), ("--to", options.last)):
        in_bounds(option, number or 0, 0, float("inf"))
    if options.last is not None:
        in_bounds("--from", options.first or 0, 0, options.last)


def _find(run: Path, preferred: Kind, expected: str) -> Recording:
    """The recording of a run, of the preferred kind when there are both. Raises ConfigError."""
    order: tuple[Kind, Kind] = ("trace", "journal") if preferred == TRACE else ("journal", "trace")
    if is_folder(run):
        found = [Recording(path=run / kind, kind=kind) for kind in order if is_file(run / kind)]
        if found:
            return found[0]
        raise ConfigError(f"{shown(run)}: has no trace and no journal; expected {expected}")
    if not is_file(run):
        raise ConfigError(f"{shown(run)}: is not there; expected {expected}")
    return Recording(path=run, kind="journal" if _is_journal(run) else "trace")


def _is_journal(path: Path) -> bool:
    from wcsim.server.journal.journal import read_header

    try:
        read_header(path)
    except WcsimError:
        return False
    return True


def _fcd(options: Options) -> int:
    what = "a folder that `wcsim town run` or a server made, a trace, or a journal"
    found = _find(options.runs[0], TRACE, what)
    fcd = options.fcd or Path()
    steps = 0

    def fill(part: Path) -> None:
        nonlocal steps
        if found.kind == TRACE:
            from wcsim.bridge.recording.fcd import write_fcd  # the simulators are loaded here, not for --help

            steps = write_fcd(found.path, part, options.epoch or 0)
        else:
            from wcsim.server.journal.replay import recompute_fcd

            steps = recompute_fcd(found.path, part, options.epoch or 0, options.hook)

    write_whole(fcd, fill)
    print(f"wrote {fcd}: {steps} time steps")
    if options.json is not None:
        write_json(options.json, {"run": str(options.runs[0]), "fcd": str(fcd), "steps": steps})
    return 0


def _verify(options: Options) -> int:
    found = _find(options.runs[0], JOURNAL, "a run folder of a server, or a journal")
    if found.kind != JOURNAL:
        raise ConfigError(f"{found.path}: is no journal, and only a journal can be verified; expected one of a server")
    from wcsim.server.journal.replay import verify

    _note_versions(found.path)
    begun_s = time.perf_counter()

    def show(ticks: int) -> None:
        if ticks % _SHOW_EVERY == 0:
            print(f"{ticks} ticks", file=sys.stderr)

    result = verify(found.path, options.epoch, options.first or 0, options.last, show, options.hook)
    rate = result.ticks / max(time.perf_counter() - begun_s, 1e-9)
    if not result.ticks and (options.epoch, options.first, options.last) != (None, None, None):
        raise ConfigError(f"{found.path}: has no tick there; expected --epoch, --from and --to that leave some")
    first = None if result.first is None else {"epoch": result.first.epoch, "tick": result.first.tick}
    told = "all equal" if first is None else f"{result.mismatches} differ, first {first}"
    print(f"{found.path}: {result.ticks} ticks compared, {told} ({rate:.0f} ticks/s)")
    if options.json is not None:
        write_json(options.json, {"ticks": result.ticks, "mismatches": result.mismatches, "first_mismatch": first})
    return 1 if result.mismatches else 0


def _note_versions(journal: Path) -> None:
    """Say it when equal hashes cannot be expected."""
    from wcsim.bridge.recording.fingerprint import fingerprint
    from wcsim.server.journal.journal import read_header

    made_by, here = read_header(journal).fingerprint, fingerprint()
    if made_by != here:
        told = f"the journal was made by other versions, hashes may differ: {shown(made_by)}; here: {here}"
        print(told, file=sys.stderr)


def _first_difference(options: Options) -> int:
    what = "a run folder, a trace, or a journal"
    one, other = (_find(run, JOURNAL, what) for run in options.runs)
    if one.kind != other.kind:
        raise ConfigError(f"{one.path} is a {one.kind} and {other.path} a {other.kind}; expected two of a kind")
    if one.kind == TRACE:
        from wcsim.bridge.recording.trace_diff import first_difference as difference
    else:
        from wcsim.server.journal.diff import journal_difference as difference
    told = difference(one.path, other.path)
    print(told or f"{one.path} and {other.path} are equal")
    if options.json is not None:
        write_json(options.json, {"equal": not told, "first_difference": told})
    return 1 if told else 0
