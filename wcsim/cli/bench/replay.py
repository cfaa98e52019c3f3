"""`wcsim bench replay`: what a state costs in the replay memory on disk."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.progress import Progress, TaskID
from rich.table import Table

from wcsim.cli.shared.common import OutFile, in_bounds, write_json
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.config import load_run_config
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.bench.replay.state_cost import StateCost

NOISES = {"clean": "none", "noisy": "typical"}
MOST = {"kb_per_state_clean": 5.0, "kb_per_state_noisy": 25.0, "write_ms": 0.5, "read_ms": 0.5}
MOST_OF = (320, 240)
"""The size of pictures that these bounds are for: others cost neither the same nor in proportion to their pixels."""


@dataclass
class ReplayOptions:
    """Cost of a state in the replay memory on disk: bytes without and with sensor noise, time to write and read."""

    town: str = "helsinki"
    """Where: a town's name, its folder, or a .sumocfg file."""
    width: int = MOST_OF[0]
    """Camera width in pixels."""
    height: int = MOST_OF[1]
    """Camera height in pixels; the limits hold for 320x240 only."""
    states: int = 600
    """Number of states, without and with noise."""
    seed: int = 4
    """Random seed of the world."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: ReplayOptions) -> int:
    """Run the bench; 1 when a number is above what it may be with pictures of the usual size."""
    in_bounds("--width", options.width, 16, 2048)
    in_bounds("--height", options.height, 16, 2048)
    in_bounds("--states", options.states, 10, 1_000_000)
    town = find_town(options.town)
    size = (f"cameras.0.width_px={options.width}", f"cameras.0.height_px={options.height}")
    configs = {name: load_run_config("quick", (*size, f"cameras.0.noise={noise}")) for name, noise in NOISES.items()}

    from wcsim.bench.replay.state_cost import measure_states

    costs: dict[str, StateCost] = {}
    with (
        tempfile.TemporaryDirectory(prefix="wcsim-replay-") as work,
        Progress(console=stderr_console(), transient=True) as bar,
    ):
        for name, config in configs.items():
            task = bar.add_task(name, total=options.states)

            def seen(done: int, task: TaskID = task) -> None:
                bar.update(task, completed=done)

            costs[name] = measure_states(town, config, options.states, options.seed, Path(work) / name, seen)
    found = {
        **{f"kb_per_state_{name}": cost.kb_per_state for name, cost in costs.items()},
        "write_ms": max(cost.write_ms for cost in costs.values()),
        "read_ms": max(cost.read_ms for cost in costs.values()),
    }
    stdout_console().print(_table(costs))
    if options.json is not None:
        write_json(options.json, found)
    judged = (options.width, options.height) == MOST_OF
    above = [name for name, value in found.items() if judged and value > MOST[name]]
    for name in above:
        stderr_console().print(f"{name} is {found[name]:.2f}; expected at most {MOST[name]}")
    return int(bool(above))


def _table(costs: dict[str, StateCost]) -> Table:
    table = Table("camera", "kB a state", "write ms", "read ms", "100,000 states: on disk", "in memory (counted)")
    for name, cost in costs.items():
        table.add_row(
            name,
            f"{cost.kb_per_state:.2f}",
            f"{cost.write_ms:.3f}",
            f"{cost.read_ms:.3f}",
            f"{cost.kb_per_state / 10:.2f} GB",
            f"{cost.memory_mb:.1f} MB",
        )
    table.caption = f"medians of {min(cost.states for cost in costs.values())} states, CPU time"
    return table
