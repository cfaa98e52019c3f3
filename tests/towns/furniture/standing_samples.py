"""A straight road with a pavement beside it, and items to put there; a small generated town with signals."""

from pathlib import Path

import numpy as np
import shapely
from shapely import box

from wcsim.towns.furniture.placement import FreeGround
from wcsim.towns.sumo.additional import Item
from wcsim.towns.sumo.net import Net, read_net
from wcsim.towns.sumo.tools import run_tool


def free_place() -> FreeGround:
    """The road and its pavement before anything stands there."""
    return FreeGround(
        low=box(0, 0, 100, 8),
        solids=box(0, 20, 100, 30),
        lines=shapely.MultiLineString([[(0, 11), (100, 11)]]),
        hull=box(-10, -10, 110, 40),
    )


def item(kind: str, *xy: tuple[float, float], filled: bool = False, **tags: str) -> Item:
    """A mapped thing; a kind "highway.stop" has a group."""
    group, _, detail = kind.partition(".")
    return Item(
        id="x",
        kind="building" if group == "building" else detail or group,
        detail=detail,
        points_W_m=np.array(xy, float),
        filled=filled,
        tags=tags,
        group=group if detail else "",
    )


def authored(kind: str, *xy: tuple[float, float], filled: bool = False, **tags: str) -> Item:
    """Something that an author placed."""
    place = np.array(xy, float)
    return Item(
        id="mine", kind=kind, detail="", points_W_m=place, filled=filled, tags=tags, group=kind, author=True,
        source="my.add.xml",
    )  # fmt: skip


def signal_net(folder: Path, *options: str) -> Net:
    """A cross of four streets, two lanes each way, with a signal in the middle."""
    grid = ["--grid", "--grid.x-number", "3", "--grid.y-number", "3", "--grid.length", "80", "-L", "2"]
    walk = ["--sidewalks.guess", "--sidewalks.guess.from-permissions", "--crossings.guess", "--walkingareas"]
    run = run_tool("netgenerate", [*grid, *walk, "--tls.set", "B1", *options, "-o", "s.net.xml"], folder)
    if run.returncode:
        raise RuntimeError(run.reason())
    return read_net(folder / "s.net.xml")
