"""`wcsim networks`: what each network costs on this machine."""

from dataclasses import asdict, dataclass
from typing import Annotated

from wcsim.agents.networks.names import NETWORK_NAMES, require_known_network
from wcsim.cli.shared.common import Bounds, OutFile, parse_options, split_nonempty_list, write_json
from wcsim.cli.shared.consoles import show_table
from wcsim.cli.shared.exit_codes import ExitCode


@dataclass
class _Options:
    """Show size, multiplications, memory and decision time of each network."""

    names: str = ",".join(NETWORK_NAMES)
    """Networks, joined by commas: names or module:Class."""
    width: Annotated[int, Bounds(8, 2048)] = 320
    """Picture width in pixels."""
    height: Annotated[int, Bounds(8, 2048)] = 240
    """Picture height in pixels."""
    runs: Annotated[int, Bounds(1)] = 30
    """Number of decisions to time."""
    json: OutFile = None
    """Write the rows to this file."""


def run(words: list[str]) -> int:
    """Measure and print a table."""
    options = parse_options(_Options, words, "networks")
    names = split_nonempty_list("--names", options.names)
    for name in names:
        require_known_network(name)
    from wcsim.agents.networks.costs import (  # loads torch
        LIMIT_MS,
        RESERVE_MS,
        measure_network_cost,
    )

    costs = [
        measure_network_cost(name, options.height, options.width, options.runs) for name in names
    ]
    sizes = ("network", "window", "params", "MACs", "MB")
    times = ("p50 ms", "p99 ms", "ONNX p50 ms", "fits")
    rows = [
        (
            cost.name,
            str(cost.window),
            f"{cost.params:,}",
            f"{cost.macs / 1e6:.1f} M",
            f"{cost.mb:.1f}",
            f"{cost.p50_ms:.2f}",
            f"{cost.p99_ms:.2f}",
            "-" if cost.onnx_p50_ms is None else f"{cost.onnx_p50_ms:.2f}",
            "yes" if cost.within_100_ms else "no",
        )
        for cost in costs
    ]
    show_table((*sizes, *times), rows)
    print(
        f"{options.width}x{options.height} pixels, one core; fits: a decision takes at most "
        f"{LIMIT_MS:g} ms less {RESERVE_MS:g} ms, which a real chair needs to segment its pictures"
    )
    write_json(
        options.json, [{**asdict(cost), "within_100_ms": cost.within_100_ms} for cost in costs]
    )
    return ExitCode.DONE
