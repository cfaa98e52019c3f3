"""`wcsim bench curve`: how the cost of a tick grows with wheelchairs, actors and the size of the town."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.progress import Progress
from rich.table import Table

from wcsim.cli.shared.common import OutFile, in_bounds, some_words, write_json
from wcsim.cli.shared.consoles import stderr_console, stdout_console
from wcsim.config import load_run_config
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import find_town

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.bench.curve.cost_curve import CostCurve

MANY = 100_000
_SHOWN = ("sumo", "physics", "render", "bridge", "user", "rest")


@dataclass
class CurveOptions:
    """Cost of a tick by wheelchairs, actors and size of the town, and which grow faster than linearly."""

    town: str = "helsinki"
    """Town for the axis of wheelchairs: a town's name, its folder, or a .sumocfg file."""
    chairs: str = "1,2,4,8,12"
    """Numbers of wheelchairs, separated by commas."""
    actors: str = "50,200,500,1000"
    """Numbers of vehicles and people in a town of 2 km, separated by commas."""
    sides_km: str = "0.6,2,5"
    """Side lengths in km of towns with 200 vehicles and people, separated by commas."""
    ticks: int = 200
    """Ticks per measurement."""
    seed: int = 4
    """Seed of the worlds."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: CurveOptions) -> int:
    """Run the bench; exit code 1 when something grows faster than linearly."""
    in_bounds("--ticks", options.ticks, 1, MANY)
    chairs = [round(number) for number in _numbers("--chairs", options.chairs, 1, 64)]
    actors = [round(number) for number in _numbers("--actors", options.actors, 2, 100_000)]
    sides_km = _numbers("--sides-km", options.sides_km, 0.4, 20.0)
    town = find_town(options.town).sumocfg
    config = load_run_config("quick", ("world.demand_scale=0.6", "cameras.0.width_px=320", "cameras.0.height_px=240"))
    grid_config = config.model_copy(update={"world": config.world.model_copy(update={"demand_scale": 1.0})})

    from wcsim.bench.curve.cost_curve import Grids, over_actors, over_chairs, over_size

    with tempfile.TemporaryDirectory(prefix="wcsim-") as folder, Progress(console=stderr_console()) as bar:

        def progress(what: str) -> Callable[[int], None]:
            task = bar.add_task(what, total=options.ticks)
            return lambda done: bar.update(task, completed=done)

        grids, ticks, seed = Grids(folder=Path(folder)), options.ticks, options.seed
        curves = (
            over_chairs(town, config, chairs, ticks, seed, progress("wheelchairs")),
            over_actors(grids, grid_config, actors, ticks, seed, progress("actors")),
            over_size(grids, grid_config, sides_km, ticks, seed, progress("size")),
        )
    for curve in curves:
        stdout_console().print(_table(curve))
    if options.json is not None:
        write_json(options.json, {curve.axis: _row(curve) for curve in curves})
    return int(any(curve.steep for curve in curves))


def _numbers(option: str, text: str, least: float, most: float) -> list[float]:
    try:
        found = [float(word) for word in some_words(option, text)]
    except ValueError:
        raise ConfigError(f"{option} {text!r}: expected numbers separated by commas, as 1,4") from None
    for number in found:
        in_bounds(option, number, least, most)
    if found != sorted(set(found)):
        raise ConfigError(f"{option} {text!r}: expected each number once, the smallest first")
    return found


def _row(curve: CostCurve) -> dict[str, Any]:
    return {"points": [asdict(point) for point in curve.points], "steep": dict(curve.steep)}


def _table(curve: CostCurve) -> Table:
    table = Table(curve.axis, "actors", "ms a tick", *_SHOWN, title=f"CPU time in milliseconds by {curve.axis}")
    for point in curve.points:
        stages = (f"{point.stages_ms[name]:.2f}" for name in _SHOWN)
        table.add_row(f"{point.at:g}", f"{point.actors:.0f}", f"{point.cpu_ms:.2f}", *stages)
    faster = ", ".join(f"{name} (exponent {exponent:.2f})" for name, exponent in curve.steep)
    table.caption = f"faster than linear between the last two points: {faster or 'nothing'}"
    return table
