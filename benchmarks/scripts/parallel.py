"""`python -m benchmarks parallel`: several networks learn in one world at once, and the same ones one after the other.

Each run is the command `wcsim train-clients ...` in a process of its own, start-up included. Where the time went is
what the launcher has added up in waits.json.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from wcsim.agents.clients.paid_times import ClientTimeTotals, read_group_run_times
from wcsim.cli.shared.common import Bounds, OutFile, Repeated, split_nonempty_list, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.cli.training.train_clients import make_client_names
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import pluralize
from wcsim.errors import ConfigError, WcsimError

_SHARES = ("world_s", "others_s", "acting_s", "learning_s", "overlap_s", "total_s")


@dataclass
class ParallelOptions:
    """Train several networks together in one world and one after the other, and print the time saved."""

    clients: str = "fig6,conv3d,convlstm"
    """Networks, separated by commas."""
    sizes: str = ""
    """Sizes of the groups, such as 3,6: the first 3 and the first 6 networks. (default: all of them)"""
    cores: str = ""
    """Numbers of cores for each group, such as 2,1. (default: all cores)"""
    steps: int = 3000
    """Steps of each network."""
    town: str = "helsinki"
    """Where to train: a town's name, its folder, or a .sumocfg file."""
    preset: str = "dqn"
    """Preset with the settings."""
    set: Repeated = ()
    """Setting as section.key=value; overrides the preset."""
    seed: int = 0
    """Seed of all runs."""
    json: OutFile = None
    """Write the result to this file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trained:
    """One run: its wall time, the time before its first tick and after its last one, and each client's times."""

    wall_s: float
    start_s: float
    ticks_per_s: float
    waited: dict[str, dict[str, float]]  # by client, then by share
    cores: int


def run(options: ParallelOptions) -> int:
    """Run all, print the tables."""
    networks = split_nonempty_list("--clients", options.clients)
    Bounds(1, 10_000_000).check("--steps", options.steps)
    names, here = make_client_names(networks), len(os.sched_getaffinity(0))
    sizes = _numbers("--sizes", options.sizes, len(networks)) or (len(networks),)
    cores = _numbers("--cores", options.cores, here) or (here,)
    console = stdout_console()
    with create_temporary_folder() as work:
        alone = []
        for number, network in enumerate(networks):
            console.print(f"{network} alone ...")
            alone.append(_trained(options, (network,), work / f"alone-{number}", here))
        groups = []
        for size in sizes:
            for count in cores:
                console.print(f"{size} clients together, {pluralize(count, 'core')} ...")
                groups.append(_trained(options, networks[:size], work / f"together-{size}-{count}", count))
    apart = {name: next(iter(one.waited.values())) for name, one in zip(names, alone, strict=True)}
    told = [_print_group(console, options, group, alone, apart) for group in groups]
    if options.json is not None:
        largest = told[-1] | {"waited": {"together": groups[-1].waited, "sequential": apart}}
        result = {**largest, "steps": options.steps, "clients": list(names), "groups": told}
        write_json(options.json, result)
    return 0


def _numbers(option: str, text: str, most: int) -> tuple[int, ...]:
    """Whole numbers from 1 on, separated by commas; none for an empty text."""
    if not text:
        return ()
    words = split_nonempty_list(option, text)
    if not all(word.isdecimal() and 1 <= int(word) <= most for word in words):
        raise ConfigError(f"{option} {text[:80]!r}: expected whole numbers from 1 to {most}, separated by commas")
    return tuple(int(word) for word in words)


def _trained(options: ParallelOptions, networks: Sequence[str], folder: Path, cores: int) -> Trained:
    """One training command on so many cores. Raises WcsimError when it fails."""
    result = folder.with_suffix(".json")
    words = ["train-clients", ",".join(networks), "--town", options.town, "--preset", options.preset]
    words += ["--steps", str(options.steps), "--seed", str(options.seed), "--out", str(folder), "--json", str(result)]
    words += [word for item in options.set for word in ("--set", item)]
    all_cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(all_cores)[:cores]))
    begun_s = time.monotonic()
    try:
        done = subprocess.run([sys.executable, "-m", "wcsim", *words], capture_output=True, text=True, check=False)
    finally:
        os.sched_setaffinity(0, all_cores)
    wall_s = time.monotonic() - begun_s
    if done.returncode:
        raise WcsimError(f"wcsim {' '.join(words)} ended with code {done.returncode}: {done.stderr.strip()[-400:]}")
    paid = read_group_run_times(folder)
    if paid is None:
        raise WcsimError(f"{folder} holds no times of its clients")
    waited = {name: _told(paid.clients[name]) for name in make_client_names(networks)}
    rate = float(json.loads(result.read_text(encoding="utf-8"))["ticks_per_s"])
    start_s = wall_s - options.steps / rate if rate > 0.0 else wall_s
    return Trained(wall_s=wall_s, start_s=max(0.0, start_s), ticks_per_s=rate, waited=waited, cores=cores)


def _told(shares: ClientTimeTotals) -> dict[str, float]:
    """A client's shares, and their sum."""
    return {**asdict(shares), "total_s": shares.acting_s + shares.learning_s + shares.waiting_s}


def _print_group(
    console: Console,
    options: ParallelOptions,
    group: Trained,
    alone: Sequence[Trained],
    apart: dict[str, dict[str, float]],
) -> dict[str, float]:
    """Where the time of clients went together and alone, and what sharing has saved; returns the keys of the result."""
    table = Table("client", "run", "world", "barrier", "infer", "learn", "overlap", "total", "start")
    table.box, table.pad_edge, table.padding = box.SIMPLE_HEAD, False, (0, 0)  # no word is cut at 80 columns
    for run_name, waited in (("together", group.waited), ("alone", {name: apart[name] for name in group.waited})):
        for (client, shares), one in zip(waited.items(), alone, strict=False):
            start_s = group.start_s if run_name == "together" else one.start_s
            summed = shares | {"overlap_s": -shares["overlap_s"]}  # so the parts of a row sum to all
            table.add_row(client, run_name, *(f"{summed[share]:.1f}" for share in _SHARES), f"{start_s:.1f}")
    console.print(table)
    console.print("overlap: learning while waiting, which is also part of learn and of world or barrier")
    same = alone[: len(group.waited)]
    sequential_s = sum(one.wall_s for one in same)
    count = len(group.waited)
    world_s = options.steps * (count * _mean_world_s(same, options.steps) - _mean_world_s([group], options.steps))
    start_s = sum(one.start_s for one in same) - group.start_s
    rest_s = sequential_s - group.wall_s - world_s - start_s  # idle cores, less what processes take from each other
    console.print(
        f"{len(group.waited)} clients on {pluralize(group.cores, 'core')}: together {group.wall_s:.1f} s, "
        f"one after the other {sequential_s:.1f} s: {sequential_s / group.wall_s:.2f} times as fast. "
        f"Saved: {world_s:.1f} s by one world, {start_s:.1f} s by one start, "
        f"{rest_s:.1f} s by otherwise idle cores",
        soft_wrap=True,
    )
    return {
        "size": len(group.waited),
        "cores": group.cores,
        "together_s": group.wall_s,
        "sequential_s": sequential_s,
        "speedup": sequential_s / group.wall_s,
        "ticks_per_s": group.ticks_per_s,
        "saved_world_s": world_s,
        "saved_start_s": start_s,
        "saved_rest_s": rest_s,
    }


def _mean_world_s(runs: Sequence[Trained], steps: int) -> float:
    """The world's step in these runs."""
    every_s = [shares["world_s"] for one in runs for shares in one.waited.values()]
    return sum(every_s) / len(every_s) / steps
