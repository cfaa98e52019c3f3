"""`python -m benchmarks memory`: what a world holds while its wheelchairs roam a whole town."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from rich.progress import Progress
from rich.table import Table

from wcsim.cli.shared.common import Bounds, OutFile, write_json
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.config import resolve
from wcsim.core.reading import counted
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town
from wcsim.types import SeatSpec

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from benchmarks.memory.roam import MemoryRow

MANY = 10_000_000


@dataclass
class MemoryOptions:
    """Memory of a world while its wheelchairs roam a whole town with traffic."""

    town: str = "monaco"
    """Where: a town's name, its folder, or a .sumocfg file."""
    chairs: int = 3
    """Number of wheelchairs."""
    ticks: int = 20_000
    """Duration in ticks."""
    every: int = 1_000
    """Ticks between two rows, at most half of --ticks."""
    width: int = 64
    """Camera width in pixels; the height is three quarters of it."""
    demand_scale: float = 1.0
    """Share of the town's traffic."""
    seed: int = 0
    """Seed of the world and of the visited places."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: MemoryOptions) -> int:
    """Run the bench and print a row for every so many ticks."""
    Bounds(1, 64).check("--chairs", options.chairs)
    Bounds(2, MANY).check("--ticks", options.ticks)
    if not 1 <= options.every <= options.ticks // 2:
        raise ConfigError(
            f"--every {options.every}: expected 1 to {options.ticks // 2}, half of --ticks {options.ticks}, as growth "
            "is that of the second half"
        )
    Bounds(16, 2048).check("--width", options.width)
    Bounds(0.0, 10.0).check("--demand-scale", options.demand_scale)
    words = (
        f"world.demand_scale={options.demand_scale}",
        f"cameras.0.width_px={options.width}",
        f"cameras.0.height_px={options.width * 3 // 4}",
    )
    town, config, specs = find_town(options.town), resolve("quick", words), (SeatSpec(),) * options.chairs

    from benchmarks.memory.roam import RoamingWorld, growth_mb, roam

    with RoamingWorld(town, config, specs, options.seed) as world, Progress(console=stderr_console()) as bar:
        task = bar.add_task(f"{counted(options.chairs, 'chair')} in {town.name}", total=options.ticks)

        def seen(row: MemoryRow) -> None:
            bar.update(task, completed=row.tick)
            rows.append(row)
            # what is known so far: a run of hours may be ended before its time
            if options.json is not None:
                write_json(options.json, {"growth_mb": growth_mb(rows), "rows": [asdict(row) for row in rows]})

        rows: list[MemoryRow] = []
        roam(world, options.ticks, options.every, options.seed, seen)
    stdout_console().print(_table(rows, growth_mb(rows)))
    return 0


def _table(rows: list[MemoryRow], growth_mb: float | None) -> Table:
    table = Table("tick", "memory MB", "of it rasters", "objects", "tiles", "tiles seen", "actors' bodies", "actors")
    for r in rows:
        held = f"{r.rss_mb:.1f}", f"{r.rasters_mb:.1f}"
        numbers = (r.tick, *held, r.python_objects, r.tiles, r.tiles_seen, r.bodies, r.actors)
        table.add_row(*map(str, numbers))
    if growth_mb is not None:
        table.caption = f"grew by {growth_mb:.1f} MB in the second half, without the rasters"
    return table
