"""`wcsim bench tick | camera | reaction | bridge`: measure this machine, as ratios of things timed in the same run."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import psutil  # type: ignore[import-untyped]
from rich import box
from rich.console import Console
from rich.table import Column, Table

from wcsim.bridge.world import World, as_users_wish
from wcsim.cli import bench_bridge, bench_reaction
from wcsim.cli.bench_bridge import BridgeOptions
from wcsim.cli.bench_reaction import ReactionOptions
from wcsim.cli.common import OutFile, in_bounds, parse, some_words, subcommand, write_json
from wcsim.config import CameraConfig, RunConfig, load_run_config
from wcsim.errors import ConfigError
from wcsim.physics.camera import pinhole
from wcsim.physics.renderer.compare import RendererComparison, compare_renderers
from wcsim.physics.renderer.instances import instances_of
from wcsim.physics.renderer.scatter import scatter
from wcsim.physics.renderer.store import GeometryStore
from wcsim.towns.street import load_street
from wcsim.towns.town import find_town
from wcsim.types import SeatSpec

MAX_CHAIRS = 64
MANY = 1_000_000


@dataclass
class TickOptions:
    """Ticks per second of a world with its camera on, and where the time goes."""

    town: str = "helsinki"
    """Town to run."""
    chairs: str = "1"
    """Numbers of wheelchairs to measure, joined by commas."""
    ticks: int = 400
    """Ticks to measure for each."""
    width: int = 320
    """Camera width in pixels; the height is three quarters of it."""
    seed: int = 0
    """Seed of the world."""
    json: OutFile = None
    """Write the result to this file."""


@dataclass
class CameraOptions:
    """The rasteriser beside PyBullet's TinyRenderer on the same frames, interleaved, in CPU time."""

    towns: str = "helsinki,monaco,manhattan"
    """Towns to take camera poses from, joined by commas."""
    poses: int = 4
    """Camera poses in each town."""
    actors: int = 60
    """Actors around them."""
    rounds: int = 2
    """How often each picture is drawn."""
    seed: int = 0
    """Seed of the poses and the traffic."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Run one bench."""
    known = {"tick": TickOptions, "camera": CameraOptions, "reaction": ReactionOptions, "bridge": BridgeOptions}
    name = subcommand(words, "bench", known)
    if name == "tick":
        return _tick(parse(TickOptions, words[1:], "bench tick"))
    if name == "reaction":
        return bench_reaction.run(words[1:])
    if name == "bridge":
        return bench_bridge.run(parse(BridgeOptions, words[1:], "bench bridge"))
    return _camera(parse(CameraOptions, words[1:], "bench camera")) if name else 0


def _tick(options: TickOptions) -> int:
    in_bounds("--ticks", options.ticks, 1, MANY)
    in_bounds("--width", options.width, 16, 2048)
    result: dict[str, Any] = {str(chairs): _measure(options, chairs) for chairs in _chairs(options.chairs)}
    table = Table("chairs", "ticks/s", "first tick", "memory", "share of the time")
    for number, row in result.items():
        share = "  ".join(f"{name} {part:.0%}" for name, part in row["share"].items())
        first, memory = f"{row['first_tick_s']:.1f} s", f"{row['memory_mb']:.0f} MB"
        table.add_row(number, f"{row['ticks_per_s']:.0f}", first, memory, share)
    Console().print(table)
    if options.json is not None:
        write_json(options.json, result)
    return 0


def _chairs(text: str) -> list[int]:
    try:
        found = [int(word) for word in some_words("--chairs", text)]
    except ValueError:
        raise ConfigError(f"--chairs {text!r}: expected whole numbers joined by commas, as 1,4") from None
    for number in found:
        in_bounds("--chairs", number, 1, MAX_CHAIRS)
    return found


def _measure(options: TickOptions, chairs: int) -> dict[str, Any]:
    config = _sized(load_run_config("quick"), options.width)
    started_s = time.perf_counter()
    with World(find_town(options.town), config, (SeatSpec(),) * chairs, options.seed) as world:
        world.tick(as_users_wish(world.snapshot))
        first_tick_s = time.perf_counter() - started_s
        memory_mb = psutil.Process().memory_info().rss / 1e6
        for _ in range(50):
            world.tick(as_users_wish(world.snapshot))
        world.stopwatch.take()
        spent_s, actors = [], []
        for _ in range(options.ticks):
            start = time.perf_counter()
            snapshot = world.tick(as_users_wish(world.snapshot))
            spent_s.append(time.perf_counter() - start)
            actors.append(len(snapshot.actors))
        stages = world.stopwatch.take()
    total_s = sum(spent_s)
    share = {name: seconds / total_s for name, seconds in stages}
    share["rest"] = max(0.0, 1.0 - sum(share.values()))
    return {
        "ticks_per_s": options.ticks / total_s,
        "ms_median": float(np.median(spent_s)) * 1e3,
        "actors_mirrored": float(np.mean(actors)),
        "first_tick_s": first_tick_s,
        "memory_mb": memory_mb,
        "share": share,
    }


def _sized(config: RunConfig, width: int) -> RunConfig:
    camera = CameraConfig(**{**config.cameras[0].model_dump(), "width_px": width, "height_px": width * 3 // 4})
    return config.model_copy(update={"cameras": (camera,)})


def _camera(options: CameraOptions) -> int:
    for option, fewest in (("poses", 1), ("actors", 0), ("rounds", 1)):
        in_bounds(f"--{option}", getattr(options, option), fewest, 1000)
    camera = CameraConfig()
    rows = {name: _compare(name, camera, options) for name in some_words("--towns", options.towns)}
    table = Table(
        Column("\ntown", overflow="fold", min_width=12), "rasteriser\nms", "with\ncolours", "TinyRenderer\nms",
        "\nratio", "same\nclass", "same\ndepth", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False,
    )  # fmt: skip
    for name, row in rows.items():
        cells = (row.ms_median, row.rgb_ms_median, row.tiny_ms_median, row.ratio_vs_tiny)
        table.add_row(
            name, *(f"{cell:.2f}" for cell in cells), f"{row.class_agreement:.4%}", f"{row.depth_agreement:.4%}"
        )
    Console().print(table)
    if options.json is not None:
        write_json(
            options.json,
            {
                "ratio_vs_tiny": float(np.median([row.ratio_vs_tiny for row in rows.values()])),
                "ms_median": float(np.median([row.ms_median for row in rows.values()])),
                "towns": {name: {**asdict(row), "ratio_vs_tiny": row.ratio_vs_tiny} for name, row in rows.items()},
            },
        )
    return 0


def _compare(name: str, camera: CameraConfig, options: CameraOptions) -> RendererComparison:
    street = load_street(find_town(name))
    scene = scatter(street, camera, options.poses, options.actors, options.seed)
    return compare_renderers(
        GeometryStore(street.mesh), pinhole(camera), scene.poses, instances_of(scene.actors), options.rounds
    )
