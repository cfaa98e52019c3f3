"""`wcsim town tour`: a wheelchair drives over every pavement, walking area and crossing of a town."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.progress import Progress

from wcsim.cli.shared.common import OutFile, in_bounds, write_json
from wcsim.cli.shared.consoles import stderr_console
from wcsim.config import RunConfig, load_run_config, with_overrides
from wcsim.towns.scenario.town import find_town
from wcsim.types import SeatSpec

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.bench.tour.tour import TourReport

TOUR = (
    "cameras.0.width_px=32",
    "cameras.0.height_px=24",
    "env.max_steps=1000000",
    # nothing that happens to the chair ends its tour
    "imu.saturation_mps2=2e6",
    "reward.accel_window_mps2=[1e5, 1e6]",
    "reward.body_on_ground_Ns=1e9",
)


@dataclass
class TourOptions:
    """Drive a wheelchair over every pavement, walking area and crossing of a town."""

    town: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TOWN")]
    """A town's name, its folder, or a .sumocfg file."""
    speed: float = 2.8
    """Speed of the wheelchair in m/s."""
    every: int = 1
    """Visit only every n-th one."""
    seed: int = 0
    """Seed of the traffic."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: TourOptions) -> int:
    """Run the tour; 1 when the chair stood on nothing."""
    in_bounds("--every", options.every, 1, 1_000_000)
    in_bounds("--speed", options.speed, 0.2, 5.0)
    started = time.monotonic()
    report = _tour(options)
    print(
        f"{report.lines} pavements, walking areas and crossings of {report.length_m / 1000:.1f} km: drove "
        f"{report.driven_m / 1000:.1f} km in {report.ticks} ticks ({time.monotonic() - started:.0f} s), "
        f"moved on {report.put_on} times, no ground below it in {report.on_nothing} ticks"
        + (f", first at {report.worst_W_m}" if report.worst_W_m else "")
    )
    if options.json is not None:
        write_json(options.json, {"seconds": time.monotonic() - started, **asdict(report)})
    return 1 if report.on_nothing else 0


def _tour(options: TourOptions) -> TourReport:
    town = find_town(options.town)

    from wcsim.bench.tour.lines import walking_lines
    from wcsim.bench.tour.tour import tour
    from wcsim.bridge.world import World
    from wcsim.towns.sumo.net import read_net

    lines = walking_lines(read_net(town.net, town.file.origin_m), town.file.chair_ways)[:: options.every]
    with (
        World(town, _config(options.speed), (SeatSpec(max_steps=1_000_000_000),), options.seed) as world,
        Progress(console=stderr_console(), transient=True) as bar,
    ):
        task = bar.add_task(town.name, total=len(lines))
        return tour(world, lines, lambda done: bar.update(task, completed=done))


def _config(speed_mps: float) -> RunConfig:
    return with_overrides(load_run_config("quick"), (*TOUR, f"chair.v_max_mps={speed_mps}"))
