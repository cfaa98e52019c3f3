"""`python -m benchmarks barrier`: what the barrier and the messages of several clients cost a tick."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from rich.progress import Progress, TaskID

from wcsim.cli.shared.common import Bounds, OutFile, write_json
from wcsim.cli.shared.consoles import stderr_console
from wcsim.config import resolve
from wcsim.core.reading import pluralize

if TYPE_CHECKING:  # loads ZeroMQ, which --help must not
    from benchmarks.barrier.barrier_cost import BarrierCost


@dataclass
class BarrierOptions:
    """Time of a tick with several client processes but no simulators or networks, compared with a bare echo."""

    clients: int = 6
    """Number of client processes."""
    ticks: int = 2000
    """Ticks to measure for each transport."""
    width: int = 320
    """Camera width in pixels; the height is three quarters of it."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: BarrierOptions) -> int:
    """Run the bench."""
    Bounds(1, 32).check("--clients", options.clients)
    Bounds(10, 1_000_000).check("--ticks", options.ticks)
    Bounds(16, 2048).check("--width", options.width)
    sizes = (f"cameras.0.width_px={options.width}", f"cameras.0.height_px={options.width * 3 // 4}")
    config = resolve("quick", sizes)

    from benchmarks.barrier.barrier_cost import measure_barrier

    costs: dict[str, BarrierCost] = {}
    with Progress(console=stderr_console(), transient=True) as bar:
        for name in ("ipc", "tcp"):
            task = bar.add_task(name, total=options.ticks)

            def seen(done: int, task: TaskID = task) -> None:
                bar.update(task, completed=done)

            costs[name] = measure_barrier(config, options.clients, options.ticks, name == "tcp", seen)
    for name, cost in costs.items():
        print(
            f"{pluralize(options.clients, 'client')} over {name}: {cost.median_ms:.2f} ms a tick, "
            f"99 % under {cost.p99_ms:.2f}; bare echo {cost.echo_median_ms:.2f}, 99 % under {cost.echo_p99_ms:.2f}"
        )
    if options.json is not None:
        write_json(options.json, {"clients": options.clients, **{name: asdict(cost) for name, cost in costs.items()}})
    return 0
