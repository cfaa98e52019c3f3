"""`python -m benchmarks tick`: ticks per second with everything on, beside the loop that one would write first."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from wcsim.cli.shared.common import Bounds, OutFile, Repeated, split_nonempty_list, write_json
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.config import RunConfig, resolve
from wcsim.core.reading import pluralize
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import Town, find_town

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from benchmarks.tick.tick_cost import TickCost

MAX_CHAIRS = 64
MANY = 1_000_000


@dataclass
class TickOptions:
    """Ticks per second of a world with traffic, cameras, IMU and user on, and where the time goes."""

    town: str = "helsinki"
    """Where: a town's name, its folder, or a .sumocfg file."""
    chairs: str = "1,6"
    """Numbers of wheelchairs to measure, such as 1,4."""
    ticks: int = 400
    """Ticks per measurement."""
    physics_hz: int = 120
    """Physics steps per second."""
    demand_scale: float = 0.6
    """Share of the town's traffic; 0.6 of Helsinki's is about 175 vehicles and people."""
    width: int = 320
    """Camera width in pixels; the height is three quarters of it."""
    naive: bool = True
    """Compare with a naive loop of SUMO and PyBullet."""
    naive_camera: bool = True
    """Let it draw pictures, with TinyRenderer; otherwise it sees nothing."""
    seed: int = 4
    """Random seed of the world."""
    set: Repeated = ()
    """section.key=value, over preset `quick`. (repeatable)"""
    profile: bool = False
    """Print the twenty most expensive functions of a tick instead, native ones included."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: TickOptions) -> int:
    """Run the bench."""
    Bounds(1, MANY).check("--ticks", options.ticks)
    Bounds(16, 2048).check("--width", options.width)
    Bounds(100, 1000).check("--physics-hz", options.physics_hz)
    if options.physics_hz % 10:
        raise ConfigError(f"--physics-hz {options.physics_hz}: expected a multiple of 10, as a tick has 0.1 s")
    Bounds(0.0, 10.0).check("--demand-scale", options.demand_scale)
    numbers, config = _chairs(options.chairs), _config(options)
    town = find_town(options.town)
    if options.profile:
        return _profile(options, town, config, numbers)

    from benchmarks.tick.naive_world import NaiveWorld
    from benchmarks.tick.tick_cost import measure_tick

    naive = partial(NaiveWorld, looks=options.naive_camera) if options.naive else None
    costs: dict[int, TickCost] = {}
    with Progress(console=stderr_console(), transient=True) as bar:
        for chairs in numbers:
            task = bar.add_task(pluralize(chairs, "chair"), total=options.ticks)

            def seen(done: int, task: Any = task) -> None:
                bar.update(task, completed=done)

            costs[chairs] = measure_tick(town, config, chairs, options.ticks, options.seed, naive, seen)
    stdout_console().print(_table(costs))
    if options.json is not None:
        rows = {str(chairs): _row(cost) for chairs, cost in costs.items()}
        rss_mb = max(cost.rss_mb for cost in costs.values())
        physics_hz = round(config.world.usual_substeps / config.world.tick_s)
        write_json(options.json, {"physics_hz": physics_hz, **rows, "rss_mb": rss_mb})
    return 0


def _profile(options: TickOptions, town: Town, config: RunConfig, numbers: list[int]) -> int:
    from benchmarks.tick.tick_profile import profiled

    found = {chairs: profiled(town, config, chairs, options.ticks, options.seed) for chairs in numbers}
    for chairs, rows in found.items():
        table = Table("part", "function", "calls a tick", "ms a tick", "share", title=f"{chairs} wheelchairs")
        for row in rows:
            table.add_row(row.part, escape(row.name), f"{row.calls:.1f}", f"{row.own_ms:.3f}", f"{row.share:.1%}")
        stdout_console().print(table)
    if options.json is not None:
        write_json(options.json, {str(chairs): [asdict(row) for row in rows] for chairs, rows in found.items()})
    return 0


def _config(options: TickOptions) -> RunConfig:
    words = (
        f"world.substeps={options.physics_hz // 10}",
        f"world.demand_scale={options.demand_scale}",
        f"cameras.0.width_px={options.width}",
        f"cameras.0.height_px={options.width * 3 // 4}",
    )
    return resolve("quick", (*words, *options.set))


def _chairs(text: str) -> list[int]:
    try:
        found = [int(word) for word in split_nonempty_list("--chairs", text)]
    except ValueError:
        raise ConfigError(f"--chairs {text!r}: expected whole numbers separated by commas, as 1,4") from None
    for number in found:
        Bounds(1, MAX_CHAIRS).check("--chairs", number)
    return found


def _row(cost: TickCost) -> dict[str, Any]:
    return {
        "ticks_per_s": cost.ticks_per_s,
        "ms_median": cost.ms_median,
        "ratio_vs_naive": cost.ratio_vs_naive,
        "bridge_overhead": cost.bridge_overhead,
        "bridge_ms": cost.bridge_ms,
        "share": dict(cost.share),
        "actors": cost.actors,
        "actors_mirrored": cost.mirrored,
        "rss_mb": cost.rss_mb,
    }


def _table(costs: dict[int, TickCost]) -> Table:
    table = Table("chairs", "ticks/s", "naive", "bridge", "ms", "actors", "memory", "share of the time")
    for chairs, cost in costs.items():
        naive = "-" if cost.ratio_vs_naive is None else f"{cost.ratio_vs_naive:.2g}x"
        share = "  ".join(f"{name} {part:.0%}" for name, part in cost.share if part >= 0.005)
        rate, bridge = f"{cost.ticks_per_s:.0f}", f"{cost.bridge_overhead:.0%}"
        ms, actors = f"{cost.bridge_ms:.2f}", f"{cost.actors:.0f}"
        table.add_row(str(chairs), rate, naive, bridge, ms, actors, f"{cost.rss_mb:.0f} MB", share)
    return table
