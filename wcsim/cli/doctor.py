"""`wcsim doctor`: does all that wcsim needs work on this machine? `wcsim cache`: built streets."""

import mmap
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from rich.table import Column

from wcsim.cli.shared.common import Flag, OutFile, parse_options, write_json
from wcsim.cli.shared.consoles import show_table
from wcsim.core.files import is_writable_folder
from wcsim.core.reading import escape, pluralize
from wcsim.core.sources import read_package_version
from wcsim.errors import ConfigError, WcsimError

PACKAGES: Final = (
    *("wcsim", "libsumo", "eclipse-sumo", "pybullet", "gymnasium", "numpy", "numba"),
    *("opencv-python-headless", "shapely", "onnxruntime"),
)
_TRAIN_PACKAGES: Final = ("torch", "stable-baselines3")
_PYTHONS: Final = ((3, 11), (3, 12), (3, 13))
TICK_SECONDS: Final = 5.0
# Not measured: in a new installation they compile kernels.
_FIRST_TICKS: Final = 10
_REAL_TIME_TICKS_PER_S: Final = 10.0
_MIN_SHM_BYTES: Final = 32 << 20
_Finding = tuple[bool, str]
"""Whether a check succeeded, and what it found."""


@dataclass
class _Options:
    """Check versions, SUMO, threads and shared memory, and run a town for five seconds."""

    town: str = "helsinki"
    """Where the tick rate is measured: a town's name, its folder, or a .sumocfg file."""
    seed: int = 0
    """Seed of that run."""
    json: OutFile = None
    """Write the findings to this file."""


@dataclass
class _CacheOptions:
    """Show the cache of streets, checked nets, machine code and generated places."""

    clear: Flag = False
    """Delete everything in it; what is needed is built again. Running worlds continue."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Run the checks; exit code 2 when one fails."""
    options = parse_options(_Options, words, "doctor")
    checks: dict[str, Callable[[], _Finding]] = {
        "python": _check_python,
        "packages": _check_packages,
        "sumo": _check_sumo,
        "threads": _check_threads,
        "shared memory": _check_shared_memory,
        "tick rate": lambda: _check_tick_rate(options.town, options.seed),
        # After the tick rate, which puts the town's street into it.
        "cache": _check_cache,
    }
    findings = {name: check() for name, check in checks.items()}
    rows = ((name, "ok" if ok else "FAILS", text) for name, (ok, text) in findings.items())
    show_table(("check", "", Column("found", overflow="fold")), rows)
    write_json(
        options.json, {name: {"ok": ok, "says": text} for name, (ok, text) in findings.items()}
    )
    return 0 if all(ok for ok, _ in findings.values()) else 2


def _check_python() -> _Finding:
    right = sys.version_info[:2] in _PYTHONS and sys.platform == "linux"
    return right, f"{sys.version.split()[0]} on {sys.platform}; needs 3.11, 3.12 or 3.13 on linux"


def _check_packages() -> _Finding:
    found = {name: read_package_version(name) for name in (*PACKAGES, *_TRAIN_PACKAGES)}
    missing = [name for name in PACKAGES if not found[name]]
    text = ", ".join(f"{name} {version}" for name, version in found.items() if version)
    if missing:
        return False, f"{text}; MISSING: {', '.join(missing)} (pip install)"
    if not all(found[name] for name in _TRAIN_PACKAGES):
        text += "; it cannot train: pip install 'wcsim[train]'"
    return True, text


def _check_sumo() -> _Finding:
    from wcsim.towns.sumo.tools import run_tool

    try:
        done = run_tool("sumo", ["--version"], Path(tempfile.gettempdir()))
    except WcsimError as error:
        return False, str(error)
    return done.returncode == 0, done.output.strip().splitlines()[0]


def _check_threads() -> _Finding:
    cores = len(os.sched_getaffinity(0))
    return cores >= 2, f"{cores} cores usable; needs 2"


def _check_shared_memory() -> _Finding:
    folder = Path("/dev/shm") if Path("/dev/shm").is_dir() else Path(tempfile.gettempdir())  # noqa: S108
    free = shutil.disk_usage(folder).free
    text = f"{free >> 20} MiB free in {folder}; needs 32 MiB"
    if free < _MIN_SHM_BYTES:
        return False, text
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.truncate(_MIN_SHM_BYTES)
            with mmap.mmap(file.fileno(), _MIN_SHM_BYTES) as block:
                block[-1] = 1
    except (OSError, ValueError) as error:
        return False, f"{text}; it cannot be used: {error}"
    return True, text


def _check_cache() -> _Finding:
    from wcsim.towns.cache.folder import cache_facts, shown_cache

    facts = cache_facts()
    size_mb = facts.size_bytes / 1e6
    text = (
        f"{facts.streets} streets, {size_mb:.0f} MB in {shown_cache()}; "
        "wcsim cache --clear empties it"
    )
    if not is_writable_folder(facts.folder):
        text += "; it is read-only, so each world builds its street again"
    return True, text


def _check_tick_rate(town: str, seed: int) -> _Finding:
    from wcsim.config import resolve
    from wcsim.towns.scenario.town import find_town
    from wcsim.types import SeatSpec

    try:
        from wcsim.bridge.world import World
        from wcsim.bridge.world_rollout import rollout  # SumoError where libsumo cannot be loaded

        started = time.perf_counter()
        with World(find_town(town), resolve("quick"), (SeatSpec(),), seed) as world:
            steps = rollout(world)
            for _ in range(_FIRST_TICKS):
                next(steps)
            ready = time.perf_counter()
            ticks = 0
            while time.perf_counter() < ready + TICK_SECONDS:
                next(steps)
                ticks += 1
            rate = ticks / (time.perf_counter() - ready)
            ready_s = f"ready after {ready - started:.1f} s"
            text = f"{rate:.0f} ticks/s in {town}, {ready_s}; real time is 10"
            return rate >= _REAL_TIME_TICKS_PER_S, text
    except WcsimError as error:
        return False, str(error)


def run_cache(words: list[str]) -> int:
    """Print it, and clear the cache if requested."""
    from wcsim.towns.cache.folder import cache_facts, clear_cache

    options = parse_options(_CacheOptions, words, "cache")
    before = cache_facts()
    left = clear_cache() if options.clear else before
    checked = pluralize(before.verdicts, "checked net or scenario", "checked nets and scenarios")
    content = (
        f"{pluralize(before.streets, 'street')}, {checked}, {pluralize(before.states, 'state')} of "
        f"warmed traffic, {pluralize(before.rows, 'block')} of tests, "
        f"{pluralize(before.kernels, 'kernel')}, "
        f"{pluralize(before.driven, 'generated place')} to drive in, {before.unfinished} unfinished"
    )
    print(f"{escape(before.folder)}: {content}, {before.size_bytes / 1e6:.1f} MB")
    if options.clear:
        print(f"removed {(before.size_bytes - left.size_bytes) / 1e6:.1f} MB")
    else:
        print("clear it: wcsim cache --clear")
    write_json(
        options.json,
        {**asdict(before), "folder": str(before.folder), "left_bytes": left.size_bytes},
    )
    if options.clear and left.size_bytes:
        raise ConfigError(
            f"{escape(left.folder)}: {left.size_bytes} bytes are left; expected files that you "
            "may remove"
        )
    return 0
