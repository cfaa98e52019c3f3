"""`wcsim bench parallel`: several networks learn in one world at once, and the same ones one after the other.

Each run is the command `wcsim train --clients ...` in a process of its own, start-up included. Where the time went is
what each client wrote into its times.json.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from wcsim.cli.shared.common import OutFile, Repeated, in_bounds, some_words, write_json
from wcsim.cli.training.clients import client_names
from wcsim.errors import WcsimError

_SHARES = ("simulation_s", "barrier_s", "inference_s", "learning_s", "other_s", "elapsed_s")


@dataclass
class ParallelOptions:
    """Train several networks in one world together and one after the other, and say what each waited for."""

    clients: str = "fig6,stack,gru"
    """Networks, joined by commas."""
    steps: int = 3000
    """Steps of each."""
    town: str = "helsinki"
    """Town to train in."""
    preset: str = "dqn"
    """Settings to begin with."""
    set: Repeated = ()
    """section.key=value, laid over the preset; may be given several times."""
    seed: int = 0
    """Of all runs."""
    json: OutFile = None
    """Write the result to this file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trained:
    """One run: its wall time, and each client's times."""

    wall_s: float
    ticks_per_s: float
    waited: dict[str, dict[str, float]]  # by client, then by share


def run(options: ParallelOptions) -> int:
    """Run all, print the table."""
    networks = some_words("--clients", options.clients)
    in_bounds("--steps", options.steps, 1, 10_000_000)
    names = client_names(networks)
    console = Console(highlight=False)
    with tempfile.TemporaryDirectory(prefix="wcsim-parallel-") as work:
        console.print(f"{len(networks)} clients together ...")
        together = _trained(options, networks, Path(work) / "together")
        alone = []
        for number, network in enumerate(networks):
            console.print(f"{network} alone ...")
            alone.append(_trained(options, (network,), Path(work) / f"alone-{number}"))
    sequential_s = sum(one.wall_s for one in alone)
    apart = {name: next(iter(one.waited.values())) for name, one in zip(names, alone, strict=True)}
    _print(console, together, apart, sequential_s)
    if options.json is not None:
        result = {
            "together_s": together.wall_s,
            "sequential_s": sequential_s,
            "speedup": sequential_s / together.wall_s,
            "waited": {"together": together.waited, "sequential": apart},
            "ticks_per_s": {"together": together.ticks_per_s, "sequential": [one.ticks_per_s for one in alone]},
            "steps": options.steps,
            "clients": list(names),
        }
        write_json(options.json, result)
    return 0


def _trained(options: ParallelOptions, networks: Sequence[str], folder: Path) -> Trained:
    """One training command. Raises WcsimError when it fails."""
    result = folder.with_suffix(".json")
    words = ["train", "--town", options.town, "--preset", options.preset, "--clients", ",".join(networks)]
    words += ["--steps", str(options.steps), "--seed", str(options.seed), "--out", str(folder), "--json", str(result)]
    words += [word for item in options.set for word in ("--set", item)]
    begun_s = time.monotonic()
    done = subprocess.run([sys.executable, "-m", "wcsim", *words], capture_output=True, text=True, check=False)
    wall_s = time.monotonic() - begun_s
    if done.returncode:
        raise WcsimError(f"wcsim {' '.join(words)} ended with code {done.returncode}: {done.stderr.strip()[-400:]}")
    waited = {}
    for name in client_names(networks):
        times = json.loads((folder / name / "times.json").read_text(encoding="utf-8"))
        waited[name] = {share: float(times[share]) for share in _SHARES}
    told = json.loads(result.read_text(encoding="utf-8"))
    return Trained(wall_s=wall_s, ticks_per_s=float(told["ticks_per_s"]), waited=waited)


def _print(console: Console, together: Trained, apart: dict[str, dict[str, float]], sequential_s: float) -> None:
    titles = ("world", "barrier", "infer", "learn", "other", "all")  # seconds, in the order of _SHARES
    table = Table("client", "run", *titles, box=box.SIMPLE_HEAD, pad_edge=False)
    for run_name, waited in (("together", together.waited), ("alone", apart)):
        for client, shares in waited.items():
            table.add_row(client, run_name, *(f"{shares[share]:.1f}" for share in _SHARES))
    console.print(table)
    console.print(
        f"together {together.wall_s:.1f} s, one after the other {sequential_s:.1f} s: "
        f"{sequential_s / together.wall_s:.2f} times as fast"
    )
