"""`wcsim log play | verify | compare | convert`: commands for recordings of all kinds."""

import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

from tyro.conf import Positional, arg

from wcsim.cli.shared.common import (
    Bounds,
    OutFile,
    Parts,
    Seat,
    WebPageOptions,
    WritableFile,
    run_subcommand,
    serve_page,
    write_json,
    write_result_atomically,
)
from wcsim.core.reading import escape, is_file, is_folder
from wcsim.errors import ConfigError, check_installed
from wcsim.log.diff import find_log_difference
from wcsim.log.reader import read_header

_SHOW_EVERY: Final = 1000  # ticks
_FCD: Final = ".xml"
_MCAP: Final = ".mcap"
Epoch = Annotated[int | None, arg(metavar="N"), Bounds(0)]


@dataclass(kw_only=True)
class _LogOptions:
    """A recording, and what it was made with."""

    log: Annotated[Path, Positional, arg(metavar="LOG")]
    """A run folder, a journal, a trace or a recorded drive."""
    epoch: Epoch = None
    """Number of the world in the run; default all."""
    hook: str = ""
    """Your own step hook, module:Class, that the run was made with; its code runs only when you name it."""  # noqa: E501


@dataclass(kw_only=True)
class _PlayOptions(_LogOptions, WebPageOptions):
    """Play a recording in your browser: pause, speed, single steps, jumps to crashes and interventions."""  # noqa: E501

    seat: Seat = None
    """Chair to follow."""
    town: str = ""
    """Where a trace was recorded, if not found: a town's name, its folder, or a .sumocfg file."""


@dataclass(kw_only=True)
class _VerifyOptions(_LogOptions):
    """Simulate a journal or a drive again, and compare it tick by tick."""

    first: Annotated[int, arg(name="from", metavar="TICK")] = 0
    """First tick of each world to compare."""
    last: Annotated[int | None, arg(name="to", metavar="TICK")] = None
    """Last tick of each world to compare."""
    json: OutFile = None
    """Write the result to this file."""


@dataclass(kw_only=True)
class _CompareOptions:
    """Print where two recordings of a kind first differ."""

    logs: Annotated[tuple[Path, Path], Positional, arg(metavar="LOG LOG")]
    """Run folders, traces, journals or recorded drives."""
    json: OutFile = None
    """Write the result to this file."""


@dataclass(kw_only=True)
class _ConvertOptions(_LogOptions):
    """Write a recording as SUMO floating car data (FCD) or as ROS 2 messages (MCAP)."""

    out: Annotated[Path, Positional, arg(metavar="FILE")]
    """FILE.xml for traffic and wheelchairs as FCD, FILE.mcap for motion, commands and sensor data of the wheelchairs.
    MCAP needs the extra wcsim[bag]."""  # noqa: E501
    epoch: Epoch = 0
    """Number of the world in the run."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Run one of them; 1 when something differs."""
    parts: Parts = {
        "play": (_PlayOptions, _play),
        "verify": (_VerifyOptions, _verify),
        "compare": (_CompareOptions, _compare),
        "convert": (_ConvertOptions, _convert),
    }
    return run_subcommand(words, "log", parts)


def _log_in(run: Path, first: str = "journal") -> Path:
    """A log itself, or that of a run folder: where it has both, `first` or else the other one.

    Raises:
        ConfigError: There is none.
    """
    if is_folder(run):
        for name in (first, "trace" if first == "journal" else "journal"):
            if is_file(run / name):
                return run / name
        raise ConfigError(
            f"{escape(run)}: has no trace and no journal; expected a run folder of a server or "
            "of wcsim town run"
        )
    if not is_file(run):
        raise ConfigError(
            f"{escape(run)}: is not there; expected a run folder, a trace, a journal or a "
            "recorded drive"
        )
    return run


def _play(options: _PlayOptions) -> int:
    path = _log_in(options.log)
    # What cannot be played is refused before the simulators are loaded and a page is served.
    header = read_header(path)
    from wcsim.bridge.replay.replayed import log_of, require_hook, worlds_of
    from wcsim.drive.playing.play_runner import PlayStart
    from wcsim.drive.playing.sources.source_process import FilmSource

    require_hook(header, options.hook)
    if header.kind != "trace":
        log_of(path)
        worlds_of(header, options.hook)
    source = FilmSource(
        kind="log", path=path.absolute(), epoch=options.epoch, hook=options.hook, town=options.town
    )
    return serve_page(PlayStart(source=source, seat=options.seat), options)


def _verify(options: _VerifyOptions) -> int:
    last = math.inf if options.last is None else options.last
    Bounds(0).check("--to", last)
    Bounds(0, last).check("--from", options.first)
    path = _log_in(options.log)
    header = read_header(path)
    from wcsim.bridge.replay.replayed import log_of, verify
    from wcsim.log.fingerprint import make_software_fingerprint

    here = make_software_fingerprint()
    if header.fingerprint != here:
        print(
            f"the {header.kind} was made with other versions, so results may differ: "
            f"{escape(header.fingerprint)}; here: {here}",
            file=sys.stderr,
        )

    def show(ticks: int) -> None:
        if ticks % _SHOW_EVERY == 0:
            print(f"{ticks} ticks", file=sys.stderr)

    started_s = time.perf_counter()
    result = verify(log_of(path), options.epoch, options.first, options.last, show, options.hook)
    rate = result.ticks / max(time.perf_counter() - started_s, 1e-9)
    if not result.ticks and (options.epoch, options.first, options.last) != (None, 0, None):
        raise ConfigError(f"{path}: has no tick in that range; change --epoch, --from or --to")
    first, message = None, "all equal"
    if result.first is not None:
        first = {"epoch": result.first.epoch, "tick": result.first.tick}
        message = f"{result.mismatches} differ, first {first}"
    found: dict[str, Any] = {
        "ticks": result.ticks,
        "mismatches": result.mismatches,
        "first_mismatch": first,
    }
    if header.kind == "drive":
        message += f", at most {result.farthest_m:.3g} m apart"
        found["farthest_m"] = result.farthest_m
    print(f"{path}: {result.ticks} ticks compared, {message} ({rate:.0f} ticks/s)")
    write_json(options.json, found)
    return 1 if result.mismatches else 0


def _compare(options: _CompareOptions) -> int:
    one, other = map(_log_in, options.logs)
    difference = find_log_difference(one, other)
    print(difference or f"{one} and {other} are equal")
    write_json(options.json, {"equal": not difference, "first_difference": difference})
    return 1 if difference else 0


def _convert(options: _ConvertOptions) -> int:
    out, kind = options.out, options.out.suffix.lower()
    if kind not in (_FCD, _MCAP):
        raise ConfigError(
            f"{escape(out)}: expected a file name that ends in {_FCD} (FCD) or {_MCAP} (ROS 2)"
        )
    WritableFile().check("FILE", out)
    path = _log_in(options.log, "trace" if kind == _FCD else "journal")
    read_header(path)
    from wcsim.bridge.recording.convert import convert_to_fcd, convert_to_mcap

    found: dict[str, Any] = {"log": str(options.log), "file": str(out)}
    if kind == _MCAP:
        check_installed("a .mcap file needs rosbags", "bag", "rosbags")
    with write_result_atomically(out) as part:
        if kind == _FCD:
            found["steps"] = convert_to_fcd(path, part, options.epoch or 0, options.hook)
            content = f"{found['steps']} time steps"
        else:
            counts = convert_to_mcap(path, part, options.epoch or 0, options.hook)
            found["messages"] = counts
            content = f"{sum(counts.values())} messages on {', '.join(sorted(counts))}"
    print(f"wrote {out}: {content}")
    write_json(options.json, found)
    return 0
