"""`python -m benchmarks bridge`: what reaction, reading and mirror cost beside the bare engines."""

from __future__ import annotations

from dataclasses import dataclass

from rich.progress import Progress

from wcsim.cli.shared.common import Bounds, OutFile, write_json
from wcsim.cli.shared.consoles import stderr_console
from wcsim.config import resolve
from wcsim.towns.scenario.town import find_town


@dataclass
class BridgeOptions:
    """CPU time of the bridge: compare a world with a twin without it, ten ticks each in turns."""

    town: str = "helsinki"
    """Where: a town's name, its folder, or a .sumocfg file."""
    ticks: int = 600
    """Ticks to measure."""
    demand_scale: float = 0.6
    """Share of the town's traffic; 0.6 of Helsinki's is about 175 vehicles and people."""
    seed: int = 4
    """Random seed of the world."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: BridgeOptions) -> int:
    """Run the bench."""
    Bounds(10, 1_000_000).check("--ticks", options.ticks)
    Bounds(0.0, 10.0).check("--demand-scale", options.demand_scale)
    config = resolve("quick", (f"world.demand_scale={options.demand_scale}",))
    town = find_town(options.town)

    from benchmarks.tick.bridgeless_world import measure_bridge  # loads the simulators, which --help must not

    with Progress(console=stderr_console(), transient=True) as bar:
        task = bar.add_task("ticks", total=options.ticks)
        cost = measure_bridge(town, config, options.ticks, options.seed, lambda n: bar.update(task, completed=n))
    print(
        f"{cost.actors:.0f} vehicles and people, {cost.mirrored:.0f} of them near the chair; "
        f"react {cost.react_ms:.3f}, read {cost.read_ms:.3f}, mirror {cost.mirror_ms:.3f} ms; "
        f"the bare engines take {cost.engines_ms:.3f} ms: overhead {cost.overhead:.1%}"
    )
    if options.json is not None:
        write_json(
            options.json,
            {
                "overhead": cost.overhead,
                "react_ms": cost.react_ms,
                "read_ms": cost.read_ms,
                "mirror_ms": cost.mirror_ms,
                "engines_ms": cost.engines_ms,
                "actors": cost.actors,
                "mirrored": cost.mirrored,
            },
        )
    return 0
