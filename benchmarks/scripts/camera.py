"""`python -m benchmarks camera`: the rasteriser beside TinyRenderer and Embree on the same frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Column, Table

from wcsim.cli.shared.common import Bounds, OutFile, split_nonempty_list, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.config import CameraConfig
from wcsim.towns.scenario.town import Town, find_town

if TYPE_CHECKING:  # loads the renderers, which --help must not
    from benchmarks.camera.compare import Agreement, ComparedPicture, RendererComparison


@dataclass
class CameraOptions:
    """Compare the rasteriser with PyBullet's TinyRenderer on the same frames (CPU time)."""

    towns: str = "helsinki,monaco,manhattan"
    """Towns for the camera poses: each a town's name, its folder, or a .sumocfg file; separated by commas."""
    poses: int = 32
    """Number of camera poses over all towns."""
    actors: int = 60
    """Actors around them in each town."""
    rounds: int = 3
    """Repetitions of each picture."""
    seed: int = 0
    """Seed of the poses and the traffic."""
    json: OutFile = None
    """Write the result to this file."""


def run(options: CameraOptions) -> int:
    """Measure and print."""
    for option, fewest in (("poses", 1), ("actors", 0), ("rounds", 1)):
        Bounds(fewest, 1000).check(f"--{option}", getattr(options, option))
    camera = CameraConfig()
    names = split_nonempty_list("--towns", options.towns)
    towns = {name: find_town(name) for name in names}

    from benchmarks.camera.compare import pooled

    shares = _shares(names, options.poses)
    measured = {name: _measure(towns[name], camera, count, options) for name, count in shares.items()}
    every = pooled([picture for some in measured.values() for picture in some])
    rows = {name: pooled(some) for name, some in measured.items()}
    console = stdout_console()
    console.print(_table({**rows, "all": every} if len(rows) > 1 else rows))
    if options.json is not None:
        each = {name: _as_json(row) for name, row in rows.items()}
        write_json(options.json, {**_as_json(every), "towns": each})
    return 0


def _shares(names: tuple[str, ...], poses: int) -> dict[str, int]:
    """Poses of each town, as even as may be; a town without any is left out."""
    even, more = divmod(poses, len(names))
    counts = {name: even + (i < more) for i, name in enumerate(names)}
    return {name: count for name, count in counts.items() if count}


def _measure(town: Town, camera: CameraConfig, poses: int, options: CameraOptions) -> tuple[ComparedPicture, ...]:
    """One town, all of its street loaded."""
    from benchmarks.camera.compare import compare_renderers
    from benchmarks.camera.random_scenes import scatter
    from wcsim.physics.renderer.geometry import GeometryStore
    from wcsim.physics.renderer.instances import actor_instances
    from wcsim.physics.sensors.camera_geometry import pinhole
    from wcsim.towns.street import load_street

    street = load_street(town)
    scene, store = scatter(street, camera, poses, options.actors, options.seed), GeometryStore(street.mesh)
    return compare_renderers(store, pinhole(camera), scene.poses, actor_instances(scene.actors), options.rounds)


def _table(rows: dict[str, RendererComparison]) -> Table:
    table = Table(
        Column("\ntown", overflow="fold", min_width=12), "raster\nms", "colour\n+ ms", "Tiny\nms", "\nratio",
        "Tiny\nclass", "Tiny\ndepth", "Embree\nclass", "Embree\ndepth",
        box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False,
    )  # fmt: skip
    for name, row in rows.items():
        cells = (row.ms_median, row.rgb_extra_ms, row.tiny_ms_median, row.ratio_vs_tiny)
        table.add_row(name, *(f"{cell:.2f}" for cell in cells), *_shares_of(row.tiny), *_shares_of(row.embree))
    return table


def _shares_of(agreement: Agreement | None) -> tuple[str, str]:
    if agreement is None:
        return "-", "-"
    return f"{agreement.same_class:.2%}", f"{agreement.same_depth:.2%}"


def _as_json(row: RendererComparison) -> dict[str, Any]:
    return {
        "ms_median": row.ms_median,
        "ratio_vs_tiny": row.ratio_vs_tiny,
        "embree": None if row.embree is None else _pair(row.embree),
        "tiny": _pair(row.tiny),
        "rgb_extra_ms": row.rgb_extra_ms,
        "tiny_ms_median": row.tiny_ms_median,
        "pictures": row.pictures,
    }


def _pair(agreement: Agreement) -> dict[str, float]:
    return {"class": agreement.same_class, "depth": agreement.same_depth}
