"""`wcsim replay`: plays a recording on a page, converts it, verifies it, or compares two."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from wcsim.cli.recordings.film_page import FilmOrder, play_start, result_folder, serve_film
from wcsim.cli.shared.common import OutFile, check_output, in_bounds, parse, result_file, write_json
from wcsim.core.reading import escaped, is_file, is_folder
from wcsim.errors import ConfigError, check_installed

if TYPE_CHECKING:  # loads what --help must not
    from wcsim.log.records import LogKind

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
_SHOW_EVERY = 1000  # ticks


@dataclass
class Options:
    """Replay a recording on a page, convert it, verify it, or compare two.

    docs/watching.md describes the page, docs/recordings.md the files.
    """

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN]")] = ()
    """A run folder, a trace, a journal, a recorded drive, or, for --page, the folder of a suite's test."""
    page: Flag = False
    """Play it in your browser: pause, speed, single steps, jumps to crashes and interventions."""
    fcd: Annotated[Path | None, tyro.conf.arg(metavar="FILE.xml")] = None
    """Write traffic and wheelchairs as SUMO floating car data (FCD)."""
    mcap: Annotated[Path | None, tyro.conf.arg(metavar="FILE.mcap")] = None
    """Write motion, commands and sensor data of the wheelchairs as ROS 2 messages (needs the extra wcsim[bag])."""
    verify: Flag = False
    """Simulate a journal or a drive again and compare it tick by tick."""
    first_difference: Flag = False
    """Print where two recordings of a kind first differ."""
    epoch: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of the world in the run; default 0 for --fcd and --mcap, all for --verify and --page."""
    first: Annotated[int | None, tyro.conf.arg(name="from", metavar="TICK")] = None
    """First tick of each world that --verify compares."""
    last: Annotated[int | None, tyro.conf.arg(name="to", metavar="TICK")] = None
    """Last tick of each world that --verify compares."""
    hook: str = ""
    """Your own step hook, module:Class, that a journal was made with; its code runs only when you name it."""
    policy: str = ""
    """For --page: policy of a test; by default that of the worst failure. Your own code runs only when you name it."""
    network: str = ""
    """For --page: your own network as module:Class, for an episode of a run that was trained with it."""
    block: int | None = None
    """For --page: block of the test."""
    seat: int | None = None
    """For --page: chair to follow."""
    town: str = ""
    """For --page: where a trace was recorded, if not found: a town's name, its folder, or a .sumocfg file."""
    port: int = 8080
    """Port of --page; 0 takes a free one."""
    host: str = "127.0.0.1"
    """Address to serve at; any but the loopback needs the token in the printed address."""
    json: OutFile = None
    """Write the result to this file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A file that a run left."""

    path: Path
    kind: LogKind


def run(words: list[str]) -> int:
    """Do what was asked for; 1 when something differs."""
    options = parse(Options, words, "replay")
    _check(options)
    if options.page:
        return _page(options)
    if options.first_difference:
        return _first_difference(options)
    if options.mcap is not None:
        return _mcap(options, options.mcap)
    return _verify(options) if options.verify else _fcd(options)


def _check(options: Options) -> None:
    for path in options.runs:
        if not is_folder(path) and not is_file(path):
            raise ConfigError(
                f"{escaped(path)}: is not there; expected a run folder, a trace, a journal or a recorded drive"
            )
    task = _task(options)
    runs = 2 if options.first_difference else 1
    if len(options.runs) != runs:
        raise ConfigError(f"{task} got {len(options.runs)} runs; expected {runs}: a run folder, trace or journal")
    _check_ticks(options, task)
    if options.page and options.json is not None:
        raise ConfigError("--json is the result of a comparison or conversion; leave it out with --page")
    if not options.page and _is_of_page(options):
        raise ConfigError(f"--policy, --network, --block, --seat and --town are for --page; leave them out with {task}")
    check_output("--fcd", options.fcd)
    check_output("--mcap", options.mcap, ".mcap")


def _is_of_page(options: Options) -> bool:
    """Whether something is said that --page alone hears of."""
    words = options.policy, options.network, options.town
    return any(words) or options.block is not None or options.seat is not None


def _task(options: Options) -> str:
    """The one option that says what to do."""
    given = (options.page, options.fcd is not None, options.mcap is not None, options.verify, options.first_difference)
    known = ("--page", "--fcd", "--mcap", "--verify", "--first-difference")
    tasks = [name for name, is_so in zip(known, given, strict=True) if is_so]
    if len(tasks) != 1:
        got = " and ".join(tasks) or "none"
        raise ConfigError(
            f"replay got {got}; expected exactly one of --page, --fcd FILE.xml, --mcap FILE.mcap, --verify, "
            "--first-difference"
        )
    return tasks[0]


def _check_ticks(options: Options, task: str) -> None:
    if not options.verify and (options.first is not None or options.last is not None):
        raise ConfigError(f"--from and --to are for --verify; leave them out with {task}")
    if options.first_difference and options.epoch is not None:
        raise ConfigError("--epoch is for --verify, --fcd, --mcap and --page; leave it out with --first-difference")
    for option, number in (("--epoch", options.epoch), ("--from", options.first), ("--to", options.last)):
        in_bounds(option, number or 0, 0, float("inf"))
    if options.last is not None:
        in_bounds("--from", options.first or 0, 0, options.last)


def _find(run: Path, preferred: LogKind, expected: str) -> Recording:
    """The recording of a run, of the preferred kind when there are both. Raises ConfigError."""
    order: tuple[LogKind, LogKind] = ("trace", "journal") if preferred == "trace" else ("journal", "trace")
    if is_folder(run):
        found = [Recording(path=run / kind, kind=kind) for kind in order if is_file(run / kind)]
        if found:
            return found[0]
        raise ConfigError(f"{escaped(run)}: has no trace and no journal; expected {expected}")
    if not is_file(run):
        raise ConfigError(f"{escaped(run)}: is not there; expected {expected}")
    from wcsim.log.reader import read_header

    return Recording(path=run, kind=read_header(run).kind)


def _require_heard(found: Recording, options: Options) -> None:
    """Refuse what this kind of recording would not heed. Raises ConfigError."""
    if found.kind == "drive" and (options.epoch, options.first, options.last, options.hook) != (None, None, None, ""):
        raise ConfigError("--epoch, --from, --to and --hook are for journals; leave them out with a drive")
    if found.kind == "trace" and options.hook:
        raise ConfigError(f"--hook is for journals; {escaped(found.path)} is a trace: leave it out")


def _page(options: Options) -> int:
    in_bounds("--port", options.port, 0, 65535)
    in_bounds("--block", options.block or 0, 0, 1 << 30)
    in_bounds("--seat", options.seat or 0, 0, 1 << 30)
    folder = result_folder(options.runs[0])
    what = "a run folder with a journal or a trace, one of these files, a drive, or the folder of a test"
    found = None if folder is not None else _find(options.runs[0], "journal", what)
    if found is not None:
        _require_heard(found, options)
    order = FilmOrder(
        path=folder if folder is not None else found.path if found is not None else options.runs[0],
        kind="episode" if found is None else found.kind,
        epoch=options.epoch,
        hook=options.hook,
        town=options.town,
        policy=options.policy,
        network=options.network,
        block=options.block,
        seat=options.seat,
    )
    return serve_film(play_start(order), options.host, options.port)


def _fcd(options: Options) -> int:
    what = "a folder that `wcsim town run` or a server made, a trace, or a journal"
    found = _find(options.runs[0], "trace", what)
    if found.kind == "drive":
        raise ConfigError(f"{found.path}: is a drive, which holds no traffic; expected a trace or a journal")
    _require_heard(found, options)
    fcd = options.fcd or Path()
    with result_file(fcd) as part:
        if found.kind == "trace":
            from wcsim.bridge.recording.fcd import write_fcd  # the simulators are loaded here, not for --help

            steps = write_fcd(found.path, part, options.epoch or 0)
        else:
            from wcsim.server.replay import recompute_fcd

            steps = recompute_fcd(found.path, part, options.epoch or 0, options.hook)
    print(f"wrote {fcd}: {steps} time steps")
    if options.json is not None:
        write_json(options.json, {"run": str(options.runs[0]), "fcd": str(fcd), "steps": steps})
    return 0


def _mcap(options: Options, mcap: Path) -> int:
    """A journal holds all, as its world is made again; a trace knows the chairs, a drive its one and the sticks."""
    found = _find(options.runs[0], "journal", "a run folder of a server or of `wcsim town run`, or a recorded drive")
    _require_heard(found, options)
    check_installed("--mcap needs rosbags", "bag", "rosbags")
    with result_file(mcap) as part:
        counts = _bagged(found, part, options)
    print(f"wrote {mcap}: {sum(counts.values())} messages on {', '.join(sorted(counts))}")
    if options.json is not None:
        write_json(options.json, {"run": str(options.runs[0]), "mcap": str(mcap), "messages": counts})
    return 0


def _bagged(found: Recording, out: Path, options: Options) -> dict[str, int]:
    if found.kind == "drive":
        from wcsim.bridge.recording.ros_chairs import drive_bag
        from wcsim.log.drive import read_drive

        return drive_bag(read_drive(found.path), out)
    if found.kind == "journal":
        from wcsim.server.journal_bag import recompute_bag

        return recompute_bag(found.path, out, options.epoch or 0, options.hook)
    from wcsim.bridge.recording.ros_chairs import trace_bag
    from wcsim.log.reader import read_states

    header, records = read_states(found.path)
    chosen = [record for record in records if record.epoch == (options.epoch or 0) and len(record.plants)]
    if not chosen:
        raise ConfigError(f"{found.path}: has no wheelchair in world {options.epoch or 0}; expected a run with some")
    return trace_bag(header.tick_s, chosen, out)


def _verify(options: Options) -> int:
    found = _find(options.runs[0], "journal", "a run folder of a server, or a journal")
    if found.kind == "drive":
        _require_heard(found, options)
        return _verify_drive(found.path, options)
    if found.kind != "journal":
        raise ConfigError(
            f"{escaped(found.path)}: is neither a journal nor a recorded drive; expected a "
            "run folder of a server, its journal, or a file of `wcsim drive --record` or `wcsim users record`"
        )
    from wcsim.log.reader import read_header
    from wcsim.server.replay import verify

    _note_versions("journal", read_header(found.path).fingerprint)
    begun_s = time.perf_counter()
    result = verify(found.path, options.epoch, options.first or 0, options.last, _show, options.hook)
    rate = result.ticks / max(time.perf_counter() - begun_s, 1e-9)
    if not result.ticks and (options.epoch, options.first, options.last) != (None, None, None):
        raise ConfigError(f"{found.path}: has no tick in that range; change --epoch, --from or --to")
    first = None if result.first is None else {"epoch": result.first.epoch, "tick": result.first.tick}
    told = "all equal" if first is None else f"{result.mismatches} differ, first {first}"
    print(f"{found.path}: {result.ticks} ticks compared, {told} ({rate:.0f} ticks/s)")
    if options.json is not None:
        write_json(options.json, {"ticks": result.ticks, "mismatches": result.mismatches, "first_mismatch": first})
    return 1 if result.mismatches else 0


def _verify_drive(path: Path, options: Options) -> int:
    """Drive it again, with the recorded commands, and compare where the chair was."""
    from wcsim.bridge.drives.remake import verify_drive
    from wcsim.log.drive import read_drive

    drive = read_drive(path)
    _note_versions("drive", drive.header.fingerprint)
    result = verify_drive(drive, _show)
    told = "all equal" if not result.mismatches else f"{result.mismatches} differ, first {result.first_tick}"
    print(f"{path}: {result.ticks} ticks compared, {told}, at most {result.farthest_m:.3g} m apart")
    if options.json is not None:
        write_json(options.json, asdict(result))
    return 1 if result.mismatches else 0


def _show(ticks: int) -> None:
    if ticks % _SHOW_EVERY == 0:
        print(f"{ticks} ticks", file=sys.stderr)


def _note_versions(what: str, made_by: str) -> None:
    """Say it when equal results cannot be expected."""
    from wcsim.bridge.recording.fingerprint import fingerprint

    here = fingerprint()
    if made_by != here:
        told = f"the {what} was made with other versions, so results may differ: {escaped(made_by)}; here: {here}"
        print(told, file=sys.stderr)


def _first_difference(options: Options) -> int:
    what = "a run folder, a trace, or a journal"
    one, other = (_find(run, "journal", what) for run in options.runs)
    from wcsim.log.diff import first_difference

    told = first_difference(one.path, other.path)
    print(told or f"{one.path} and {other.path} are equal")
    if options.json is not None:
        write_json(options.json, {"equal": not told, "first_difference": told})
    return 1 if told else 0
